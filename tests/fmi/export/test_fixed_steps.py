"""FMUs for controllers: fixed steps, no derivatives, no heap."""

import os
import shutil
import subprocess
import sys
import zipfile
from importlib.util import find_spec
from pathlib import Path
from xml.etree import ElementTree as ET

import casadi as ca
import numpy as np
import pytest
from helpers import event_models
from helpers.oscillators import oscillator

import cosim
from cosim.cli.main import main
from cosim.codegen.fmu.solver import is_unstable
from cosim.errors import UnknownName, UsageError
from cosim.fmi.export.build import fmi_headers
from cosim.fmi.trust import remember

ORDERS = {"rk4": 4, "ode8": 8}


def error(known, path):
    """Return the error of the place at 5 s."""
    run = cosim.simulate_fmu(path, interface="CoSimulation", output_interval=0.5)
    return abs(run["x"][-1] - known.solution(run.time)[0][-1])


@pytest.mark.slow
@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("algebraic", [False, True])
@pytest.mark.parametrize("solver", ORDERS)
def test_error_falls_with_the_order_of_the_method(solver, algebraic, fmi, tmp_path):
    known = oscillator(algebraic=algebraic)
    errors = [
        error(
            known,
            cosim.export_fmu(known.dae, tmp_path / "o.fmu", fmi=fmi, solver=solver, step_size=h),
        )
        for h in (0.5, 0.25)
    ]
    assert errors[0] / errors[1] > 0.8 * 2 ** ORDERS[solver]  # measured 16 and 300


@pytest.mark.parametrize("fmi", [2, 3])
def test_states_that_steps_inside_an_fmu_let_grow_are_noted(fmi, tmp_path):
    model = cosim.Model("stiff", stop_time=10.0, output_interval=0.1)
    x = model.state("x", "1", 1.0, "x")
    model.derivative(x, -100 * x)
    with pytest.warns(UserWarning, match="too long for rk4"):
        path = cosim.export_fmu(model.freeze(), tmp_path / "s.fmu", fmi=fmi, solver="rk4")
    for master in ("fmpy", "c"):
        run = cosim.simulate_fmu(path, master=master)
        assert "x grows to 2e+246; if the model does not" in run.stats["note"]  # before: no note
    assert "note" not in cosim.simulate_fmu(path, stop_time=0.5)  # 2e12


@pytest.mark.slow
@pytest.mark.parametrize("step", [0.01, 0.003])
def test_steps_are_those_of_native_simulation(step, tmp_path):
    dae = cosim.load("bicycle")
    path = cosim.export_fmu(dae, tmp_path / "b.fmu", solver="rk4", step_size=step)
    run = cosim.simulate_fmu(path, interface="CoSimulation", stop_time=1)
    native = cosim.simulate(dae, solver="rk4", step_size=step, stop_time=1)
    assert cosim.compare(native, run).worst.scaled < 1e-12  # measured 3e-15


@pytest.mark.slow
def test_event_divides_a_step(tmp_path):
    path = cosim.export_fmu(event_models.ball(), tmp_path / "ball.fmu", solver="rk4")
    run = cosim.simulate_fmu(path, interface="CoSimulation")
    native = cosim.simulate(event_models.ball(), solver="dop853")
    np.testing.assert_allclose(run["h"], native["h"], rtol=0, atol=1e-9)  # parabolas: exact


def test_description_tells_the_step(tmp_path):
    path = cosim.export_fmu(oscillator().dae, tmp_path / "o.fmu", fmi=3, solver="rk4")
    with zipfile.ZipFile(path) as fmu:
        root = ET.fromstring(fmu.read("modelDescription.xml"))
    assert root.find("CoSimulation").get("fixedInternalStepSize") == "0.01"


@pytest.mark.slow
@pytest.mark.parametrize("fmi", [2, 3])
def test_without_derivatives_the_results_have_the_same_bits(fmi, tmp_path):
    dae = cosim.load("disk_two_bars")
    whole, small = (
        cosim.export_fmu(dae, tmp_path / f"{derivatives}.fmu", fmi=fmi, derivatives=derivatives)
        for derivatives in (True, False)
    )
    assert small.stat().st_size < 0.85 * whole.stat().st_size
    for interface in ("CoSimulation", "ModelExchange"):
        runs = [
            cosim.simulate_fmu(path, interface=interface, stop_time=0.5) for path in (whole, small)
        ]
        np.testing.assert_array_equal(runs[0].values, runs[1].values)
    with zipfile.ZipFile(small) as fmu:
        assert b"irectionalDerivative" not in fmu.read("modelDescription.xml")
    assert cosim.check_fmu(small) == []


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        ({"step_size": 0.01}, "step_size is for other solvers: rk4 and ode8"),
        ({"solver": "rk4", "max_step": 0.1}, "max_step is for other solvers: the adaptive ones"),
        ({"solver": "rk4", "step_size": -1.0}, "step_size = -1"),
        ({"solver": "rk4", "step_size": 1e-300}, "step_size = 1e-300 s makes more than"),
        ({"max_step": 1e-300}, "max_step = 1e-300 s is within the rounding of times up to"),
        ({"fmi": 3, "adjoint": True, "derivatives": False}, "adjoint needs derivatives"),
    ],
)
def test_options_that_contradict_each_other_are_rejected(options, problem, tmp_path):
    with pytest.raises(UsageError, match=problem):
        cosim.export_fmu(oscillator().dae, tmp_path / "o.fmu", **options)
    assert not list(tmp_path.iterdir())


def test_unknown_solver_is_rejected_with_all_names(tmp_path):
    for name in ("ode7", "cvodes"):  # a solver of native runs; its name is near that of ode8
        known = f"an FMU has no solver '{name}'; choose one of dop853, erk, rosenbrock, rk4, ode8"
        with pytest.raises(UnknownName, match=f"^{known}$"):
            cosim.export_fmu(oscillator().dae, tmp_path / "o.fmu", solver=name)


@pytest.mark.slow
def test_command_line(tmp_path):
    path = tmp_path / "crank.fmu"
    words = ["export", "crank_shaft", "--solver", "rk4", "--step-size", "1ms", "-o", str(path)]
    assert main([*words, "--no-derivatives", "-q"]) == 0
    with zipfile.ZipFile(path) as fmu:
        header = fmu.read("sources/model.h").decode()
    assert "#define LARGEST_STEP 0.001\n" in header
    assert "#define NO_DERIVATIVES 1\n" in header


# -- a static instance ----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def sources(tmp_path_factory):
    """Return the folder of the sources of an FMU for a controller, and the FMU."""
    folder = tmp_path_factory.mktemp("static")
    path = cosim.export_fmu(
        cosim.load("crank_shaft"), folder / "c.fmu", solver="rk4", step_size=1e-3, derivatives=False
    )
    with zipfile.ZipFile(path) as fmu:
        fmu.extractall(folder)
    return folder / "sources", path


STATIC = ["-std=c11", "-O1", "-ffp-contract=off", "-DFMU_STATIC=65536", f"-I{fmi_headers()}"]


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="a command line of cc")
@pytest.mark.skipif(not (shutil.which("cc") and shutil.which("nm")), reason="no cc and nm")
def test_static_instance_needs_no_heap_and_gives_the_same_bits(sources, tmp_path):
    folder, path = sources
    with zipfile.ZipFile(path) as fmu:
        files = {entry: fmu.read(entry) for entry in fmu.namelist()}
    name = next(entry for entry in files if entry.startswith("binaries/"))
    library = tmp_path / "static.so"
    subprocess.run(
        [
            "cc",
            "-shared",
            "-fPIC",
            *STATIC,
            f"-I{folder}",
            folder / "fmu.c",
            "-lm",
            "-o",
            str(library),
        ],
        check=True,
    )
    used = subprocess.run(["nm", "-u", library], check=True, capture_output=True, text=True).stdout
    assert not any(word in used for word in ("malloc", "calloc", "free", "printf", "puts"))

    static = tmp_path / "static.fmu"
    with zipfile.ZipFile(static, "w") as fmu:
        for entry, content in {**files, name: library.read_bytes()}.items():
            fmu.writestr(entry, content)
    remember(static.read_bytes())
    runs = [cosim.simulate_fmu(p, interface="CoSimulation", stop_time=1) for p in (path, static)]
    np.testing.assert_array_equal(runs[0].values, runs[1].values)


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("arm-none-eabi-gcc") is None, reason="no GNU toolchain for ARM")
def test_toolchain_of_controllers_compiles_it(sources, tmp_path):
    """Its 32-bit integers are of the type long, unlike those of FMI 2."""
    folder, _ = sources
    options = ["-std=c11", "-mcpu=cortex-m7", "-Os", "-Wall", "-Werror", *STATIC, f"-I{folder}"]
    target = tmp_path / "fmu.o"
    command = ["arm-none-eabi-gcc", *options, "-c", folder / "fmu.c", "-o", target]
    subprocess.run(command, check=True)


@pytest.mark.slow
@pytest.mark.skipif(find_spec("ziglang") is None, reason="no ziglang")
def test_controller_compiles_it(sources, tmp_path):
    import ziglang

    folder, _ = sources
    include = Path(ziglang.__file__).parent / "lib" / "libc" / "include"
    compiler = [sys.executable, "-m", "ziglang", "cc", "-target", "thumb-freestanding-eabihf"]
    headers = ["-isystem", include / "arm-linux-musl", "-isystem", include / "generic-musl"]
    target = tmp_path / "fmu.o"
    options = ["-mcpu=cortex_m7", "-Wall", "-Werror", *STATIC, *headers, f"-I{folder}"]
    subprocess.run([*compiler, *options, "-c", folder / "fmu.c", "-o", target], check=True)
    assert target.read_bytes()[:4] == b"\x7fELF"


@pytest.mark.parametrize(("solver", "limit"), [("rk4", 2.785), ("ode8", 5.02)])
@pytest.mark.parametrize("rate", [-100.0, 100.0])
def test_steps_beyond_the_limit_of_stability_are_warned_of(rate, solver, limit):
    model = cosim.Model("linear", stop_time=10.0, output_interval=0.1)
    x = model.state("x", "1", 1.0, "x")
    model.derivative(x, rate * x)
    dae = model.freeze()
    unstable = [is_unstable(dae, solver, share * limit / 100) for share in (0.98, 1.1)]
    assert unstable == [False, rate < 0]


@pytest.mark.parametrize("seed", range(8))
def test_undamped_modes_are_found_unstable_whatever_rounding_makes_of_them(seed):
    """Mixed states of two oscillators; the limit of `rk4` is 2 sqrt(2) over the fastest rate."""
    mix = np.random.default_rng(seed).normal(size=(4, 4))
    matrix = np.zeros((4, 4))
    matrix[:2, 2:] = np.eye(2)
    matrix[2:, :2] = -np.diag([900.0, 400.0])
    matrix = mix @ matrix @ np.linalg.inv(mix)
    model = cosim.Model("oscillators", stop_time=10.0, output_interval=0.1)
    x = ca.vertcat(*(model.state(f"x_{i}", "1", 1.0, "x") for i in range(4)))
    for i in range(4):
        model.derivative(x[i], ca.dot(ca.DM(matrix[i]), x))
    dae = model.freeze()
    steps = [share * 2 * np.sqrt(2) / 30 for share in (0.98, 1.1)]
    assert [is_unstable(dae, "rk4", step) for step in steps] == [False, True]
