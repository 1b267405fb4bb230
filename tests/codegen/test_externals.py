"""Functions of libraries: right on both backends with their C code, a sentence without it."""

import shutil
import zipfile
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from casadi import MX, SX

import cosim
from cosim.codegen.casadi_library import sources_beside
from cosim.codegen.compiler import SUFFIX, cached_library, compile_library
from cosim.errors import UsageError

END = {"stop_time": 1.0, "relative_tolerance": 1e-9}
EXACT = {"x_1": np.exp(-2.0), "x_2": np.cos(np.exp(-2.0))}  # x_1' = -p x_1, x_2 = cos x_1
BY_HAND = """#include "sizes.h"
#include <math.h>
int bare(const double **arg, double **res, long long *iw, double *w, int mem) {
    if (res[0]) res[0][0] = RATE * sin(arg[0] ? arg[0][0] : 0);
    return 0;
}
"""


def law(name: str = "law") -> ca.Function:
    """Return a function of two arguments and two results with its derivatives."""
    x, p = SX.sym("x", 2), SX.sym("p")
    results = [ca.vertcat(-p * x[0], p * x[0] * ca.sin(x[0])), p * x]
    return ca.Function(name, [p, x], results, ["p", "x"], ["rate", "power"])


def compiled(source: Path) -> Path:
    return compile_library([source], source.with_name(f"lib{source.stem}{SUFFIX}"))


@pytest.fixture
def generated(tmp_path) -> Path:
    return written(tmp_path, law())


def written(folder: Path, function: ca.Function) -> Path:
    """Write the C code of a function with its derivatives, and compile it."""
    generator = ca.CodeGenerator(function.name(), {"with_header": False})
    for own in (function, function.forward(1), function.jacobian()):
        generator.add(own)
    source = folder / f"{function.name()}.c"
    source.write_text(generator.dump())
    compiled(source)
    return source


@pytest.fixture
def by_hand(tmp_path) -> Path:
    source = tmp_path / "bare.c"
    source.write_text(BY_HAND)
    (tmp_path / "sizes.h").write_text("#define RATE 2\n")
    compiled(source)
    return source


def imported(source: Path, how: str) -> ca.Function:
    if how == "compiled by CasADi":
        return ca.external("law", ca.Importer(str(source), "shell"))
    return ca.external("law", str(source.with_name(f"liblaw{SUFFIX}")))


def model(function: ca.Function, kind=MX) -> cosim.Dae:
    x, p = kind.sym("x", 2), kind.sym("p")
    rate, power = function.call([p, x])
    system = {"x": x, "p": p, "ode": rate}
    return cosim.from_casadi(system, {"x": [1.0, np.cos(1.0)], "p": 2.0}, {"power": power})


def judge(run: cosim.Trajectory) -> None:
    for name, value in EXACT.items():
        assert run[name][-1] == pytest.approx(value, abs=1e-7)
    assert run["power_1"][-1] == pytest.approx(2 * EXACT["x_1"], abs=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("how", ["a library with its C code", "compiled by CasADi"])
def test_library_is_right_in_machine_code_and_fmus(generated, how, tmp_path):
    dae = model(imported(generated, how))
    for options in ({"compiled": False}, {"compiled": True}, {"solver": "dop853"}):
        run = cosim.simulate(dae, **END, **options)
        judge(run)
        assert run.stats["compiled"] == options.get("compiled", True)
    path = cosim.export_fmu(dae, tmp_path / "m.fmu")
    assert "sources/external_law.c" in zipfile.ZipFile(path).namelist()
    for interface in ("ModelExchange", "CoSimulation"):
        judge(cosim.simulate_fmu(path, interface=interface, **END))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["reset", "advance"])  # functions of the runtime, too
def test_library_may_have_the_name_of_a_function_of_the_runtime(name, tmp_path):
    library = written(tmp_path, law(name)).with_name(f"lib{name}{SUFFIX}")
    path = cosim.export_fmu(model(ca.external(name, str(library))), tmp_path / "m.fmu")
    judge(cosim.simulate_fmu(path, **END))


@pytest.mark.slow
@pytest.mark.parametrize("solver", ["rosenbrock", "erk"])
def test_generated_integrators_call_the_library(generated, solver, tmp_path):
    dae = model(imported(generated, ""), SX)
    judge(cosim.simulate(dae, solver=solver, compiled=True, **END))
    path = cosim.export_fmu(dae, tmp_path / "m.fmu", solver=solver, fmi=3)
    judge(cosim.simulate_fmu(path, interface="CoSimulation", **END))


def test_linearization_and_ensembles_call_the_library(generated):
    dae = model(imported(generated, ""))
    found = cosim.linearize(dae, at=0.0)
    exact = [[-2.0, 0.0], [2 * (np.sin(1.0) + np.cos(1.0)), 0.0]]
    np.testing.assert_allclose(found.A, exact, rtol=1e-12, atol=1e-12)
    many = cosim.simulate_many(dae, start_values={"p": np.array([1.0, 2.0])}, stop_time=1.0)
    assert many["x_1"][:, -1] == pytest.approx(np.exp([-1.0, -2.0]), abs=1e-6)


def test_library_without_c_code_runs_interpreted_and_is_not_exported(generated, tmp_path):
    alone = tmp_path / "alone"
    alone.mkdir()
    library = Path(shutil.copy(generated.with_name(f"liblaw{SUFFIX}"), alone))
    dae = model(ca.external("law", str(library)))
    run = cosim.simulate(dae, **END)
    judge(run)
    assert not run.stats["compiled"]
    told = r"external function 'law': its C code is missing.*; put law\.c beside"
    assert "interpreted: external function 'law'" in run.stats["note"]
    for call in (
        lambda: cosim.simulate(dae, compiled=True),
        lambda: cosim.simulate(dae, solver="dop853"),
        lambda: cosim.export_fmu(dae, tmp_path / "m.fmu"),
    ):
        with pytest.raises(UsageError, match=told):
            call()
    assert not (tmp_path / "m.fmu").exists()


def test_c_code_that_differs_from_its_library_is_rejected(generated):
    dae = model(imported(generated, ""))
    generated.write_text(generated.read_text().replace("sin(", "cos("))
    with pytest.raises(UsageError, match=r"law\.c computes something else than the library"):
        cosim.simulate(dae, compiled=True)


NOISE = "((1e6 + arg[0][0]) - 1e6 - arg[0][0])"  # 1e-10 by rounding, with some compilers


@pytest.mark.parametrize(
    ("rate", "other", "same"),
    [
        ("1e-12", "1e-12", True),
        ("1e-12", "2e-12", False),
        (NOISE, "0", True),
        (1, "1.1", False),
    ],
)
def test_c_code_that_differs_in_tiny_results_is_rejected(by_hand, rate, other, same):
    sizes = by_hand.with_name("sizes.h")
    sizes.write_text(f"#define RATE {rate}\n")
    function = ca.external("bare", str(compiled(by_hand)))
    sizes.write_text(f"#define RATE {other}\n")
    if same:
        assert "external_bare.c" in sources_beside(function)
        return
    with pytest.raises(UsageError, match=r"bare\.c computes something else than the library"):
        sources_beside(function)


def test_c_code_that_does_not_compile_is_rejected(generated, tmp_path):
    dae = model(imported(generated, ""))
    generated.write_text("int law( {\n")
    with pytest.raises(
        UsageError, match=r"external function 'law': .*law\.c cannot be compiled or loaded"
    ):
        cosim.export_fmu(dae, tmp_path / "m.fmu")


@pytest.mark.slow
def test_finite_differences_stand_in_for_derivatives(by_hand, tmp_path):
    """x' = -2 sin x: tan(x/2) falls as exp -2t."""
    x, library = MX.sym("x"), str(by_hand.with_name(f"libbare{SUFFIX}"))
    with pytest.raises(UsageError, match=r"calls 'bare', an external function without derivat"):
        cosim.from_casadi({"x": x, "ode": -ca.external("bare", library)(x)})
    function = ca.external("bare", library, {"enable_fd": True})
    dae = cosim.from_casadi({"x": x, "ode": -function(x)}, {"x": 1.0})
    exact = 2 * np.arctan(np.tan(0.5) * np.exp(-2.0))
    assert cosim.simulate(dae, compiled=True, **END)["x"][-1] == pytest.approx(exact, abs=1e-7)
    path = cosim.export_fmu(dae, tmp_path / "m.fmu")
    for interface in ("ModelExchange", "CoSimulation"):
        run = cosim.simulate_fmu(path, interface=interface, **END)
        assert run["x"][-1] == pytest.approx(exact, abs=1e-7)


def test_undefined_function_is_rejected_before_it_could_end_the_process(by_hand):
    function = ca.external("bare", str(by_hand.with_name(f"libbare{SUFFIX}")))
    x = MX.sym("x")
    generator = ca.CodeGenerator("code", {"with_header": False})
    generator.add(ca.Function("caller", [x], [function(x)]))
    with pytest.raises(UsageError, match="calls 'bare', whose C code is missing"):
        cached_library("test of unlinked code", generator.dump)
