"""Export: the file is sound, the same every time, and whole or not there whatever happens."""

import ast
import io
import os
import shutil
import signal
import subprocess
import sys
import time
import zipfile
from pathlib import Path

import fmpy
import numpy as np
import pytest
from helpers.small_models import decay, table

import cosim
from cosim.errors import ExportError, MissingTool, ParameterError, UnknownName, UsageError
from cosim.fmi.check.check import check_fmu
from cosim.fmi.export import build, c_files

OLD = b"what was here before"
POSIX = pytest.mark.skipif(os.name != "posix", reason="signals and limits of POSIX")


@pytest.fixture
def target(tmp_path) -> Path:
    """An FMU file with an old content."""
    path = tmp_path / "target" / "model.fmu"
    path.parent.mkdir()
    path.write_bytes(OLD)
    return path


def assert_untouched(target: Path) -> None:
    assert target.read_bytes() == OLD
    assert [path.name for path in target.parent.iterdir()] == [target.name]


# -- the same input, the same bytes -------------------------------------------------------------


@pytest.mark.slow
def test_exports_are_identical_from_every_folder_and_cache(tmp_path, monkeypatch):
    contents = set()
    for cache, folder in (("one", "a"), ("one", "b c"), ("two", "ü")):
        monkeypatch.setenv("COSIM_CACHE", str(tmp_path / cache))
        (tmp_path / folder).mkdir()
        monkeypatch.chdir(tmp_path / folder)
        contents.add(cosim.export_fmu(decay(), "model.fmu").read_bytes())
    assert len(contents) == 1


@pytest.mark.slow
def test_another_python_process_exports_the_same_bytes(target):
    code = "import cosim, sys, helpers.small_models as m; cosim.export_fmu(m.decay(), sys.argv[1])"
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2]), "PYTHONHASHSEED": "7"}
    subprocess.run([sys.executable, "-c", code, str(target)], check=True, env=environment)
    assert target.read_bytes() == cosim.export_fmu(decay(), target).read_bytes()


@pytest.mark.slow
def test_token_changes_with_the_model_and_only_with_it(tmp_path):
    def token(dae) -> str:
        path = cosim.export_fmu(dae, tmp_path / "model.fmu")
        return fmpy.read_model_description(str(path)).guid

    assert token(decay()) == token(decay())
    assert len({token(decay()), token(decay(rate=0.6)), token(decay("other"))}) == 3


def test_archive_holds_no_time_no_path_and_no_name_of_this_machine(tmp_path):
    path = cosim.export_fmu(decay(), tmp_path / "model.fmu")
    with zipfile.ZipFile(path) as archive:
        assert {entry.date_time for entry in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}
        for name in archive.namelist():
            for trace in (str(tmp_path), os.environ["COSIM_CACHE"], str(Path.home())):
                assert trace.encode() not in archive.read(name), name


# -- what may be chosen -------------------------------------------------------------------------


def test_outputs_are_the_requested_ones(tmp_path):
    path = cosim.export_fmu(decay(), tmp_path / "model.fmu", outputs=["y"])
    assert cosim.simulate_fmu(path).names == ("y",)
    with pytest.raises(UnknownName, match="decay has no output 'z'; it has x, y"):
        cosim.export_fmu(decay(), path, outputs=["z"])


def test_tolerance_is_recommended_to_importers(tmp_path):
    path = cosim.export_fmu(decay(), tmp_path / "model.fmu", tolerance=1e-4)
    assert float(fmpy.read_model_description(str(path)).defaultExperiment.tolerance) == 1e-4


@pytest.mark.parametrize("tolerance", [0, -1e-6, 1, float("nan"), float("inf"), 1e-14, True, "1"])
def test_tolerance_out_of_range_is_rejected(tolerance, target):
    with pytest.raises(ParameterError, match="tolerance"):
        cosim.export_fmu(decay(), target, tolerance=tolerance)
    assert_untouched(target)


def test_unknown_fmi_version_is_rejected(target):
    with pytest.raises(UnknownName, match="cosim has no FMI version '1'; it has 2, 3"):
        cosim.export_fmu(decay(), target, fmi=1)
    assert_untouched(target)


@pytest.mark.parametrize("name", ["../x", "a b", "for", "nul", "x" * 300])
def test_invalid_identifier_is_rejected(name, target):
    with pytest.raises(ExportError, match="cannot name an FMU"):
        cosim.export_fmu(decay(), target, identifier=name)
    assert_untouched(target)


@pytest.mark.slow
def test_two_models_of_one_identifier_run_in_one_process(tmp_path):
    """`a/b` and `a_b` both become a_b; each run loads its own library."""
    paths = [
        cosim.export_fmu(decay(rate=rate), tmp_path / f"{rate}.fmu", identifier=name)
        for rate, name in ((1.0, "a/b"), (2.0, "a_b"))
    ]
    for rate, path in zip((1.0, 2.0, 1.0, 2.0), paths * 2, strict=True):
        run = cosim.simulate_fmu(path, relative_tolerance=1e-10)
        assert run["x"][-1] == pytest.approx(np.exp(-rate), rel=1e-9)  # measured 1e-11


def test_model_may_be_called_model(tmp_path):
    """Though that is how the names of its functions begin inside."""
    path = cosim.export_fmu(decay("model"), tmp_path / "model.fmu")
    assert cosim.simulate_fmu(path)["x"][-1] == pytest.approx(np.exp(-0.5), rel=1e-6)


def test_unknown_form_of_generated_code_is_rejected(target, monkeypatch):
    """Of another CasADi, whose functions would not be found and headed."""
    code = "static int f0(const double** arg) { return 0; }\n"
    monkeypatch.setattr(c_files, "generated_code", lambda *_, **_options: code)
    with pytest.raises(UsageError, match="names generated functions differently; use casadi"):
        cosim.export_fmu(decay(), target)
    assert_untouched(target)


@pytest.mark.slow_rows("ModelExchange-2", "ModelExchange-3")
@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("interface", ["ModelExchange", "CoSimulation"])
def test_model_without_states_is_exported(fmi, interface, tmp_path):
    path = cosim.export_fmu(table(), tmp_path / "table.fmu", fmi=fmi)
    run = cosim.simulate_fmu(path, interface=interface, start_values={"push": 1.5})
    assert np.allclose(run["y"], 4.5 + run.time, rtol=0, atol=1e-14)


@pytest.mark.parametrize(
    "name",
    [
        "with space.fmu",
        "a#b%20c?d&e.fmu",
        "größe-木.fmu",
        "quote'\".fmu",
        "no_suffix",
        "x" * 251 + ".fmu",
        "/".join(["deep" * 25] * 12) + "/model.fmu",
    ],
)
def test_any_path_will_do(name, tmp_path, monkeypatch):
    path = tmp_path / name
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cosim.export_fmu(decay(), path) == path
    assert len(cosim.simulate_fmu(path)) == 101
    monkeypatch.chdir(tmp_path)  # a relative path is as good
    assert cosim.export_fmu(decay(), name) == Path(name)
    assert len(cosim.simulate_fmu(name, interface="ModelExchange")) == 101


# -- failures -----------------------------------------------------------------------------------


@pytest.fixture
def cold(tmp_path, monkeypatch) -> Path:
    """An empty cache, so that a compiler is needed."""
    monkeypatch.setenv("COSIM_CACHE", str(tmp_path / "cold"))
    return tmp_path / "cold"


def compiler(folder: Path, script: str) -> str:
    path = folder / "compiler"
    path.write_text(f"#!/bin/sh\n{script}\n")
    path.chmod(0o755)
    return str(path)


@POSIX
@pytest.mark.parametrize(
    ("script", "reason"),
    [
        (None, "which is no program"),
        ("echo 'no space left' >&2; exit 1", "no space left"),
        ("printf 'caf\\351' >&2; exit 1", "failed"),
        ("exit 0", "failed"),  # it claims success, but there is no library
        ("kill -9 $$", "failed"),
    ],
)
def test_failing_compiler_is_quoted_and_leaves_the_old_file(
    script, reason, target, cold, tmp_path, monkeypatch
):
    monkeypatch.setenv("CC", compiler(tmp_path, script) if script else "/no/such/compiler")
    with pytest.raises((MissingTool, ExportError), match=reason):
        cosim.export_fmu(decay(), target)
    assert_untouched(target)
    assert not cold.exists() or list(cold.iterdir()) == []


@POSIX
def test_compiler_that_makes_something_else_is_found_out(target, cold, tmp_path, monkeypatch):
    for_last = 'while [ $# -gt 2 ]; do [ "$1" = -o ] && echo text > "$2"; shift; done'
    monkeypatch.setenv("CC", compiler(tmp_path, for_last))
    with pytest.raises(MissingTool, match="wrote something else than a shared library"):
        cosim.export_fmu(decay(), target)
    assert_untouched(target)


def test_missing_compiler_is_reported_with_a_remedy(target, cold, monkeypatch):
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv("PATH", "")
    monkeypatch.setattr("cosim.codegen.compiler.find_spec", lambda _name: None)
    with pytest.raises(MissingTool, match=r"tried .* ziglang.*pip install"):
        cosim.export_fmu(decay(), target)
    assert_untouched(target)


def test_other_headers_of_fmi_are_not_taken_for_the_cached_ones(target, tmp_path, monkeypatch):
    cosim.export_fmu(decay(), tmp_path / "cached.fmu")
    headers = Path(shutil.copytree(build.fmi_headers(), tmp_path / "headers"))
    (headers / "fmi2Functions.h").write_text("")
    monkeypatch.setattr(build, "fmi_headers", lambda: headers)
    with pytest.raises(MissingTool, match="fmi2Status"):
        cosim.export_fmu(decay(), target)
    assert_untouched(target)


def test_unwritable_cache_is_reported(target, tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("COSIM_CACHE", str(tmp_path / "file" / "cache"))
    with pytest.raises(ExportError, match=r"cannot compile in .*Not a directory; set COSIM_CACHE"):
        cosim.export_fmu(decay(), target)
    assert_untouched(target)


def test_invalid_target_is_reported_before_anything_is_computed(tmp_path, cold):
    with pytest.raises(ExportError, match=r"cannot write .*gone/x\.fmu: .*; create .*gone first"):
        cosim.export_fmu(decay(), tmp_path / "gone" / "x.fmu")
    with pytest.raises(ExportError, match="it is a directory; give a file name"):
        cosim.export_fmu(decay(), tmp_path)
    assert not cold.exists()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="root may write anywhere")
def test_read_only_folder_is_reported(target):
    target.parent.chmod(0o500)
    try:
        with pytest.raises(ExportError, match="Permission denied"):
            cosim.export_fmu(decay(), target)
        assert_untouched(target)
    finally:
        target.parent.chmod(0o700)


def in_child(code: str, *arguments: object) -> subprocess.Popen[str]:
    """Start Python with the small models at hand; the cache is that of this session."""
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])}
    command = [sys.executable, "-c", code, *map(str, arguments)]
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)


FULL = """
import cosim, resource, sys
from helpers.small_models import decay
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]),) * 2)
try:
    cosim.export_fmu(decay(), sys.argv[1])
except cosim.CosimError as error:
    print(type(error).__name__, error)
"""


@pytest.mark.quick_rows("0")
@POSIX
@pytest.mark.parametrize("room", [0, 1000, 20_000])
def test_full_disk_leaves_the_old_file(room, target):
    cosim.export_fmu(decay(), target.parent.parent / "warm.fmu")
    assert (target.parent.parent / "warm.fmu").stat().st_size > 20_000
    told, _ = in_child(FULL, target, room).communicate(timeout=60)
    assert told.startswith(f"ExportError cannot write {target}: File too large")
    assert_untouched(target)


ENDLESS = """
import cosim, itertools, sys
from helpers.small_models import decay
for rate in itertools.cycle((0.5, 0.6)):
    cosim.export_fmu(decay(rate=rate), sys.argv[1])
    print(rate, flush=True)
"""


@pytest.mark.slow
@POSIX
def test_killed_export_leaves_a_whole_file(target):
    whole = {cosim.export_fmu(decay(rate=rate), target).read_bytes() for rate in (0.5, 0.6)}
    rng = np.random.default_rng(3)
    for _ in range(6):
        child = in_child(ENDLESS, target)
        child.stdout.readline()  # from now on it replaces the file again and again
        time.sleep(rng.uniform(0.0, 0.3))
        child.send_signal(signal.SIGKILL)
        child.communicate(timeout=60)
        assert target.read_bytes() in whole


ONCE = """
import cosim, sys
from helpers.small_models import decay
cosim.export_fmu(decay(rate=float(sys.argv[2])), sys.argv[1])
"""


@pytest.mark.slow
@POSIX
@pytest.mark.parametrize(
    "compiled", [True, pytest.param(False, marks=pytest.mark.slow)], ids=["warm", "cold"]
)
def test_eight_exports_at_once_leave_one_whole_winner(compiled, target, tmp_path, monkeypatch):
    rates = [0.5, 0.6] * 4
    if not compiled:
        monkeypatch.setenv("COSIM_CACHE", str(tmp_path / "cold"))
    children = [in_child(ONCE, target, rate) for rate in rates]
    assert [child.wait(timeout=120) for child in children] == [0] * 8
    for child in children:
        child.stdout.close()
    winner = target.read_bytes()
    assert winner in {
        cosim.export_fmu(decay(rate=rate), target).read_bytes() for rate in set(rates)
    }
    assert check_fmu(io.BytesIO(winner)) == []
    assert [path.name for path in target.parent.iterdir()] == [target.name]


def test_generated_numbers_are_read_back_bit_by_bit(tmp_path):
    value = 0.1 + 0.2
    path = cosim.export_fmu(decay(rate=value), tmp_path / "model.fmu")
    assert np.float64(fmpy.read_model_description(str(path)).modelVariables[4].start) == value
    with zipfile.ZipFile(path) as archive:
        rows = archive.read("sources/tables.h").decode().splitlines()
    row = next(row for row in rows if '{"rate"' in row)
    assert ast.literal_eval(row.split(",")[3].strip()) == value
