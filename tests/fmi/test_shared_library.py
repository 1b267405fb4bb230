"""Shared libraries read as files, against what the compiler and the loader say of them."""

import ctypes
import re
import shutil
import struct
import subprocess
import sys
from pathlib import Path

import pytest
from helpers.harness import compiler

from cosim.codegen.compiler import compile_library, find_compiler
from cosim.fmi.shared_library import fat_library, read_libraries

CODE = """
static int hidden(void) { return 1; }
int shown(void) { return hidden(); }
double also_shown = 2.0;
__attribute__((visibility("hidden"))) int inside(void) { return 3; }
"""
native = pytest.mark.skipif(sys.platform != "linux", reason="reads what gcc makes on Linux")


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    folder = tmp_path_factory.mktemp("library")
    (folder / "code.c").write_text(CODE)
    return compile_library([folder / "code.c"], folder / "code.so", command=[compiler()])


@native
def test_exports_are_what_the_loader_finds(library):
    (read,) = read_libraries(library.read_bytes())
    assert read.system == "linux"
    assert read.exports & {"shown", "also_shown", "hidden", "inside"} == {"shown", "also_shown"}
    loaded = ctypes.CDLL(str(library))
    assert all(hasattr(loaded, name) for name in read.exports)


@native
@pytest.mark.skipif(shutil.which("nm") is None, reason="needs nm of the binutils")
def test_exports_are_what_nm_prints(library):
    (read,) = read_libraries(library.read_bytes())
    command = ["nm", "-D", "--defined-only", str(library)]
    printed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert read.exports == {line.split()[-1] for line in printed.splitlines()}


@native
@pytest.mark.parametrize("keep", [5, 20, 64, 1000])
def test_cut_library_is_told(library, keep):
    with pytest.raises(ValueError, match=r"damaged|not a"):
        read_libraries(library.read_bytes()[:keep])


def mach(processor: int, symbols: dict[str, int]) -> bytes:
    """Return a minimal Mach-O library: header, one symbol table, names."""
    names, table = b"\0", b""
    for name, flags in symbols.items():
        table += struct.pack("<IBBHQ", len(names), flags, 1, 0, 0)
        names += b"_" + name.encode() + b"\0"
    header = struct.pack("<8I", 0xFEEDFACF, processor, 0, 6, 1, 24, 0, 0)
    command = struct.pack("<6I", 2, 24, 56, len(symbols), 56 + len(table), len(names))
    return header + command + table + names


INTEL, ARM = 0x01000007, 0x0100000C


def test_fat_library_holds_every_processor_on_a_page_of_its_own():
    slices = [mach(INTEL, {"a": 0x0F}), mach(ARM, {"a": 0x0F, "private": 0x1F, "local": 0x0E})]
    fat = fat_library(slices)
    assert [(one.processor, one.exports) for one in read_libraries(fat)] == [
        ("x86_64", {"a"}),
        ("aarch64", {"a"}),
    ]
    for i, content in enumerate(slices):
        _, _, start, size, power = struct.unpack_from(">5I", fat, 8 + 20 * i)
        assert start % 2**power == 0
        assert fat[start : start + size] == content


def test_only_mach_libraries_become_fat():
    with pytest.raises(ValueError, match="only Mach-O"):
        fat_library([b"\x7fELF"])


@pytest.mark.parametrize(
    "content",
    [b"", b"text", b"\x7fELF\x01\x01", b"MZ" + bytes(100), b"\xcf\xfa\xed\xfe" + bytes(40)],
)
def test_what_is_no_library_is_told(content):
    with pytest.raises(ValueError, match=r"damaged|not a|no shared"):
        read_libraries(content)


def test_endless_command_in_a_mach_library_is_told():
    content = struct.pack("<8I", 0xFEEDFACF, ARM, 0, 6, 2**32 - 1, 24, 0, 0) + bytes(64)
    with pytest.raises(ValueError, match="damaged"):
        read_libraries(content)


@native
@pytest.mark.skipif(shutil.which("readelf") is None, reason="needs readelf of the binutils")
def test_imports_versions_and_run_paths_are_what_readelf_prints(tmp_path):
    (tmp_path / "code.c").write_text("#include <math.h>\ndouble f(double x) { return pow(x, x); }")
    target = tmp_path / "code.so"
    options = ["-shared", "-fPIC", "-Wl,-rpath,/opt/own:$ORIGIN/a", "-o", str(target)]
    subprocess.run([*find_compiler(), str(tmp_path / "code.c"), *options, "-lm"], check=True)
    (read,) = read_libraries(target.read_bytes())
    command = ["readelf", "-dVW", str(target)]
    printed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert read.needs == set(re.findall(r"Shared library: \[(.*?)\]", printed))
    assert read.versions == set(re.findall(r"Name: (\S+)", printed))
    assert read.run_paths == ("/opt/own", "$ORIGIN/a")


@pytest.mark.skipif(shutil.which("objdump") is None, reason="needs objdump of the binutils")
def test_needs_and_exports_of_a_windows_library_are_what_objdump_prints():
    package = pytest.importorskip("pythonfmu").__file__
    path = Path(package).parent / "resources" / "binaries" / "win64" / "pythonfmu-export.dll"
    (read,) = read_libraries(path.read_bytes())
    done = subprocess.run(["objdump", "-p", str(path)], capture_output=True, text=True)
    if done.returncode:
        pytest.skip("this objdump does not read Windows libraries")
    assert read.needs == set(re.findall(r"DLL Name: (\S+)", done.stdout))
    assert len(read.needs) > 3
    assert all(f" {name}\n" in done.stdout for name in read.exports)


@native
@pytest.mark.skipif(shutil.which("nm") is None, reason="needs nm of the binutils")
def test_undefined_names_without_a_version_are_what_nm_prints():
    package = pytest.importorskip("pythonfmu").__file__
    path = Path(package).parent / "resources" / "binaries" / "linux64" / "libpythonfmu-export.so"
    (read,) = read_libraries(path.read_bytes())
    command = ["nm", "-D", "--undefined-only", "--with-symbol-versions", str(path)]
    printed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    lines = [line.split() for line in printed.splitlines()]
    assert read.undefined == {name for kind, name in lines if kind == "U" and "@" not in name}
