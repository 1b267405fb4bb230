"""`cosim export` twice: the same bytes, made once; anything else that counts makes another file."""

import warnings
from dataclasses import replace

import pytest
from helpers.small_models import decay

from cosim.fmi.trust import is_made_here
from cosim.verify import reference_result
from cosim.verify.kept_export import export_kept, export_key


@pytest.fixture(autouse=True)
def own_cache(monkeypatch, tmp_path):
    monkeypatch.setenv("COSIM_CACHE", str(tmp_path / "cache"))


@pytest.fixture
def made(monkeypatch):
    """Return what has really been made."""
    seen = []
    original = reference_result.export_with_proof

    def counting(dae, target, **options):
        seen.append(target)
        return original(dae, target, **options)

    monkeypatch.setattr(reference_result, "export_with_proof", counting)
    return seen


def test_a_second_export_is_the_first_one(made, tmp_path):
    cold, _ = export_kept(decay(), tmp_path / "cold.fmu")
    warm, _ = export_kept(decay(), tmp_path / "warm.fmu")
    assert len(made) == 1
    assert warm.read_bytes() == cold.read_bytes()
    assert is_made_here(warm)


def test_another_model_option_or_code_is_another_file(monkeypatch):
    dae = decay()
    keys = {export_key(dae, fmi=2), export_key(dae, fmi=3)}
    keys.add(export_key(replace(dae, description="other"), fmi=2))
    monkeypatch.setattr("cosim.verify.made_with._version", lambda package: "0")
    keys.add(export_key(dae, fmi=2))
    monkeypatch.setattr("cosim.verify.made_with._code", lambda: iter([("changed", 1, 2)]))
    keys.add(export_key(dae, fmi=2))
    assert len(keys) == 5
    assert export_key(dae, fmi=2) == export_key(decay(), fmi=2)


def test_a_damaged_entry_is_made_again(made, tmp_path):
    cold, _ = export_kept(decay(), tmp_path / "cold.fmu", reference=False)
    (entry,) = (tmp_path / "cache" / "exports").iterdir()
    entry.write_bytes(entry.read_bytes()[:-1] + b"x")
    with pytest.warns(RuntimeWarning, match="was damaged"):
        warm, _ = export_kept(decay(), tmp_path / "warm.fmu", reference=False)
    assert len(made) == 2
    assert warm.read_bytes() == cold.read_bytes()


def test_what_was_warned_of_is_said_each_time(monkeypatch, tmp_path):
    def warning(_dae, target, **_options):
        warnings.warn("no reference", stacklevel=2)
        target.write_bytes(b"")
        return target

    monkeypatch.setattr(reference_result, "export_with_proof", warning)
    for name in ("one", "two"):
        with pytest.warns(UserWarning, match="no reference"):
            export_kept(decay(), tmp_path / f"{name}.fmu")
