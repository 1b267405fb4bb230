"""A system in several threads and processes."""

import pickle
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from helpers.harness import POSIX, STRICT, compiler
from helpers.small_models import decay

import cosim
from cosim.coupling.files import read_system

ROOT = Path(__file__).parents[2]
RIDE = "examples/coupled/ride.toml"
TIMES = {"stop_time": 0.2, "accuracy": 1e-3}


@pytest.mark.slow
@pytest.mark.usefixtures("optimized")  # whose compiler knows variables of a thread
def test_one_system_in_many_threads_gives_the_same_bits():
    system = read_system(RIDE)
    expected = read_system(RIDE).simulate(**TIMES)
    with ThreadPoolExecutor(8) as pool:
        runs = list(pool.map(lambda _: system.simulate(**TIMES), range(16)))
    for run in runs:
        np.testing.assert_array_equal(run.values, expected.values)


@pytest.mark.slow
def test_a_relative_path_is_found_while_other_threads_load_libraries(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    cosim.export_fmu(decay(), "decay.fmu")
    alone = cosim.simulate_fmu("decay.fmu", stop_time=0.1)
    monkeypatch.setattr("os.chdir", lambda folder: pytest.fail(f"all threads go to {folder}"))
    with ThreadPoolExecutor(16) as pool:
        runs = list(pool.map(lambda _: cosim.simulate_fmu("decay.fmu", stop_time=0.1), range(50)))
    for run in runs:
        np.testing.assert_array_equal(run.values, alone.values)


@pytest.mark.slow_rows("toml")
@pytest.mark.parametrize("kind", ["toml", "ssp"])
def test_a_system_that_has_run_can_be_pickled(kind, tmp_path):
    system = read_system(RIDE)
    if kind == "ssp":
        system = read_system(system.write_ssp(tmp_path / "ride.ssp"))
    run = system.simulate(**TIMES)
    content = pickle.dumps(system)
    del system  # with the files that were unpacked for it
    np.testing.assert_array_equal(pickle.loads(content).simulate(**TIMES).values, run.values)


@pytest.mark.skipif(not compiler() or sys.platform == "win32", reason="needs C and POSIX threads")
def test_threads_have_stacks_as_large_as_that_of_a_program(tmp_path):
    program, headers = tmp_path / "crew", ROOT / "fmu" / "master"
    flags = (*STRICT, POSIX, f"-I{headers}", "-pthread")
    source = Path(__file__).with_name("crew.c")
    subprocess.run([compiler(), *flags, source, "-o", program], check=True)
    small = f"ulimit -s 512 && exec {program}"  # what macOS gives threads, here those of Linux too
    done = subprocess.run(["sh", "-c", small], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "2 2 3\n")
