"""The runtime under sanitizers: random calls, failing memory, many instances and threads."""

from pathlib import Path

import pytest
from helpers import toy
from helpers.harness import SANITIZED, program, run

# The C library's functions of memory are the test's
WATCHED = [*SANITIZED, *(f"-Wl,--wrap={name}" for name in ("calloc", "malloc", "free"))]
THREADED = ["-g", "-O1", "-fsanitize=thread"]
SOLVERS = ["step", "dop853"]
with_each_solver = pytest.mark.parametrize("solver", SOLVERS, scope="session")


@pytest.fixture(scope="module")
def fuzzers(model: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[int, Path]:
    folder = tmp_path_factory.mktemp("fuzz")
    return {v: fuzzer(model, v, folder / str(v)) for v in (2, 3)}


def fuzzer(model, version, folder):
    flags = WATCHED if version == 2 else SANITIZED
    return program(f"fuzz_fmi{version}", model, version, folder, flags)


@with_each_solver
@pytest.mark.parametrize("version", [2, 3])
def test_random_calls_do_no_harm(fuzzers, version):
    check(fuzzers[version], seed=1, calls=100_000)


@pytest.mark.slow
@with_each_solver
@pytest.mark.parametrize("seed", range(2, 6))
@pytest.mark.parametrize("version", [2, 3])
def test_millions_of_random_calls_do_no_harm(fuzzers, version, seed):
    check(fuzzers[version], seed, calls=1_000_000)


def check(program, seed, calls):
    done, fine, longest = run([program, seed, calls], timeout=900).split()
    assert int(done) == calls
    assert int(fine) > 0.2 * calls  # measured 0.30 and 0.34
    assert float(longest) < 1.0  # s of CPU, under sanitizers; measured 0.07 to 0.09


def test_a_failing_allocation_leaves_nothing_behind(model, tmp_path):
    watched = [flag for flag in WATCHED if "malloc" not in flag]
    failures = run([program("allocation", model, 2, tmp_path, watched)])
    assert int(failures) == 3  # instance, FMU state, de-serialized state


@with_each_solver
def test_64_threads_and_1000_instances_give_the_bits_of_serial_runs(model, tmp_path):
    crowd = program("crowd", model, 2, tmp_path, ["-g", "-O2"])
    assert int(run([crowd, 64, 1000])) == 1000


def test_threads_share_nothing(model, tmp_path):
    crowd = program("crowd", model, 2, tmp_path, THREADED)
    assert int(run([crowd, 16, 32])) == 32


@pytest.mark.parametrize("kind", SOLVERS)
def test_a_model_with_nothing_but_a_state_compiles_without_a_warning(kind, tmp_path):
    toy.write(tmp_path, toy.bare(), toy.BARE, kind)
    for version in (2, 3):
        bare = fuzzer(tmp_path, version, tmp_path / str(version))
        assert int(run([bare, 1, 20_000]).split()[0]) == 20_000
