"""Files of others: what is found on them is true, and nothing else is found.

The FMI's own Reference FMUs are looked for in the folder $REFERENCE_FMUS, as their build leaves
them (`cmake -D FMI_VERSION=2`, and 3), e.g. in `build2/fmus` and `build3/fmus` below it.
"""

import os
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from cosim.codegen.compiler import find_compiler
from cosim.errors import SecurityError
from cosim.fmi.check.check import examine
from cosim.fmi.check.finding import ADVICE
from cosim.fmi.check.isolated import try_apart

SLAVE = """
from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real

class Decay(Fmi2Slave):
    def __init__(self, **options):
        super().__init__(**options)
        self.rate, self.y = 0.5, 1.0
        self.register_variable(Real("rate", causality=Fmi2Causality.parameter,
                                    variability=Fmi2Variability.tunable))
        self.register_variable(Real("y", causality=Fmi2Causality.output))

    def do_step(self, time, size):
        self.y -= {fault}self.rate * self.y * size
        return True
"""
LOADER = r"""
#include <dlfcn.h>
#include <stdio.h>
int main(int n, char **words) {
    return !dlopen(words[n - 1], RTLD_NOW) && puts(dlerror()) >= 0;
}
"""
REFERENCE = sorted(Path(os.environ.get("REFERENCE_FMUS", "/nowhere")).rglob("*.fmu"))


@pytest.fixture(scope="module")
def python_fmu(tmp_path_factory):
    """Return a function that makes an FMU of a Python class."""
    builder = pytest.importorskip("pythonfmu.builder")

    def make(fault: str = "") -> Path:
        folder = tmp_path_factory.mktemp("slave")
        (folder / "decay.py").write_text(SLAVE.format(fault=fault))
        return Path(builder.FmuBuilder.build_FMU(folder / "decay.py", dest=folder))

    return make


@pytest.mark.skipif(sys.platform != "linux", reason="the libraries for Linux are looked at")
def test_file_of_pythonfmu_needs_a_program_that_holds_python(python_fmu, tmp_path):
    path = python_fmu()
    found = examine(path)
    assert {f.level for f in found} == {ADVICE}
    (told,) = (f for f in found if f.rule == "undefined")
    assert "PyBool_FromLong" in told.found
    with zipfile.ZipFile(path) as archive:
        library = archive.extract(told.place, tmp_path)
    (tmp_path / "loader.c").write_text(LOADER)
    loader = str(tmp_path / "loader")
    subprocess.run([*find_compiler(), loader + ".c", "-o", loader, "-ldl"], check=True)
    done = subprocess.run([loader, library], capture_output=True, text=True)
    assert re.search("undefined symbol: _?Py", done.stdout)  # what a program in C gets


@pytest.mark.slow
def test_file_of_pythonfmu_passes_the_trials(python_fmu):
    verdict = try_apart(python_fmu(), timeout=24.0)
    found = {(f.level, f.rule) for f in verdict.findings}
    # its instances keep 8 kB each, also under fmpy alone
    assert {(ADVICE, "stop")} <= found <= {(ADVICE, "stop"), (ADVICE, "memory")}


@pytest.mark.slow
def test_error_in_a_step_is_told_once(python_fmu):
    found = try_apart(python_fmu("missing + "), timeout=24.0).findings
    failed = [f for f in found if f.level != ADVICE]
    assert [f.rule for f in failed] == ["reset", "steps"]
    assert all("fmi2DoStep failed" in f.found for f in failed)


@pytest.mark.skipif(not REFERENCE, reason="$REFERENCE_FMUS names no folder with FMUs")
@pytest.mark.parametrize("path", REFERENCE, ids=lambda p: f"{p.parent.parent.name}-{p.stem}")
def test_reference_fmus_have_nothing_wrong(path):
    if path.stem.startswith("Roberts"):  # packed twice by its own build
        with pytest.raises(SecurityError, match="occurs twice"):
            examine(path)
        return
    assert examine(path) == ()
    if path.stem.startswith("Clocks"):  # scheduled execution, which cannot be run here
        return
    found = {(f.level, f.rule) for f in try_apart(path, timeout=24.0).findings}
    # their solver is Euler's method; FMI 2.0 has no place to declare its step
    second = {(ADVICE, "logger"), (ADVICE, "motion")} if "build2" in str(path) else set()
    assert found <= {(ADVICE, "fixed"), *second}
