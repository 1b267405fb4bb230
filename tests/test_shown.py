"""What values say of themselves at a prompt: few lines, whatever their size; models in pickles."""

import copy
import pickle

import numpy as np
import pytest

import casadi_models
import cosim
from casadi_models.dae import Model
from cosim.model.catalogue import loaded


@pytest.mark.parametrize("name", casadi_models.CATALOG)
def test_model_says_what_it_is_in_few_lines(name):
    dae = loaded(name)
    lines = repr(dae).splitlines()
    assert lines[0].startswith(f"Dae {name}: ")
    assert len(lines) <= 9
    assert max(map(len, lines)) < 160
    assert all(f"<td>{v.name}</td>" in dae._repr_html_() for v in dae.variables)


def test_reduced_model_says_so():
    assert "reduced: " in repr(cosim.reduce(loaded("bicycle"), ["phi"]))


def test_builder_says_what_is_declared():
    model = Model("pendulum")
    assert repr(model) == "Model pendulum: nothing declared; freeze() makes a Dae of it"
    model.state("phi", "rad", 0.1, "angle")
    assert "1 states" in repr(model)
    assert (
        "<td>states</td><td>phi</td><td>rad</td><td>0.1</td><td>angle</td>" in model._repr_html_()
    )


@pytest.mark.parametrize("name", ["bicycle_model_1.toml", "bar_on_frame_two_body.toml"])
def test_scene_says_what_it_sets(name):
    scene = cosim.read_scene(name)
    lines = repr(scene).splitlines()
    assert lines[0].startswith(f"Scene {scene.name}: {scene.title}")
    assert len(lines) <= 9
    assert max(map(len, lines[1:])) <= 100
    assert f"<td>{scene.dae.full_name}</td>" in scene._repr_html_()


@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize("name", casadi_models.CATALOG)
def test_pickled_model_is_the_same_model(name):
    dae = loaded(name)
    again = pickle.loads(pickle.dumps(dae))
    assert repr(again) == repr(dae)
    assert again.variables == dae.variables
    assert again.operations(with_outputs=True) == dae.operations(with_outputs=True)
    assert len(again.invariants) == len(dae.invariants)


@pytest.mark.parametrize("name", ["bicycle/multipliers", "crank_shaft"])
def test_pickled_model_runs_to_the_same_bits(name):
    dae = loaded(name)
    first, second = (
        cosim.simulate(d, stop_time=0.1, compiled=False)
        for d in (dae, copy.deepcopy(dae))  # deepcopy takes the way of pickle
    )
    np.testing.assert_array_equal(first.values, second.values)


def test_info_of_a_model_shows_the_same_tables_on_a_page_and_as_text():
    info = cosim.info("bicycle")
    page, (_, meaning) = info._repr_html_(), info.limits[0]
    assert meaning in info.text()
    assert f"<td>{meaning}</td>" in page
    assert "a run is valid while every margin is positive" in page
