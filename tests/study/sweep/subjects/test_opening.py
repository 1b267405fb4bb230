"""What is swept is the same, by whatever it is named."""

import pytest

import cosim
from cosim.errors import UnknownName, UsageError
from cosim.study.sweep.subjects.opening import as_subject, opened_subject


@pytest.mark.parametrize("name", ["bicycle/book", "bicycle/multipliers", "double_pendulum"])
def test_a_dae_and_its_name_are_the_same_subject(name):
    by_name, by_value = (
        opened_subject(as_subject(name)),
        opened_subject(as_subject(cosim.load(name))),
    )
    assert by_value.digest == by_name.digest
    assert by_value.name == by_name.name
    assert by_value.columns(None) == by_name.columns(None)


def test_another_parameter_is_another_subject():
    digests = {opened_subject(as_subject(name)).digest for name in ("bicycle", "bicycle/book")}
    assert len(digests) == 2


def test_what_cannot_be_swept_is_refused():
    with pytest.raises(UsageError, match="a model's name"):
        as_subject(3)
    with pytest.raises(UnknownName, match="phi"):
        opened_subject(as_subject("bicycle")).unit("phii")


def test_a_scene_with_an_accuracy_is_refused(tmp_path):
    scene = tmp_path / "scene.toml"
    scene.write_text('title = "x"\nmodel = "crank_shaft"\n[run]\naccuracy = 1e-6\n')
    with pytest.raises(UsageError, match="no accuracy"):
        opened_subject(as_subject(scene))
