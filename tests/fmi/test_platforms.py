"""Platforms: FMI's folder names, and binaries for other systems from this machine."""

import os
import shutil
import subprocess
import sys
import zipfile
from importlib.util import find_spec
from pathlib import Path

import pytest
from helpers.small_models import decay

import cosim
from cosim.errors import ExportError, MissingTool, UnknownName
from cosim.fmi import platforms
from cosim.fmi.check.check import check_fmu, required_functions
from cosim.fmi.platforms import PLATFORMS, native_target, targets
from cosim.fmi.shared_library import read_libraries

needs_zig = pytest.mark.skipif(
    find_spec("ziglang") is None, reason="needs the bundled compiler: pip install ziglang"
)


@pytest.mark.parametrize(
    ("fmi", "folders"),
    [
        (2, {"linux64", "win64", "darwin64"}),
        (
            3,
            {
                "x86_64-linux",
                "x86_64-windows",
                "x86_64-darwin",
                "aarch64-darwin",
                "aarch64-linux",
            },
        ),
    ],
)
def test_all_platforms_have_the_folders_of_the_standard(fmi, folders):
    assert set(targets(["all"], fmi)) == folders


def test_macos_is_one_folder_of_two_processors_in_fmi_2():
    assert [t.processor for t in targets(["darwin64"], 2)["darwin64"]] == ["x86_64", "aarch64"]


def test_naming_a_platform_twice_is_naming_it_once():
    assert targets(["win64", "win64"], 2) == targets(["win64"], 2)


@pytest.mark.parametrize(
    ("names", "fmi", "error", "reason"),
    [
        (["linux65"], 2, UnknownName, "no platform 'linux65'; did you mean linux64"),
        ([""], 2, UnknownName, "no platform ''"),
        ([], 2, ExportError, "needs a platform"),
        (["aarch64-linux"], 2, ExportError, r"FMI 2\.0 has no folder for aarch64-linux"),
    ],
)
def test_platform_that_does_not_exist_is_refused(names, fmi, error, reason):
    with pytest.raises(error, match=reason):
        targets(names, fmi)


def test_native_platform_and_its_own_name_do_not_mix():
    own = native_target().folder(2)
    with pytest.raises(ExportError, match="are one folder here"):
        targets(["native", own], 2)


@pytest.mark.parametrize(
    ("system", "processor", "reason"),
    [("sunos5", "x86_64", "no FMU platform"), ("linux", "s390x", "no FMU platform")],
)
def test_machine_that_the_fmi_has_no_name_for_is_told(system, processor, reason, monkeypatch):
    monkeypatch.setattr(platforms.sys, "platform", system)
    monkeypatch.setattr(platforms.machine, "machine", lambda: processor)
    with pytest.raises(ExportError, match=reason):
        native_target()


def test_missing_bundled_compiler_is_told_with_the_command_that_brings_it(tmp_path, monkeypatch):
    monkeypatch.setattr(platforms, "find_spec", lambda _name: None)
    with pytest.raises(MissingTool, match=r'pip install "cosim-rigid\[zig\]"'):
        cosim.export_fmu(decay(), tmp_path / "model.fmu", platforms=["win64"])
    assert list(tmp_path.iterdir()) == []


def libraries(path: Path) -> dict[str, list[tuple[str, str]]]:
    """Return system and processor of every library in an FMU; each exports what it must."""
    found = {}
    with zipfile.ZipFile(path) as archive:
        for name in archive.namelist():
            if name.startswith("binaries/"):
                read = read_libraries(archive.read(name))
                found[name] = [(one.system, one.processor) for one in read]
                assert all(len(one.exports) >= 44 for one in read)
    return found


@needs_zig
@pytest.mark.nightly
def test_one_machine_makes_binaries_for_every_system(tmp_path):
    path = cosim.export_fmu(decay(), tmp_path / "model.fmu", platforms=["all"])
    assert libraries(path) == {
        "binaries/linux64/decay.so": [("linux", "x86_64")],
        "binaries/win64/decay.dll": [("windows", "x86_64")],
        "binaries/darwin64/decay.dylib": [("darwin", "x86_64"), ("darwin", "aarch64")],
    }
    assert check_fmu(path) == []
    path = cosim.export_fmu(decay(), tmp_path / "model.fmu", platforms=["all"], fmi=3)
    assert len(libraries(path)) == len(targets(["all"], 3))
    assert check_fmu(path) == []


@needs_zig
@pytest.mark.slow
@pytest.mark.parametrize("platform", PLATFORMS)
def test_cross_builds_are_identical_from_an_empty_cache(platform, tmp_path, monkeypatch):
    contents = set()
    for cache in ("one", "two words"):
        monkeypatch.setenv("COSIM_CACHE", str(tmp_path / cache))
        path = cosim.export_fmu(decay(), tmp_path / "model.fmu", platforms=[platform], fmi=3)
        contents.add(path.read_bytes())
    assert len(contents) == 1


@needs_zig
@pytest.mark.slow
@pytest.mark.skipif(native_target().folder(2) != "linux64", reason="runs what is made for Linux")
def test_portable_library_for_linux_runs_here_and_agrees(tmp_path):
    portable = cosim.export_fmu(decay(), tmp_path / "a.fmu", platforms=["linux64"])
    native = cosim.export_fmu(decay(), tmp_path / "b.fmu")
    first, second = (
        cosim.simulate_fmu(path, relative_tolerance=1e-10) for path in (portable, native)
    )
    assert cosim.compare(first, second).worst.scaled < 1e-12  # measured 0


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("cmake") is None, reason="needs cmake")
@pytest.mark.usefixtures("optimized")
@pytest.mark.parametrize("fmi", [2, 3])
def test_fmpy_compiles_the_sources(fmi, tmp_path, monkeypatch):
    beside = str(Path(sys.executable).parent)  # where pip puts the cmake that fmpy calls
    monkeypatch.setenv("PATH", beside + os.pathsep + os.environ["PATH"])
    path = cosim.export_fmu(decay(), tmp_path / "model.fmu", fmi=fmi)
    expected = cosim.simulate_fmu(path)
    inside = f"binaries/{native_target().folder(fmi)}/decay{native_target().suffix}"
    with zipfile.ZipFile(path) as archive:
        files = {name: archive.read(name) for name in archive.namelist() if name != inside}
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    environment = os.environ | {"LDFLAGS": "-lm"}
    subprocess.run(["fmpy", "compile", str(path)], check=True, timeout=300, env=environment)
    assert check_fmu(path) == []
    with zipfile.ZipFile(path) as archive:
        (library,) = read_libraries(archive.read(inside))
    assert library.exports == required_functions(str(fmi))  # nothing of the equations leaks out
    assert cosim.compare(expected, cosim.simulate_fmu(path)).worst.scaled < 1e-12
