"""How bare fmpy ends on the FMUs of the table of faults, beside `cosim simulate`.

    python benchmarks/bare_faults.py

Each call is a process of its own with a folder for temporary files of its own.
"""

import os
import subprocess
import sys
import tempfile
from collections import Counter
from itertools import count
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from helpers.fault_rows import rows
from helpers.hostile import hostile, hostile_binary

LIMIT = 8  # s
BARE = {
    "bare fmpy": """
import fmpy, sys
fmpy.simulate_fmu(sys.argv[1], stop_time=1.0, fmi_type=sys.argv[2])
""",
}
KINDS = ("one sentence", "traceback", "crash or exit", "hang", "silent", "runs, as it should")


def ended(call: list[str], good: bool, place: Path) -> tuple[str, bool]:
    """Return how a call ended, and whether it left a folder."""
    place.mkdir()
    environment = {**os.environ, "TMPDIR": str(place)}
    process = subprocess.Popen(
        call, cwd=place, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        _, told = process.communicate(timeout=LIMIT + 12)
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()
        return "hang", any(place.iterdir())
    left = any(place.iterdir())
    if "Traceback" in told:
        return "traceback", left
    if process.returncode == 0:
        return ("runs, as it should" if good else "silent"), left
    return ("one sentence" if told.strip() and process.returncode == 1 else "crash or exit"), left


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write = hostile(hostile_binary(folder))
        chosen = [row for row in rows() if row.name.startswith("FMU fmi2")]
        counts: dict[str, Counter[str]] = {}
        numbers = count()
        for row in chosen:
            path, kind = str(write(row.words[1])), "CoSimulation"
            if "--interface-type" in row.words:
                kind = row.words[row.words.index("--interface-type") + 1]
            ours = [sys.executable, "-P", "-m", "cosim", row.words[0], path, *row.words[2:]]
            calls = {tool: [sys.executable, "-c", code, path, kind] for tool, code in BARE.items()}
            for tool, call in {**calls, "cosim": ours}.items():
                place = folder / str(next(numbers))  # no spaces: the FMU opens its resources' URI
                how, left = ended(call, row.code == 0, place)
                counts.setdefault(tool, Counter()).update([how, *["left"] * left])
        print("| of", len(chosen), "|", " | ".join(counts), "|")
        print("|---|" + "---|" * len(counts))
        for kind in (*KINDS, "left"):
            told = "a folder left behind" if kind == "left" else kind
            print(f"| {told} |", " | ".join(str(ends[kind]) for ends in counts.values()), "|")


if __name__ == "__main__":
    main()
