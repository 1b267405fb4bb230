"""The runtime under sanitizers: random calls, failing memory, many instances and threads."""

import pytest
from helpers import toy
from helpers.harness import SANITIZED, THREADED, WRAPPED, fuzzers, program, run
from helpers.samples import sampled

SOLVERS = ["step", "dop853"]
with_each_solver = pytest.mark.parametrize("solver", SOLVERS, scope="session")


@pytest.fixture(scope="session")
def fuzzer(tmp_path_factory):
    return fuzzers(tmp_path_factory.mktemp)


@pytest.mark.slow
@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("version", [2, 3])
def test_random_calls_do_no_harm(fuzzer, solver, version):
    check(fuzzer(solver, version, *SANITIZED), seed=1, calls=20_000)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("solver", "version"),
    [("dop853", 2), *(pytest.param(s, v, marks=pytest.mark.slow)
                      for s, v in [("step", 2), ("step", 3), ("dop853", 3)])],
)  # fmt: skip
def test_random_calls_do_no_harm_to_a_model_that_watches_its_constraints(fuzzer, solver, version):
    check(fuzzer(f"{solver} rank", version, *SANITIZED), seed=1, calls=30_000)


@pytest.mark.slow
@pytest.mark.parametrize("version", [2, 3])
def test_random_calls_do_no_harm_to_a_model_with_events(fuzzer, version):
    check(fuzzer("dop853 events", version, *SANITIZED), seed=1, calls=20_000)


@pytest.mark.slow
@pytest.mark.parametrize("seed", sampled([1, 2, 3], (), [1]))
@pytest.mark.parametrize("solver", ["dop853 events", "rosenbrock events"])
@pytest.mark.parametrize("version", [2, 3])
def test_many_random_calls_do_no_harm_to_a_model_with_events(fuzzer, solver, version, seed):
    check(fuzzer(solver, version, *SANITIZED), seed, calls=200_000)


@pytest.mark.slow
@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("seed", sampled([1, 2, 3], (), [1]))
@pytest.mark.parametrize("version", [2, 3])
def test_many_random_calls_do_no_harm(fuzzer, solver, version, seed):
    # a million reach every line of the runtime that four million do; more: -m nightly
    check(fuzzer(solver, version, *SANITIZED), seed, calls=500_000)


def check(program, seed, calls):
    done, fine, longest = run([program, seed, calls], timeout=900).split()
    assert int(done) == calls
    assert int(fine) > 0.2 * calls  # measured 0.30 and 0.34
    assert float(longest) < 0.2  # s of CPU, under sanitizers; measured 0.01 to 0.02


@pytest.mark.slow
def test_a_failing_allocation_leaves_nothing_behind(model, tmp_path):
    watched = [*SANITIZED, *(flag for flag in WRAPPED if "malloc" not in flag)]
    failures = run([program("allocation", model, 2, tmp_path, watched)])
    assert int(failures) == 3  # instance, FMU state, de-serialized state


@pytest.mark.slow
@with_each_solver
def test_64_threads_and_1000_instances_give_the_bits_of_serial_runs(model, tmp_path):
    crowd = program("crowd", model, 2, tmp_path, ["-g", "-O2"])
    assert int(run([crowd, 64, 1000])) == 1000


@pytest.mark.slow
def test_threads_share_nothing(model, tmp_path):
    crowd = program("crowd", model, 2, tmp_path, THREADED)
    assert int(run([crowd, 16, 32])) == 32


@pytest.mark.slow
@pytest.mark.parametrize("kind", SOLVERS)
def test_a_model_with_nothing_but_a_state_compiles_without_a_warning(kind, tmp_path):
    toy.write(tmp_path, toy.bare(), toy.BARE, kind)
    for version in (2, 3):
        flags = [*SANITIZED, *(WRAPPED if version == 2 else [])]
        bare = program(f"fuzz_fmi{version}", tmp_path, version, tmp_path / "built", flags)
        assert int(run([bare, 1, 20_000]).split()[0]) == 20_000
