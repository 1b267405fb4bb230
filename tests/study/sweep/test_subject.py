"""The subject of a sweep: a model by name or value, a scene, and what is rejected."""

import pickle

import casadi
import numpy as np
import pytest

import cosim
from cosim.errors import UnknownName, UsageError
from cosim.integrate.keywords import requested
from cosim.model.inputs import InputSeries
from cosim.study.sweep.subject import ModelSubject, open_subject


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


def _ball(*, kept=0.7, floor=0.0, limit=5.0, sampled=2.0, smooth=False):
    """Return a ball whose events, limit and smooth relations are no part of its derivatives."""
    model = cosim.Model("ball", stop_time=1.0)
    h, v = model.state("h", "m", 1.0, "height"), model.state("v", "m/s", 0.0, "speed")
    hits = model.discrete("hits", "1", 0.0, "weighted impacts")
    model.derivative(h, v)
    push = casadi.if_else(v > 1, 0.0, 0.1)
    model.derivative(v, -9.81 + (cosim.smooth(push) if smooth else push))
    model.when(h < floor, {v: -kept * v, hits: hits + 1}, name="impact")
    model.every(0.25, {hits: sampled * hits})
    model.limit(limit - h, "it is near the ground")
    return model.freeze()


_SAMPLES = np.sin(np.arange(2001.0))


def _driven(change=0.0, place=1000, **keywords):
    values = _SAMPLES.copy()
    values[place] += change
    series = InputSeries(("T2",), np.linspace(0, 1, 2001), values[:, None])
    return requested(cosim.load("bar_on_frame"), inputs=series, **keywords)


@pytest.mark.parametrize(
    "changed",
    [{"kept": 0.3}, {"floor": 0.1}, {"limit": 6.0}, {"sampled": 3.0}, {"smooth": True}],
    ids=lambda words: next(iter(words)),
)
def test_another_event_or_limit_is_another_subject(changed):
    digest = open_subject(_ball()).digest
    assert open_subject(_ball()).digest == digest
    assert open_subject(_ball(**changed)).digest != digest


def test_another_sample_of_an_input_is_another_subject():
    digests = [ModelSubject(one).digest for one in (_driven(), _driven())]
    assert len({*digests}) == 1
    others = _driven(1e-12), _driven(50.0), _driven(on_invalid="stop")
    assert len({*digests, *(ModelSubject(one).digest for one in others)}) == 4


def test_a_store_of_a_model_with_another_event_is_not_continued(tmp_path):
    def run(kept, **keywords):
        return cosim.sweep(_ball(kept=kept), {"h": [1.0, 2.0]}, workers=0, **keywords)

    run(0.7, store=tmp_path / "store")
    with pytest.raises(UsageError, match="holds another sweep: its model_digest"):
        run(0.3, store=tmp_path / "store", resume=True)


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


@pytest.mark.parametrize("kind", [list, tuple, np.array])
def test_output_times_may_be_an_array(kind):
    times = kind([0.5, 1.0])
    found = cosim.sweep(
        "crank_shaft", {"omega": [40.0, 50.0]}, outputs=["phi"], output_times=times, workers=0
    )
    assert found["phi_final"] == pytest.approx([45, 55])  # omega t + alpha t^2 / 2


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("output_times", np.array([])),
        ("output_times", np.full(3, np.nan)),
        ("output_times", casadi.SX.sym("t")),
        ("samples", casadi.DM()),
    ],
    ids=["empty", "nan", "symbol", "table"],
)
def test_argument_that_is_no_array_of_numbers_is_rejected(name, wrong):
    values = None if name == "samples" else {"omega": [40.0]}
    with pytest.raises(UsageError, match=name):
        cosim.sweep("crank_shaft", values, workers=0, **{name: wrong})


def test_a_sweep_says_what_its_runs_may_have_missed():
    """A table of two states, which steps pass over; there was no reason."""
    places = np.linspace(0, 10, 201)
    heights = np.zeros((201, 201))
    heights[102, 102] = 1e3
    table = casadi.interpolant("table", "linear", [places, places], heights.ravel(order="F"))
    t, x = casadi.MX.sym("t"), casadi.MX.sym("x", 2)
    ode = casadi.vertcat(1, table(casadi.vertcat(x[0], t)))
    dae = cosim.from_casadi({"t": t, "x": x, "ode": ode}, {"x": [0, 0]}, stop_time=10)
    found = cosim.sweep(dae, {"x_2": [0.0, 1.0]}, workers=0)
    told = "steps may pass over changes of a term of x_1, time; set max_step"
    assert found.reasons == {0: told, 1: told}
    assert [row["reason"] for row in found.rows()] == [told, told]
