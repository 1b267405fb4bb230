"""Cost of an FMU in addition to its equations, for the bicycle.

1. Co-simulation of 2001 outputs through fmpy, compared with an FMU of that interface that computes
   nothing.
2. A C loop over model exchange, compared with the bare compiled right-hand side.
3. The columns of the state Jacobian by getDirectionalDerivative, compared with forward differences.
4. Instantiation and release.
5. A C loop over co-simulation, by solver.
6. 2001 outputs through both interfaces: fmpy compared with the compiled master.

Times are medians of interleaved repeats; compare their ratios. `--short` repeats twice.
"""

import argparse
import ctypes
import statistics
import subprocess
import tempfile
import zipfile
from pathlib import Path
from time import perf_counter, thread_time

import cosim
from casadi_models.dae import Dae, Model
from cosim.codegen.compiler import FLAGS, find_compiler
from cosim.fmi.export.build import fmi_headers
from cosim.fmi.platforms import native_target

REPEATS = 15
SHORT_REPEATS = 60  # of loops in C, so short that other processes seldom interrupt them
DRIVER = r"""
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
#include "fmu.c"

static double now(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void ignore(fmi2ComponentEnvironment e, fmi2String n, fmi2Status s, fmi2String c,
                   fmi2String m, ...) {
    (void)e, (void)n, (void)s, (void)c, (void)m;
}

__attribute__((visibility("default")))
void time_calls(int count, double results[5]) {
    static const fmi2CallbackFunctions host = {ignore, calloc, free, NULL, NULL};
    double start = now();
    fmi2Component fmu = NULL;
    for (int i = 0; i < 100; i++) {
        if (fmu) fmi2FreeInstance(fmu);
        fmu = fmi2Instantiate("fmu", fmi2ModelExchange, MODEL_GUID, NULL, &host, 0, 0);
    }
    results[0] = (now() - start) / 100;
    fmi2SetupExperiment(fmu, 0, 0, 0, 0, 0);
    fmi2EnterInitializationMode(fmu);
    fmi2ExitInitializationMode(fmu);
    fmi2EventInfo event;
    fmi2NewDiscreteStates(fmu, &event);
    fmi2EnterContinuousTimeMode(fmu);
    double x[NX], dx[NX], sum = 0;
    fmi2GetContinuousStates(fmu, x, NX);

    start = now();
    for (int i = 0; i < count; i++) {
        fmi2SetTime(fmu, 1e-2 * i);
        x[0] = 1e-6 * i;
        fmi2SetContinuousStates(fmu, x, NX);
        fmi2GetDerivatives(fmu, dx, NX);
        sum += dx[6];
    }
    results[1] = (now() - start) / count;

    long long sizes[4];
    model_ode_work(&sizes[0], &sizes[1], &sizes[2], &sizes[3]);
    const double **arg = calloc((size_t)sizes[0] + 9, sizeof *arg);
    double **res = calloc((size_t)sizes[1] + 9, sizeof *res);
    double *w = calloc((size_t)sizes[3] + 9, sizeof *w), p[NP], u[NU] = {0}, t = 0;
    fmi2ValueReference reference = 0;
    for (int i = 0; i < NP; i++) {
        reference = (fmi2ValueReference)(1 + 2 * NX + NZ + NU + i);
        fmi2GetReal(fmu, &reference, 1, &p[i]);
    }
    arg[0] = &t, arg[1] = x, arg[3] = u, arg[4] = p, res[0] = dx;
    start = now();
    for (int i = 0; i < count; i++) {
        x[0] = 1e-6 * i;
        model_ode(arg, res, NULL, w, 0);
        sum += dx[6];
    }
    results[2] = (now() - start) / count;

    fmi2ValueReference unknowns[NX];
    for (int i = 0; i < NX; i++) unknowns[i] = (fmi2ValueReference)(1 + NX + i);
    const double seed = 1;
    start = now();
    for (int i = 0; i < count; i++) {
        x[0] = 1e-6 * i;
        fmi2SetContinuousStates(fmu, x, NX);
        for (fmi2ValueReference known = 1; known <= NX; known++) {
            fmi2GetDirectionalDerivative(fmu, unknowns, NX, &known, 1, &seed, dx);
            sum += dx[6];
        }
    }
    results[3] = (now() - start) / count / NX;

    start = now();
    for (int i = 0; i < count; i++) {
        double moved[NX];
        x[0] = 1e-6 * i;
        fmi2SetContinuousStates(fmu, x, NX);
        fmi2GetDerivatives(fmu, dx, NX);
        for (int column = 0; column < NX; column++) {
            const double before = x[column];
            x[column] += 1e-8;
            fmi2SetContinuousStates(fmu, x, NX);
            fmi2GetDerivatives(fmu, moved, NX);
            sum += (moved[6] - dx[6]) / 1e-8;
            x[column] = before;
        }
    }
    results[4] = (now() - start) / count / NX + 0 * sum;
    free(arg), free(res), free(w);
    fmi2FreeInstance(fmu);
}

__attribute__((visibility("default")))
double co_simulate(int count, double step) {
    static const fmi2CallbackFunctions host = {ignore, calloc, free, NULL, NULL};
    fmi2Component fmu = fmi2Instantiate("fmu", fmi2CoSimulation, MODEL_GUID, NULL, &host, 0, 0);
    fmi2SetupExperiment(fmu, 0, 0, 0, 0, 0);
    fmi2EnterInitializationMode(fmu);
    fmi2ExitInitializationMode(fmu);
    const double start = now();
    for (int i = 0; i < count; i++) fmi2DoStep(fmu, i * step, step, 1);
    const double taken = now() - start;
    fmi2FreeInstance(fmu);
    return taken / count;
}
"""
SOLVERS = ("dop853", "erk", "rosenbrock")


def do_nothing(dae: Dae) -> Dae:
    """Return a model with the same inputs, parameters and recorded outputs, and no equations."""
    model = Model("nothing", description="same interface, no work", stop_time=20.0)
    for variable in dae.inputs:
        model.input(variable.name, variable.unit, 0.0, variable.meaning)
    for variable in dae.parameters:
        model.parameter(variable.name, variable.unit, variable.start, variable.meaning)
    for variable in (*dae.states, *dae.output_variables):
        model.output(variable.name, variable.unit, 1.0, variable.meaning)
    return model.freeze()


def co_simulation(path: Path) -> float:
    began = perf_counter()
    run = cosim.simulate_fmu(path, interface="CoSimulation", stop_time=20, output_interval=0.01)
    assert len(run) == 2001
    return perf_counter() - began


def _fastest_tenth(times: list[float]) -> float:
    return statistics.quantiles(times, n=10, method="inclusive")[0]


def masters(path: Path, repeats: int) -> None:
    """Print the total time of a run by master: the fastest tenth of the repeats."""
    for interface in ("ModelExchange", "CoSimulation"):
        times: dict[str, list[float]] = {"fmpy": [], "c": []}
        for _ in range(repeats):
            for master, taken in times.items():
                began = thread_time()
                cosim.simulate_fmu(
                    path, interface=interface, stop_time=20, output_interval=0.01, master=master
                )
                taken.append(thread_time() - began)
        slow, fast = (_fastest_tenth(times[master]) for master in ("fmpy", "c"))
        print(f"{interface}, 2001 outputs: fmpy {slow * 1e3:.0f} ms, compiled master "
              f"{fast * 1e3:.1f} ms, ratio {slow / fast:.0f}")  # fmt: skip


def c_loop(fmu: Path, folder: Path) -> ctypes.CDLL:
    with zipfile.ZipFile(fmu) as archive:
        archive.extractall(folder)
    sources = folder / "sources"
    (sources / "driver.c").write_text(DRIVER)
    library = folder / "driver.so"
    compiler = find_compiler()
    options = [*FLAGS, *native_target().options(library.name, compiler), "-std=gnu11"]
    folders = [f"-I{fmi_headers()}", f"-I{sources}"]
    driver = str(sources / "driver.c")  # in one unit with the FMU, whose functions are static
    call = [*compiler, *options, *folders, driver, "-o", str(library), "-lm"]
    subprocess.run(call, check=True)
    return ctypes.CDLL(str(library))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--short", action="store_true", help="repeat twice")
    short = parser.parse_args().short
    repeats, short_repeats = (2, 2) if short else (REPEATS, SHORT_REPEATS)
    dae = cosim.load("bicycle")
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        paths = {
            "bicycle": cosim.export_fmu(dae, place / "bicycle.fmu"),
            "nothing": cosim.export_fmu(do_nothing(dae), place / "nothing.fmu"),
        }
        times: dict[str, list[float]] = {name: [] for name in paths}
        for _ in range(repeats):
            for name, path in paths.items():
                times[name].append(co_simulation(path))
        busy, idle = (statistics.median(times[name]) for name in ("bicycle", "nothing"))
        print(f"fmpy, co-simulation, 2001 outputs: {busy * 1e3:.1f} ms, "
              f"doing nothing {idle * 1e3:.1f} ms, ratio {busy / idle:.2f}")  # fmt: skip
        masters(paths["bicycle"], repeats)

        loops = {}
        for solver in SOLVERS:
            path = cosim.export_fmu(dae, place / f"{solver}.fmu", solver=solver)
            loops[solver] = c_loop(path, place / solver)
            loops[solver].co_simulate.restype = ctypes.c_double
        steps: dict[str, list[float]] = {solver: [] for solver in SOLVERS}
        driver = loops["dop853"]
        rows = []
        for _ in range(short_repeats):
            results = (ctypes.c_double * 5)()
            driver.time_calls(200, results)
            rows.append(list(results))
            for solver, loop in loops.items():
                steps[solver].append(loop.co_simulate(2000, ctypes.c_double(0.01)))
    create, me, bare, column, difference = (statistics.median(c) for c in zip(*rows, strict=True))
    print(f"instantiate and free: {create * 1e6:.1f} us")
    print(f"model exchange, one evaluation: {me * 1e9:.0f} ns, bare {bare * 1e9:.0f} ns, "
          f"ratio {me / bare:.2f}")  # fmt: skip
    print(f"directional derivatives, a column: {column * 1e9:.0f} ns, forward difference "
          f"{difference * 1e9:.0f} ns, ratio {column / difference:.2f}")  # fmt: skip
    shown = ", ".join(f"{solver} {1e6 * statistics.median(t):.2f}" for solver, t in steps.items())
    print(f"co-simulation from C, a step of 0.01 s, us: {shown}")


if __name__ == "__main__":
    main()
