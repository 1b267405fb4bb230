"""Faults made by combination: rows of the table, drawn with a seed.

A command line has at least one thing wrong. A damaged file may still be whole where it counts, so
that its row may end with any documented code, but in a sentence.
"""

import io
import random
import re
import tempfile
import zipfile
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

from helpers.fault_rows import ANY, WRONG, Prepare, Row
from helpers.mutated_ssp import mutated, packed
from helpers.ssp_files import component, connection, description, system

from cosim.cli.main import main
from cosim.scene import shipped_scenes

_BAD_NUMBERS = ("nan", "inf", "-inf", "1e999", "abc", "", "1,5", "0x1p3", "1 2", "--", "\u0661e")
_NUMBERS = ("--stop-time", "--start-time", "--output-interval", "--relative-tolerance")
_MORE_NUMBERS = ("--absolute-tolerance", "--accuracy", "--budget", "--timeout")
_NO_LIMITS = ("inf", "1e999")  # of --timeout
_BAD = (
    *(
        (option, value)
        for option in (*_NUMBERS, *_MORE_NUMBERS)
        for value in _BAD_NUMBERS
        if option != "--timeout" or value not in _NO_LIMITS
    ),
    *(("--solver", value) for value in ("rk5", "", "x" * 99, "cvodes;", "\x1b[2J")),
    *(("--outputs", value) for value in ("nothing", ",", "", "phi,,phi", "\u202e")),
    *(("-p", value) for value in ("=", "alpha", "alpha=", "alpha=nan", "no=1", "alpha=1m", "=1")),
    *(("--start-values", value) for value in ("alpha", "=", "phi")),
    *(("-o", value) for value in ("gone/a.csv", "/proc/a", "", "n" * 300, "/dev/null/a", ".")),
    *(("--frob", "1"), ("--input", "x"), ("--input", "=t"), ("--input-file", "gone.csv")),
    *(("--at", "nan"), ("--stop-when", "phi >"), ("--units", "furlongs"), ("--fmi", "4")),
)
_GOOD = (
    *(("--stop-time", "0.01"), ("-q", ""), ("--outputs", "phi"), ("-p", "alpha=2")),
    *(("--solver", "cvodes"), ("--output-interval", "0.01"), ("--json", ""), ("-v", "")),
)
_VERBS = (
    *("simulate", "export", "plot", "animate", "report", "tradeoff", "crosscheck", "extremes"),
    *("sweep", "sensitivity", "linearize", "info", "check", "scene", "new", "list", "cache"),
)
_MODELS = (
    "crank_shaft",
    "crank_shaft/multipliers",
    "bicycl",
    "",
    "gone.fmu",
    "gone.toml",
    "a.py:f",
)
_FUNCTIONS = (
    *("Instantiate", "SetupExperiment", "EnterInitializationMode", "ExitInitializationMode"),
    *("GetReal", "SetReal", "DoStep", "GetDerivatives", "GetContinuousStates", "SetTime"),
    *("SetContinuousStates", "CompletedIntegratorStep", "NewDiscreteStates", "Terminate", "Reset"),
    *("FreeInstance", "EnterContinuousTimeMode"),
)
_ACTIONS = (
    *("status 1", "status 2", "status 3", "status 4", "status 5", "status 77", "status -1", "segv"),
    *("abort", "exit 0", "exit 3", "_exit 7", "raise 9", "raise 24", "close", "hang", "litter"),
    *("escape", "child", "daemon"),
)


def random_rows(seed: int, count: int, fmu: bytes) -> list[Row]:
    """Return rows drawn with a seed.

    Args:
        seed: The same one gives the same rows.
        count: Of them.
        fmu: Content of a sound FMU, which is damaged.
    """
    draw = random.Random(seed)
    kinds: list[Callable[[random.Random, bytes], Row]] = [
        *[_command] * 12, *[_checked] * 5, *[_scene] * 4, *[_series] * 2, *[_run], *[_misbehaving],
        *[_system] * 4, *[_ssp] * 4, *[_store] * 4,
    ]  # fmt: skip
    rows = (draw.choice(kinds)(draw, fmu) for _ in range(count))
    return [replace(row, name=f"{seed}.{k} {row.name}") for k, row in enumerate(rows)]


def _command(draw: random.Random, _: bytes) -> Row:
    verb, model = draw.choice(_VERBS), draw.choice(_MODELS)
    options = [draw.choice(_BAD), *draw.choices(_BAD + 5 * _GOOD, k=draw.randrange(3))]
    draw.shuffle(options)
    known = {option: (option, value) for option, value in options if (option, value) not in _GOOD}
    options = [known.get(option, (option, value)) for option, value in options]  # the last counts
    words = [verb] + [model] * (verb not in ("list", "cache"))
    words += [word for option in options for word in option if word or option[0] != "-q"]
    return Row(" ".join(words)[:60], tuple(words), WRONG, "", output=True)


def _damaged(draw: random.Random, content: bytes) -> bytes:
    """Flip, cut, double, move or overwrite some of it."""
    data = bytearray(content)
    for _ in range(draw.randrange(1, 4)):
        at, length = draw.randrange(len(data)), draw.randrange(1, 2 + len(data) // 4)
        match draw.randrange(5):
            case 0:
                data[at] ^= 1 << draw.randrange(8)
            case 1:
                data = data[:at] or data
            case 2:
                data[at:at] = data[at : at + length]
            case 3:
                data[at : at + length] = draw.randbytes(min(length, 20))
            case 4:
                del data[at : at + length]
        data = data or bytearray(b"\0")
    return bytes(data)


def _odd_text(draw: random.Random, text: str) -> str:
    """Replace some quoted values of XML or TOML, or drop or double some lines."""
    odd = ("nan", "-1", "1e999", "", "inf", "x" * 1000, "4294967296", "../x", "\\u001b[2J", "true")
    lines = text.split("\n")
    for _ in range(draw.randrange(1, 4)):
        at = draw.randrange(len(lines))
        match draw.randrange(4):
            case 0 | 1:
                found = [*re.finditer(r'"[^"]*"', lines[at])]
                if found:
                    one = draw.choice(found)
                    head, tail = lines[at][: one.start()], lines[at][one.end() :]
                    lines[at] = f'{head}"{draw.choice(odd)}"{tail}'
            case 2:
                lines.insert(at, lines[draw.randrange(len(lines))])
            case 3:
                del lines[at]
        lines = lines or [""]
    return "\n".join(lines)


def _damaged_fmu(draw: random.Random, fmu: bytes) -> bytes:
    if draw.random() < 0.3:
        return _damaged(draw, fmu)
    target = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(fmu)) as source, zipfile.ZipFile(target, "w") as copy:
        for entry in source.infolist():
            content = source.read(entry)
            if entry.filename == "modelDescription.xml" and draw.random() < 0.8:
                content = _odd_text(draw, content.decode()).encode()
            elif draw.random() < 0.1:
                content = _damaged(draw, content) if content else b"x"
            if draw.random() > 0.03:
                copy.writestr(entry.filename, content)
            if draw.random() < 0.02:
                copy.writestr(entry.filename.upper(), content)
    return target.getvalue()


def _written(name: str, content: bytes) -> Prepare:
    return lambda place: (place / name).write_bytes(content)


def _checked(draw: random.Random, fmu: bytes) -> Row:
    verb = draw.choice(("check", "check", "info"))
    prepare = _written("a.fmu", _damaged_fmu(draw, fmu))
    return Row(f"{verb} damaged FMU", (verb, "a.fmu"), ANY, "", prepare, output=True)


def _run(draw: random.Random, fmu: bytes) -> Row:
    verb = draw.choice(("simulate", "crosscheck", "linearize", "check"))
    words = (verb, "a.fmu", "--trust", *(("--run",) if verb == "check" else ()))
    prepare = _written("a.fmu", _damaged_fmu(draw, fmu))
    return Row(f"{verb} damaged FMU", words, ANY, "", prepare, output=True)


def _scene(draw: random.Random, _: bytes) -> Row:
    text = Path(draw.choice(SCENES)).read_text(encoding="utf-8")
    content = _odd_text(draw, text).encode()
    if draw.random() < 0.2:
        content = _damaged(draw, content)
    words = ("simulate", "s.toml", "--stop-time", "0.01", "--backend", "native-interpreted")
    return Row("damaged scene", words, ANY, "", _written("s.toml", content), output=True)


def _series(draw: random.Random, _: bytes) -> Row:
    text = "time,T2\n" + "".join(f"{0.1 * k},{k % 3}\n" for k in range(30))
    prepare = _written("u.csv", _damaged(draw, text.encode()))
    words = ("simulate", "bar_on_frame", "--input-file", "u.csv", "--stop-time", "0.01")
    return Row(
        "damaged series", (*words, "--backend", "native-interpreted"), ANY, "", prepare, output=True
    )


_SYSTEM = """stop_time = 0.02
open_inputs = []
[parts]
crank = "a.fmu"
bar = "bar_on_frame"
[connections]
"bar.T2" = "crank.T"
[start_values]
"bar.theta" = "60 deg"
"crank.omega" = 50.0
[abilities]
crank = "no rates"
"""
_WAYS = (
    *(("--accuracy", value) for value in ("1e-3", "1e-99", "0", "nan", "inf")),
    *(("--macro-step", value) for value in ("0.01", "0", "-1", "nan", "1e999", "1e-300")),
    *(("--method", value) for value in ("jacobi", "iterated", "gauss_seidel", "extrapolated", "x")),
    *(("--outputs", value) for value in ("bar.theta", "bar.q", "crank", "")),
    *(("-p", value) for value in ("bar.m=1", "bar.m=nan", "crank.no=1", "bar.m=1m")),
)


def _system(draw: random.Random, fmu: bytes) -> Row:
    content = _odd_text(draw, _SYSTEM).encode()
    if draw.random() < 0.2:
        content = _damaged(draw, content)
    part = _damaged_fmu(draw, fmu) if draw.random() < 0.3 else fmu
    return _of_system(draw, "s.toml", {"s.toml": content, "a.fmu": part})


def _ssp(draw: random.Random, fmu: bytes) -> Row:
    if draw.random() < 0.5:
        (content,) = mutated(draw.randrange(2**32), 1)
        return _of_system(draw, "s.ssp", {"s.ssp": content})
    kinds = {"T": "output", "alpha": "parameter"}
    parts = [component(n, "", kinds=kinds, source="resources/a.fmu") for n in ("a", "b")]
    wires = connection("a.T", "T")
    text = description(system("S", "\n".join(parts), f"\n{wires}\n", kinds={"T": "output"}))
    entries = {"SystemStructure.ssd": _odd_text(draw, text), "resources/a.fmu": fmu}
    content = packed(entries)
    return _of_system(
        draw, "s.ssp", {"s.ssp": _damaged(draw, content) if draw.random() < 0.2 else content}
    )


def _of_system(draw: random.Random, name: str, files: dict[str, bytes]) -> Row:
    if draw.random() < 0.3:
        words = ["info", name]
    else:
        options = draw.sample(_WAYS, draw.randrange(3))
        words = ["simulate", name, "--trust", "--stop-time", "0.02"]
        words += [word for option in options for word in option]

    def prepare(place: Path) -> None:
        for file, content in files.items():
            (place / file).write_bytes(content)

    return Row(f"{words[0]} damaged {name}", tuple(words), ANY, "", prepare, output=True)


_SWEEP = ("sweep", "crank_shaft", "-p", "alpha=5:15:40", "--stop-time", "0.05", "--workers", "1")
_KEPT = ("--store", "store", "-o", "r.csv", "-q")


@cache
def _whole_store() -> tuple[dict[str, bytes], bytes]:
    """Return the files of the store of a finished sweep, and its results."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        targets = ("--store", str(place / "store"), "-o", str(place / "r.csv"), "-q")
        assert main([*_SWEEP, *targets]) == 0
        files = [file for file in (place / "store").rglob("*") if file.is_file()]
        found = {file.relative_to(place).as_posix(): file.read_bytes() for file in sorted(files)}
        return found, (place / "r.csv").read_bytes()


def _store(draw: random.Random, _: bytes) -> Row:
    """Resume from a store of which files are missing, damaged or replaced."""
    whole, results = _whole_store()
    files = dict(whole)
    for name in draw.sample([*files], draw.randint(1, 4)):
        match draw.randrange(4):
            case 0:
                del files[name]
            case 1 | 2:
                files[name] = _damaged(draw, files[name])
            case 3:
                files[name] = files[draw.choice([*files])]

    def prepare(place: Path) -> None:
        (place / "r.csv").write_bytes(b"")
        (place / "store").mkdir()
        for name, content in files.items():
            (place / name).parent.mkdir(parents=True, exist_ok=True)
            (place / name).write_bytes(content)

    words = (*_SWEEP, *_KEPT, "--resume")
    return Row("damaged store", words, ANY, "", prepare, expected=("r.csv", results))


def _misbehaving(draw: random.Random, _: bytes) -> Row:
    fault = f"fmi2{draw.choice(_FUNCTIONS)} {draw.choice(_ACTIONS)}"
    verb = draw.choice(("simulate", "check"))
    more = draw.choice((("--interface-type", "ModelExchange"), ())) if verb == "simulate" else ()
    words = (verb, fault, "--trust", *more, "--timeout", "5", *(("--run",) * (verb == "check")))
    return Row(f"{verb} {fault}", words, ANY, "", output=True)


SCENES = sorted(str(path) for path in shipped_scenes())
