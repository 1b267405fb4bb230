"""Results of one FMU in every installed importer, compared with the native run.

    python benchmarks/importers/importers.py [--files FOLDER]

Prints the error of the bicycle's roll angle at 2 s; the native run uses dop853 at 1e-12. The table
names importers that are not installed. Each importer runs in its own process, because some crash.
Emulators run the sources in the file, compiled for their processor together with `driver.c`.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
from fmpy import read_model_description

import cosim
from cosim.fmi.archive import DESCRIPTION
from cosim.fmi.export.build import fmi_headers

STOP, STEPS, NAME = 2.0, 200, "phi"
HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parents[1] / "tests"))


def described(path: str):
    """Return fmpy's description of a file, and the value reference of the angle."""
    description = read_model_description(path)
    (reference,) = (v.valueReference for v in description.modelVariables if v.name == NAME)
    return description, reference


def fmpy_cs(path: str) -> float:
    import fmpy

    run = fmpy.simulate_fmu(
        path, stop_time=STOP, output_interval=STOP / STEPS, output=[NAME], fmi_type="CoSimulation"
    )
    return run[NAME][-1]


def fmpy_me(path: str) -> float:
    import fmpy

    run = fmpy.simulate_fmu(
        path, stop_time=STOP, relative_tolerance=1e-10, output=[NAME], fmi_type="ModelExchange"
    )
    return run[NAME][-1]


def casadi_me(path: str) -> float:
    import casadi as ca

    fmu = ca.DaeBuilder("bicycle", path)
    f = fmu.create("f", ["t", "x", "u", "p"], ["ode"])
    t, x = ca.MX.sym("t"), ca.MX.sym("x", len(fmu.x()))
    ode = f(t, x, fmu.start(fmu.u()), fmu.start(fmu.p()))
    options = {"reltol": 1e-10, "abstol": 1e-12}
    run = ca.integrator("run", "cvodes", {"t": t, "x": x, "ode": ode}, 0, STOP, options)
    return float(run(x0=fmu.start(fmu.x()))["xf"][fmu.x().index(NAME)])


def libcosim_cs(path: str) -> float:
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimObserver import CosimObserver
    from libcosimpy.CosimSlave import CosimLocalSlave

    execution = CosimExecution.from_step_size(step_size=int(1e9 * STOP / STEPS))
    slave = execution.add_local_slave(CosimLocalSlave(path, "bicycle"))
    observer = CosimObserver.create_last_value()
    execution.add_observer(observer=observer)
    execution.simulate_until(target_time=int(1e9 * STOP))
    return observer.last_real_values(slave, [described(path)[1]])[0]


def ecos_cs(path: str) -> float:
    import ecospy

    structure = ecospy.EcosSimulationStructure()
    structure.add_model("bicycle", path)
    with ecospy.EcosSimulation(structure=structure, step_size=STOP / STEPS) as simulation:
        simulation.init()
        simulation.step(STEPS)  # step_until(2.0) stops at 1.99 s: its times are rounded sums
        value = simulation.get_real(f"bicycle::{NAME}")
        simulation.terminate()
    return value


def fmuloader_cs(path: str) -> float:
    from helpers.fmuloader_start import started

    description, reference = described(path)
    slave, read = started(path, description)
    for i in range(STEPS):
        slave.do_step(STOP * i / STEPS, STOP / STEPS)
    value = read([reference])[0]
    slave.terminate()
    slave.free_instance()
    return value


def pyfmi_cs(path: str) -> float:
    from pyfmi import load_fmu

    model = load_fmu(path, kind="CS")
    return model.simulate(final_time=STOP, options={"ncp": STEPS})[NAME][-1]


def program(*words: str) -> str:
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    return done.stdout


def fmusim(path: str, *options: str) -> float:
    with tempfile.TemporaryDirectory() as folder:
        out = str(Path(folder) / "out.csv")
        steps = ("--output-interval", str(STOP / STEPS), "--stop-time", str(STOP))
        program("fmusim", *options, *steps, "--output-file", out, path)
        return float(np.genfromtxt(out, delimiter=",", names=True)[NAME][-1])


def fmusim_cs(path: str) -> float:
    return fmusim(path, "--interface-type", "cs")


def fmusim_me(path: str) -> float:
    return fmusim(path, "--interface-type", "me", "--solver", "cvode", "--tolerance", "1e-10")


def fmucheck_cs(path: str) -> float:
    with tempfile.TemporaryDirectory() as folder:
        out = str(Path(folder) / "out.csv")
        program("fmuCheck", "-k", "cs", "-s", str(STOP), "-h", str(STOP / STEPS), "-o", out, path)
        return float(np.genfromtxt(out, delimiter=",", names=True)[NAME][-1])


def compiled(path: str, compiler: str, runner: list[str], suffix: str = "") -> float:
    description, reference = described(path)
    with tempfile.TemporaryDirectory() as folder, zipfile.ZipFile(path) as archive:
        archive.extractall(folder)
        place = Path(folder) / "sources"
        listed = ET.parse(Path(folder) / DESCRIPTION).iterfind("CoSimulation/SourceFiles/File")
        files = [str(place / file.get("name")) for file in listed]
        target = str(Path(folder) / f"driver{suffix}")
        headers = [f"-I{place}", f"-I{fmi_headers()}"]
        driver = str(HERE / "driver.c")
        program(compiler, "-O1", "-w", "-static", *headers, driver, *files, "-o", target, "-lm")
        words = (description.guid, str(reference), str(STOP), str(STEPS))
        return float(program(*runner, target, *words))


def qemu_cs(path: str) -> float:
    return compiled(path, "aarch64-linux-gnu-gcc", ["qemu-aarch64"])


def wine_cs(path: str) -> float:
    os.environ["WINEDEBUG"] = "-all"
    wine = shutil.which("wine64") or shutil.which("wine") or "/usr/lib/wine/wine64"
    return compiled(path, "x86_64-w64-mingw32-gcc", [wine], ".exe")


# function, versions of FMI, package or program
CLIENTS: dict[str, tuple[Callable[[str], float], str, str]] = {
    "fmpy, ME": (fmpy_me, "23", "fmpy"),
    "fmpy, CS": (fmpy_cs, "23", "fmpy"),
    "CasADi, ME": (casadi_me, "23", "casadi"),
    "libcosim, CS": (libcosim_cs, "23", "libcosimpy"),
    "ecos, CS": (ecos_cs, "23", "ecospy"),
    "fmuloader, CS": (fmuloader_cs, "23", "fmuloader"),
    "PyFMI, CS": (pyfmi_cs, "2", "pyfmi"),
    "fmusim, ME": (fmusim_me, "23", "fmusim"),
    "fmusim, CS": (fmusim_cs, "23", "fmusim"),
    "fmuCheck, CS": (fmucheck_cs, "2", "fmuCheck"),
    "sources on aarch64 (qemu), CS": (qemu_cs, "2", "qemu-aarch64"),
    "sources on Windows (wine), CS": (wine_cs, "2", "x86_64-w64-mingw32-gcc"),
}


def client_version(tool: str) -> str:
    """Return the version of a package or program; "" if it is not installed."""
    try:
        return version(tool)
    except PackageNotFoundError:
        pass
    if shutil.which(tool) is None:
        return ""
    done = subprocess.run([tool, "--version"], capture_output=True, text=True)
    return ((done.stdout + done.stderr).splitlines() or ["?"])[0].strip()


def exported(folder: Path, fmi: int) -> Path:
    path = folder / f"bicycle{fmi}.fmu"
    return path if path.exists() else cosim.export_fmu(cosim.load("bicycle"), path, fmi=fmi)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--files", type=Path, help="folder for bicycle2.fmu and bicycle3.fmu")
    parser.add_argument("--one", nargs=2, metavar=("CLIENT", "FILE"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        print("result", repr(float(CLIENTS[options.one[0]][0](options.one[1]))))
        return
    options.files = options.files or Path(tempfile.mkdtemp(prefix="importers"))
    dae = cosim.load("bicycle")
    run = cosim.simulate(dae, stop_time=STOP, solver="dop853", relative_tolerance=1e-12)
    expected = run[NAME][-1]
    print("| importer | version | FMI 2.0 | FMI 3.0 |\n|---|---|---|---|")
    for name, (_, versions, tool) in CLIENTS.items():
        installed = client_version(tool)
        cells = ["not installed" if not installed else "-"] * 2
        for fmi in map(int, versions) if installed else ():
            path = str(exported(options.files, fmi).absolute())
            call = [sys.executable, __file__, "--one", name, path]
            done = subprocess.run(call, capture_output=True, text=True)
            line = done.stdout.rpartition("result ")[2].strip()
            if "result " in done.stdout:
                cells[fmi - 2] = f"{abs(float(line) - expected):.1e}"
            else:
                how = f"ends the process ({done.returncode})" if done.returncode < 0 else "fails"
                why = (done.stderr.strip().splitlines() or [""])[-1][:100]
                cells[fmi - 2] = f"{how}: {why}" if why else how
        print(f"| {name} | {installed} | {cells[0]} | {cells[1]} |", flush=True)


if __name__ == "__main__":
    main()
