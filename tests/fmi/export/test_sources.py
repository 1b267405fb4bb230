"""The sources of an FMU, compiled by others: through CMake, and linked into programs."""

import shutil
import subprocess
import zipfile
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.util import create_cmake_project
from helpers.fmi_cases import VERSIONS
from helpers.harness import HEADERS, compiler
from helpers.small_models import decay

import cosim

pytestmark = pytest.mark.skipif(compiler() is None, reason="needs a C compiler")


def run(*command: object) -> str:
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    return done.stdout


@pytest.mark.slow
@VERSIONS
@pytest.mark.skipif(shutil.which("cmake") is None, reason="needs CMake")
def test_fmpys_cmake_project_builds_and_its_library_gives_the_same_bits(fmi, exported, tmp_path):
    path = exported("bar_on_frame/reduced", fmi)
    wanted = fmpy.simulate_fmu(str(path), stop_time=0.5, output_interval=0.1)
    create_cmake_project(path, tmp_path)
    shutil.rmtree(tmp_path / "binaries")
    run("cmake", "-S", tmp_path, "-B", tmp_path / "build", "-DCMAKE_BUILD_TYPE=Release")
    run("cmake", "--build", tmp_path / "build")
    assert [*(tmp_path / "binaries").rglob("*.so")]
    got = fmpy.simulate_fmu(str(tmp_path), stop_time=0.5, output_interval=0.1)
    for name in wanted.dtype.names:
        np.testing.assert_allclose(got[name], wanted[name], rtol=1e-12, atol=1e-15)


def compiled(path: Path, folder: Path, options: list[str]) -> Path:
    with zipfile.ZipFile(path) as archive:
        archive.extractall(folder)
    unit, made = folder / "sources/fmu.c", folder / "fmu.o"
    run(compiler(), "-std=c11", "-O1", *options, f"-I{HEADERS}", "-c", unit, "-o", made)
    return made


PROGRAM = """
#include <stdio.h>
const char *one_fmi{0}GetVersion(void);
const char *two_fmi{0}GetVersion(void);
int main(void) {{
    printf("%s %s", one_fmi{0}GetVersion(), two_fmi{0}GetVersion());
    return 0;
}}
"""


@pytest.mark.slow
@VERSIONS
def test_two_fmus_link_into_one_program(fmi, tmp_path):
    """FMI 3.0 sources name their functions themselves; of FMI 2.0 the builder does."""
    every = []
    for name, rate in (("one", 0.5), ("two", 0.7)):
        target = tmp_path / f"{name}.fmu"
        cosim.export_fmu(decay(rate=rate), target, fmi=fmi, identifier=name)
        options = [f"-DFMI2_FUNCTION_PREFIX={name}_"] if fmi == 2 else []
        every.append(compiled(target, tmp_path / name, options))
    main = tmp_path / "main.c"
    main.write_text(PROGRAM.format(fmi))
    run(compiler(), main, *every, "-o", tmp_path / "both", "-lm")
    assert run(tmp_path / "both").split() == [f"{fmi}.0"] * 2


@pytest.mark.slow
@VERSIONS
@pytest.mark.skipif(shutil.which("nm") is None, reason="needs nm")
def test_every_shared_name_has_the_models_before_it(fmi, exported, tmp_path):
    path = exported("bar_on_frame/two_body", fmi)  # with CasADi's solver
    made = compiled(path, tmp_path, ["-DFMI2_FUNCTION_PREFIX=bar_on_frame_two_body_"])
    names = {line.split()[-1] for line in run("nm", "--defined-only", "-g", made).splitlines()
             if len(line.split()) == 3}  # fmt: skip
    assert len(names) > 30  # measured 46
    assert [name for name in names if not name.startswith("bar_on_frame_two_body_")] == []
