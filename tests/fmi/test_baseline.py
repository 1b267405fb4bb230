"""Binaries of FMUs run on every processor of their kind, whatever compiler made them where."""

import sys
import zipfile
from importlib.util import find_spec
from pathlib import Path

import pytest
from helpers.instructions import beyond_baseline, needs_objdump

import cosim
from cosim.codegen.compiler import compile_library, find_compiler
from cosim.fmi.platforms import native_target

needs_zig = pytest.mark.skipif(
    find_spec("ziglang") is None, reason="needs the bundled compiler: pip install ziglang"
)
pytestmark = [
    pytest.mark.usefixtures("optimized"),
    needs_objdump,
    pytest.mark.skipif(native_target().processor != "x86_64", reason="knows x86-64's baseline"),
]
ZIG = f"{sys.executable} -m ziglang cc"
LOOP = "void f(double *x, int n) { for (int i = 0; i < n; i++) x[i] = x[i] * x[i] + 1; }\n"


def binaries(fmu, folder):
    with zipfile.ZipFile(fmu) as archive:
        inside = [name for name in archive.namelist() if name.startswith("binaries/")]
        return [Path(archive.extract(name, folder)) for name in inside]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("compiler", "platform"),
    [
        pytest.param("", "native", id="own compiler"),
        pytest.param(ZIG, "native", id="zig as CC", marks=needs_zig),
        pytest.param("no others", "native", id="zig as the only one", marks=needs_zig),
        pytest.param("", "linux64", id="linux64", marks=needs_zig),
        pytest.param("", "win64", id="win64", marks=[needs_zig, pytest.mark.slow]),
    ],
)
def test_exported_binary_asks_for_no_more_than_every_x86_64_has(
    compiler, platform, tmp_path, monkeypatch
):
    monkeypatch.setenv("COSIM_CACHE", str(tmp_path / "cache"))
    if compiler == "no others":
        monkeypatch.delenv("CC", raising=False)
        monkeypatch.setattr("cosim.codegen.compiler.shutil.which", lambda name: None)
        assert find_compiler()[-2:] == ("ziglang", "cc")
    elif compiler:
        monkeypatch.setenv("CC", compiler)
    path = cosim.export_fmu(cosim.load("bicycle"), tmp_path / "b.fmu", platforms=[platform])
    (library,) = binaries(path, tmp_path / "extracted")
    assert beyond_baseline(library) == {}


@pytest.mark.parametrize(
    "compiler", ["", pytest.param(ZIG, marks=needs_zig)], ids=["own compiler", "zig"]
)
def test_inspection_sees_what_the_machine_of_the_build_has_beyond(compiler, tmp_path, monkeypatch):
    if compiler:
        monkeypatch.setenv("CC", compiler)
    source = tmp_path / "loop.c"
    source.write_text(LOOP)
    library = tmp_path / "loop.so"
    processor = "x86_64_v3" if compiler else "x86-64-v3"
    compile_library([source], library, options=["-O3", f"-march={processor}"])
    assert sum(beyond_baseline(library).values()) > 0


@pytest.mark.parametrize(
    ("compiler", "flag"),
    [
        (("cc",), "-march=x86-64"),
        (("gcc", "-march=native"), "-march=x86-64"),  # the last one counts
        (("zig", "cc"), "-mcpu=baseline"),
        (("/opt/zig-0.13/zig.exe", "cc"), "-mcpu=baseline"),
        ((sys.executable, "-m", "ziglang", "cc"), "-mcpu=baseline"),
        (("/home/zig/bin/gcc",), "-march=x86-64"),
    ],
)
def test_baseline_is_named_as_the_compiler_calls_it(compiler, flag):
    assert flag in native_target().options("model.so", compiler)
