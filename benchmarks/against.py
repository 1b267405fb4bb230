"""This repository's last commit against another: equations, runs, export, command line.

    python benchmarks/against.py COMMIT [ROUNDS]

Both commits are installed into their own folders, with the packages of this Python, and run in
turns in shuffled order. Prints medians of the CPU time, all threads and child processes included,
and their ratios: below 1 the last commit is faster. For runs it also prints the ratio per step,
since the meaning of a tolerance may have changed. A case that one commit cannot run is left out.
"""

import json
import os
import random
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from time import process_time

ROOT = Path(__file__).parents[1]
EVALUATIONS = 2000
MASSES = 100
EXAMPLES = "heat", "pendulum_stop", "slider_crank_friction", "bicycle_jump"
ME = Path(__file__).resolve()


def right_hand_side() -> Callable[[], object]:
    import casadi as ca

    import cosim

    dae = cosim.load("bicycle/book")
    symbols = [dae.t, dae.x, dae.z, dae.u, dae.p]
    function = ca.Function("f", symbols, [dae.ode, dae.alg], {"cse": True}).map(EVALUATIONS)
    values = [0.1 + ca.DM.zeros(symbol.numel(), EVALUATIONS) for symbol in symbols]
    return lambda: function(*values)


def simulated(solver: str, **options: object) -> Callable[[], Callable[[], object]]:
    def prepare() -> Callable[[], object]:
        import cosim

        dae = cosim.load("bicycle")
        return lambda: cosim.simulate(
            dae, solver=solver, stop_time=20.0, relative_tolerance=1e-8, **options
        )

    return prepare


def example(name: str) -> Callable[[], Callable[[], object]]:
    def prepare() -> Callable[[], object]:
        import cosim

        dae = cosim.load(f"{ROOT / 'examples' / name}.py:build")
        return lambda: cosim.simulate(dae)

    return prepare


def chain_of_masses() -> Callable[[], object]:
    import casadi as ca

    import cosim

    x, v = ca.SX.sym("x", MASSES), ca.SX.sym("v", MASSES)
    stretch = ca.vertcat(x, 0) - ca.vertcat(0, x)
    force = 100 * stretch + 50 * stretch**3
    rates = ca.vertcat(v, force[1:] - force[:-1] - 0.1 * v)
    starts = {"x_1": 0.1}
    dae = cosim.from_casadi(
        {"x": ca.vertcat(x, v), "ode": rates}, start_values=starts, name="masses", stop_time=10,
        output_interval=0.1,
    )  # fmt: skip
    return lambda: cosim.simulate(dae)


def exported() -> Callable[[], object]:
    import cosim

    dae = cosim.load("bicycle")
    target = Path(tempfile.mkdtemp()) / "bicycle.fmu"
    return lambda: cosim.export_fmu(dae, target)


CASES: dict[str, Callable[[], Callable[[], object]]] = {
    "right-hand side, bicycle/book, 2000 states": right_hand_side,
    "simulate, dop853": simulated("dop853"),
    "simulate, cvodes": simulated("cvodes"),
    "simulate, cvodes interpreted": simulated("cvodes", compiled=False),
    "simulate, 100 masses with springs": chain_of_masses,
    **{f"simulate, examples/{name}.py": example(name) for name in EXAMPLES},
    "export_fmu, binary from the cache": exported,
}
COMMANDS = {"cosim --help": ["--help"], "cosim list": ["list"]}


class Installed:
    """A tree installed in a folder, and a process in which its cases run."""

    def __init__(self, tree: Path, folder: Path) -> None:
        install = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps"]
        install += ["--no-build-isolation", "--target", str(folder), str(tree)]
        subprocess.run(install, check=True)
        self.environment = os.environ | {
            "PYTHONPATH": str(folder),
            "COSIM_CACHE": f"{folder}.cache",
        }
        self.process = subprocess.Popen(
            [sys.executable, str(ME), "--serve"],
            env=self.environment, cwd=folder, text=True,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        )  # fmt: skip

    def time(self, case: str) -> tuple[float, int | None] | None:
        """Return the CPU time of a case in s, and the steps of a run; None if the case fails."""
        if case in COMMANDS:
            before = os.times()
            command = [sys.executable, "-m", "cosim", *COMMANDS[case]]
            done = subprocess.run(command, env=self.environment, capture_output=True, check=False)
            after = os.times()
            own = after.children_user + after.children_system
            own -= before.children_user + before.children_system
            return None if done.returncode else (own, None)
        assert self.process.stdin
        assert self.process.stdout
        print(case, file=self.process.stdin, flush=True)
        found = json.loads(self.process.stdout.readline())
        return None if found is None else (found[0], found[1])


def serve() -> None:
    """Time the cases named on standard input; the first call of each also prepares it."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # other output
    ready: dict[str, Callable[[], object] | None] = {}
    for line in sys.stdin:
        case = line.strip()
        try:
            if case not in ready:
                ready[case] = CASES[case]()
                ready[case]()
            before = os.times()
            began = process_time()
            call = ready[case]
            result, seconds = (call(), process_time() - began) if call else (None, None)
            after = os.times()
            children = after.children_user + after.children_system
            children -= before.children_user + before.children_system
            steps = getattr(result, "stats", {}).get("steps")
            answer = None if seconds is None else (seconds + children, steps)
        except Exception as error:
            print(f"{case}: {error}", file=sys.stderr)
            ready[case] = answer = None
        print(json.dumps(answer), file=answers, flush=True)


def main(commit: str, rounds: int) -> None:
    with tempfile.TemporaryDirectory() as name:
        trees = {
            which: Installed(unpacked(tree, Path(name, which)), Path(name, f"{which}.installed"))
            for which, tree in {"then": commit, "now": "HEAD"}.items()
        }
        times = measured(trees, rounds)
        for tree in trees.values():
            tree.process.communicate()
    print(f"{'':44}{'then [ms]':>10}{'now [ms]':>10}{'ratio':>8}{'per step':>10}")
    for case, found in times.items():
        if all(found.values()):
            both = [found[tree] for tree in ("then", "now")]
            then, now = (statistics.median(seconds for seconds, _ in each) for each in both)
            before, after = (each[0][1] for each in both)
            each = f"{now / then * before / after:10.2f}" if before and after else ""
            print(f"{case:44}{then * 1e3:10.2f}{now * 1e3:10.2f}{now / then:8.2f}{each}")


def unpacked(commit: str, folder: Path) -> Path:
    """Write the files of a commit into a new folder."""
    folder.mkdir()
    archive = ["git", "-C", str(ROOT), "archive", "--format=tar", commit]
    content = subprocess.run(archive, capture_output=True, check=True).stdout
    subprocess.run(["tar", "-x", "-C", str(folder)], input=content, check=True)
    return folder


def measured(
    trees: dict[str, Installed], rounds: int
) -> dict[str, dict[str, list[tuple[float, int | None]]]]:
    """Return times and steps by case and tree; the first round compiles and is dropped."""
    times = {
        case: {tree: list[tuple[float, int | None]]() for tree in trees}
        for case in (*CASES, *COMMANDS)
    }
    for number in range(rounds + 1):
        for case in times:
            for tree in random.sample(sorted(trees), len(trees)):
                taken = trees[tree].time(case)
                if number and taken is not None:
                    times[case][tree].append(taken)
    return times


if __name__ == "__main__":
    if sys.argv[1:] == ["--serve"]:
        serve()
    elif sys.argv[1:]:
        main(sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 9)
    else:
        sys.exit(__doc__)
