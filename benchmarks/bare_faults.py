"""Error handling of bare fmpy, bare CasADi and `cosim simulate` on rows of the table of faults.

    python benchmarks/bare_faults.py

Each call is a process of its own with its own folder for temporary files. A tool is tested on the
rows that apply to it: an FMU that misbehaves in a function that the tool calls, any file that is
not an FMU, and numbers that its own functions accept.
"""

import os
import resource
import signal
import subprocess
import sys
import tempfile
from collections import Counter
from functools import cache
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from helpers.fault_rows import Row, rows
from helpers.hostile import hostile, hostile_binary

LIMIT = 20  # s; rows that loop have `--timeout 5`
MEMORY = 8 * 2**30  # bytes: some files are endless
OURS = "`cosim simulate`"
FILES = {  # program with which a tool runs a file for a second: FILE, INTERFACE
    "fmpy": """
import fmpy, sys
fmpy.simulate_fmu(sys.argv[1], stop_time=1.0, fmi_type=sys.argv[2])
""",
    "CasADi": """
import casadi as ca, sys
fmu = ca.DaeBuilder("foreign", sys.argv[1])
rate = fmu.create("rate", ["t", "x", "u"], ["ode"])
t, x = ca.MX.sym("t"), ca.MX.sym("x", fmu.nx())
dae = {"t": t, "x": x, "ode": rate(t, x, ca.DM.zeros(fmu.nu()))}
ca.integrator("run", "cvodes", dae, 0, 1)(x0=fmu.start(fmu.x()))
""",
}
# CasADi on a model as CasADi's users write one: OPTION, VALUE
NUMBERS = """
import casadi as ca, sys
option, value = sys.argv[1], float(sys.argv[2])
x = ca.SX.sym("x", 2)
times = {"--start-time": 0.0, "--stop-time": 1.0}
times.update({option: value} if option in times else {})
renamed = {"--relative-tolerance": "reltol", "--absolute-tolerance": "abstol"}.get(option)
dae = {"x": x, "ode": ca.vertcat(x[1], -x[0])}
options = {renamed: value} if renamed else {}
ca.integrator("run", "cvodes", dae, *times.values(), options)(x0=[1, 0])
"""
TAKEN = ("--start-time", "--stop-time", "--relative-tolerance", "--absolute-tolerance")
LEFT = "something left behind"
KINDS = (
    *("one sentence", "traceback", "crash or exit", "hang", "undetected", "runs, as it should"),
    *(LEFT, "not applicable"),
)


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write = hostile(hostile_binary(folder))
        chosen = [row for row in rows() if _kind(row)]
        counts: dict[str, Counter[str]] = {tool: Counter() for tool in (*FILES, OURS)}
        for number, row in enumerate(chosen):
            for tool, ends in counts.items():
                print(f"{row.name}, {tool}", file=sys.stderr)
                ends.update(_ends(tool, row, folder / f"{number}{tool[0]}", write))
    print(f"| of {len(chosen)} |", " | ".join(counts), "|")
    print("|---|" + "---|" * len(counts))
    for kind in KINDS:
        print(f"| {kind} |", " | ".join(str(ends[kind]) for ends in counts.values()), "|")


def _kind(row: Row) -> str:
    """Return the subject of a row; "" if it applies to no bare tool."""
    if row.name.startswith("FMU fmi2"):
        return "misbehaving"
    if row.name.startswith("simulate FMU is"):
        return "file"
    is_number = row.name.startswith(tuple(f"simulate {option}=" for option in TAKEN))
    return "number" if is_number and _value(row) is not None else ""


def _ends(tool: str, row: Row, place: Path, write) -> list[str]:
    """Return how a tool ended on a row, and whether it left files."""
    place.mkdir()
    kind, words = _kind(row), list(row.words)
    if kind == "misbehaving":
        words[1] = str(write(words[1]))
        if tool != OURS and not _calls(tool, row.words[1].split()[0], _interface(row), write):
            return ["not applicable"]
    elif row.prepare:
        row.prepare(place)
    if tool == OURS:
        call = [sys.executable, "-P", "-m", "cosim", *words]
    elif kind != "number":
        call = [sys.executable, "-c", FILES[tool], words[1], _interface(row)]
    elif tool == "CasADi":
        option = next(word for word in words if "=" in word).partition("=")[0]
        call = [sys.executable, "-c", NUMBERS, option, str(_value(row))]
    else:
        return ["not applicable"]
    return _ended(call, row.code == 0, place)


def _value(row: Row) -> float | None:
    """Return the number of a row; None if Python does not read it as a number."""
    try:
        return float(row.name.partition("=")[2])
    except ValueError:
        return None


def _interface(row: Row) -> str:
    if "--interface-type" not in row.words:
        return "CoSimulation"
    return row.words[row.words.index("--interface-type") + 1]


@cache
def _calls(tool: str, function: str, interface: str, write) -> bool:
    """Return whether a tool calls a function of an FMU, which then prints a text."""
    path = str(write(f"{function} print 1"))
    call = [sys.executable, "-c", FILES[tool], path, interface]
    with tempfile.TemporaryDirectory() as place:
        done = subprocess.run(
            call, cwd=place, capture_output=True, text=True, timeout=100, check=False
        )
    return "here I am" in done.stdout


def _ended(call: list[str], good: bool, place: Path) -> list[str]:
    temporary = place / "temporary"
    temporary.mkdir()
    before = _files(place)
    with tempfile.TemporaryFile("w+") as errors:  # a pipe would stay open while a child holds it
        process = subprocess.Popen(
            call, cwd=place, env={**os.environ, "TMPDIR": str(temporary)},
            stdout=subprocess.DEVNULL, stderr=errors, start_new_session=True,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY)),
        )  # fmt: skip
        try:
            code = process.wait(LIMIT)
        except subprocess.TimeoutExpired:
            code = None
        left = (_ended_group(process) and code is not None) or _files(place) != before
        errors.seek(0)
        messages = errors.read()
    return [_kind_of_end(code, messages, good), *[LEFT] * left]


def _kind_of_end(code: int | None, messages: str, good: bool) -> str:
    if code is None:
        return "hang"
    if "Traceback" in messages:
        return "traceback"
    if code == 0:
        return "runs, as it should" if good else "undetected"
    return "one sentence" if messages.strip() and code > 0 else "crash or exit"


def _ended_group(process: "subprocess.Popen[bytes]") -> bool:
    """End a process and its children; return whether any was running."""
    try:
        os.killpg(process.pid, signal.SIGKILL)
    except ProcessLookupError:
        return False
    finally:
        process.wait()
    return True


def _files(place: Path) -> set[Path]:
    return {*place.rglob("*")}


if __name__ == "__main__":
    main()
