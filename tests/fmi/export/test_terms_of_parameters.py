"""Terms that parameters make short: many runs see them, and FMUs tell."""

import casadi as ca
import fmpy
import numpy as np
import pytest
from casadi import SX

import cosim
from cosim.codegen.landmarks import landmarks

K = 1e6
WITH_NEW = "is short with the new k, which a solver may step over"


def circling(term, k=K, **starts):
    """Return the integral of a term of a circle's coordinates, over two turns and a bit."""
    t, x, w, y, p = (SX.sym(name) for name in ("t", "x", "w", "y", "k"))
    laws = {"t": t, "x": ca.vertcat(x, w, y), "p": p, "ode": ca.vertcat(w, -x, term(x, w, p))}
    options = {"name": "circling", "stop_time": 14, "output_interval": 1}
    return cosim.from_casadi(laws, {"w": 1.0, "k": k, **starts}, **options)


GENTLE = {  # with k = 1, but not with K; their integrals with K
    "growth": (lambda x, w, k: ca.sqrt(k) * ca.exp(k * (x - 1)), 2 * np.sqrt(2 * np.pi)),
    "growth of a square": (
        lambda x, w, k: ca.sqrt(k) * ca.exp(k * (x * x - 1)),
        4 * np.sqrt(np.pi),
    ),
    "wave": (lambda x, w, k: ca.sqrt(k) * ca.exp(-k * ca.sin(3 * x) ** 2), 1.5 * np.sqrt(np.pi)),
}


@pytest.mark.parametrize("kind", GENTLE)
def test_what_a_parameter_makes_short_is_computed_in_lanes_and_told_by_fmus(kind, tmp_path):
    term, right = GENTLE[kind]
    dae = circling(term, k=1.0)
    assert not landmarks(dae).arguments.numel()
    many = cosim.simulate_many(dae, {"k": [1.0, K]}, solver="dop853", relative_tolerance=1e-10)
    assert many["y"][1, -1] == pytest.approx(right, rel=1e-2)  # before: 0
    path = cosim.export_fmu(dae, tmp_path / "x.fmu")
    for value in (1.0, 2.0, K):
        for interface in ("CoSimulation", "ModelExchange"):
            run = cosim.simulate_fmu(
                path, interface=interface, start_values={"k": value}, stop_time=1
            )
            assert (WITH_NEW in run.stats.get("note", "")) == (value == K)  # before: never


def test_an_fmu_tells_of_a_wave_of_time_that_a_tuned_parameter_makes_short(tmp_path):
    t, y, k = SX.sym("t"), SX.sym("y"), SX.sym("k")
    laws = {"t": t, "x": y, "p": k, "ode": ca.sqrt(k) * ca.exp(-k * ca.sin(t / 2) ** 2)}
    dae = cosim.from_casadi(laws, {"k": 1.0}, name="wave", stop_time=7)
    many = cosim.simulate_many(dae, {"k": [1.0, 1e8]}, solver="dop853")
    assert many["y"][1, -1] == pytest.approx(3 * np.sqrt(np.pi), rel=1e-4)  # before: half of it
    said = list[bytes]()
    path = cosim.export_fmu(dae, tmp_path / "x.fmu", tunable=["k"])
    tuned = np.array([(0, 1.0), (5, 1e8)], dtype=[("time", float), ("k", float)])
    fmpy.simulate_fmu(
        path,
        fmi_type="CoSimulation",
        input=tuned,
        debug_logging=True,
        logger=lambda *m: said.append(m[-1]),
    )
    assert any(WITH_NEW.encode() in text for text in said)  # before: not
