"""The subject of a sweep: a model by name or value, a scene, and what is rejected."""

import pickle

import pytest

import cosim
from cosim.errors import UnknownName, UsageError
from cosim.study.sweep.subject import open_subject


@pytest.mark.parametrize("name", ["bicycle/book", "bicycle/multipliers", "double_pendulum"])
def test_a_dae_and_its_name_are_the_same_subject(name):
    by_name, by_value = open_subject(name), open_subject(cosim.load(name))
    assert by_value.digest == by_name.digest
    assert by_value.name == by_name.name
    assert by_value.columns(None) == by_name.columns(None)


@pytest.mark.parametrize("name", ["bicycle", "bicycle/multipliers"])
def test_a_worker_rebuilds_the_same_subject(name):
    here = open_subject(name)
    there = pickle.loads(pickle.dumps(here))
    again = open_subject(there._request.dae)
    assert there.digest == again.digest == here.digest


def test_another_parameter_is_another_subject():
    digests = {open_subject(name).digest for name in ("bicycle", "bicycle/book")}
    assert len(digests) == 2


def test_an_unknown_keyword_of_a_run_is_rejected_with_the_nearest_one():
    with pytest.raises(TypeError, match="'stop_tme'; did you mean stop_time"):
        cosim.sweep("crank_shaft", {"omega": [1.0]}, stop_tme=3)


def test_another_type_and_an_unknown_name_are_rejected():
    with pytest.raises(UsageError, match="a model's name"):
        open_subject(3)
    with pytest.raises(UnknownName, match="phi"):
        open_subject("bicycle").unit("phii")


def test_a_scene_with_an_accuracy_is_rejected(tmp_path):
    scene = tmp_path / "scene.toml"
    scene.write_text('title = "x"\nmodel = "crank_shaft"\n[run]\naccuracy = 1e-6\n')
    with pytest.raises(UsageError, match="no accuracy"):
        open_subject(scene)
