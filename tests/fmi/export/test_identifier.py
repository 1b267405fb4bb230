"""Names of models become C identifiers or are rejected."""

import pytest

import cosim
from cosim.errors import ExportError
from cosim.fmi.export.options import model_identifier


@pytest.mark.parametrize(
    ("name", "identifier"),
    [
        ("crank_shaft", "crank_shaft"),
        ("bicycle/book", "bicycle_book"),
        ("_private", "_private"),
        ("A1", "A1"),
        ("x" * 100, "x" * 100),
    ],
)
def test_model_and_formulation_become_one_identifier(name, identifier):
    assert model_identifier(name) == identifier


@pytest.mark.parametrize(
    "name",
    [
        "",
        " ",
        "two words",
        "dotted.name",
        "dashed-name",
        "größe",
        "\uff46ull",
        "1st",
        "../x",
        "..",
        "/etc/passwd",
        "a/b/c",
        "a\\b",
        "C:x",
        "a\0b",
        "a\n",
        "%n%s",
        "x" * 101,
        "x" * 300,
    ],
)
def test_invalid_c_name_is_rejected(name):
    with pytest.raises(ExportError, match="cannot name an FMU: use at most 100 ASCII letters"):
        model_identifier(name)


@pytest.mark.parametrize("name", ["for", "int", "restrict", "main", "con", "NUL", "Com1", "lpt9"])
def test_reserved_word_is_rejected(name):
    with pytest.raises(ExportError, match=f"'{name}' cannot name an FMU: it is a reserved word"):
        model_identifier(name)


def test_an_empty_name_is_not_the_default(tmp_path):
    with pytest.raises(ExportError, match="'' cannot name an FMU"):
        cosim.export_fmu("crank_shaft", tmp_path / "x.fmu", identifier="")
