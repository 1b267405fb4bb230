"""The table of faults: a command line, its preparation, and the expected end."""

import itertools
import os
import stat
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

Prepare = Callable[[Path], object]
_INTERPRETED = ("--backend", "native-interpreted")
HERE, APART = "here", "apart"  # in the process of the tests, or in one of its own
WRONG, ANY = -1, -2  # exit codes: one of an error, or any that is documented


@dataclass(frozen=True)
class Row:
    """A fault.

    Attributes:
        name: Of the row.
        words: The command line.
        code: The exit code, or `WRONG` or `ANY`.
        told: A regular expression that the sentence must hold; "" for silence.
        prepare: Makes the files that the command meets, in the folder where it runs.
        where: `HERE` or `APART`.
        shell: What a shell adds, e.g. a redirection; only apart.
        output: Whether there may be results on standard output.
        expected: A file and what is in it if the command succeeds.
    """

    name: str
    words: tuple[str, ...]
    code: int
    told: str
    prepare: Prepare | None = None
    where: str = HERE
    shell: str = ""
    output: bool = False
    expected: tuple[str, bytes] | None = None


def rows() -> list[Row]:
    """Return the whole table."""
    return [
        *_numbers(),
        *_names(),
        *_values(),
        *_targets(),
        *_scenes(),
        *_archives(),
        *_misbehaving(),
        *_own_code(),
        *_streams(),
    ]


# -- what is typed --------------------------------------------------------------------------------

_NO_NUMBERS = ("nan", "inf", "-inf", "1e999", "abc", "", "1,5", "0x1p3")


def _numbers() -> Iterator[Row]:
    options = ("--stop-time", "--start-time", "--output-interval", "--relative-tolerance")
    more = ("--absolute-tolerance", "--accuracy", "--budget", "--step-size")
    for option, value in itertools.product((*options, *more), _NO_NUMBERS):
        method = ("--solver", "rk4") if option == "--step-size" else ()
        for verb in ("simulate", "plot"):
            target = ("-o", "p.png") if verb == "plot" else ()
            words = (verb, "crank_shaft", f"{option}={value}", *method, *target)
            told = option.strip("-").replace("-", ".")
            yield Row(f"{verb} {option}={value}", words, 2, told)

    for solver, told in (("cvodes", "max-step"), ("dop853", "max-step"), ("rk4", "step-size")):
        words = ("simulate", "crank_shaft", f"--{told}=1e-300", "--solver", solver)
        yield Row(f"{solver} --{told}=1e-300", words, 2, told.replace("-", "."))
    words = ("export", "crank_shaft", "-o", "c.fmu", "--solver=rk4", "--step-size=1e-300")
    yield Row("export --step-size=1e-300", words, 2, "step.size")

    for value in ("nan", "-1", "2"):
        words = ("tradeoff", "crank_shaft/driven", f"--relative-tolerance={value}")
        yield Row(f"tradeoff --relative-tolerance={value}", words, 2, "relative.tolerance")


def _names() -> Iterator[Row]:
    names = (
        ("bicycl", 3, "did you mean bicycle"),
        ("bicycle/bok", 3, "did you mean book"),
        ("", 3, "has no model ''"),
        ("/", 3, "has no model ''"),
        ("\x1b[2J", 3, r"has no model '\\x1b\[2J'"),
        ("\u202ebicycle", 3, "u202e"),
        ("x" * 300, 3, "has no model"),
        ("a.py", 2, "PATH.py:FUNCTION"),
        ("a.py:f", 3, "a.py is not a file"),
    )
    for verb in ("info", "simulate", "export", "crosscheck", "tradeoff", "plot"):
        target = ("-o", "p.png") if verb == "plot" else ()
        for name, code, told in names:
            yield Row(f"{verb} {ascii(name)[:20]}", (verb, name, *target), code, told)
    limited = ("crosscheck", "--timeout", "0.2", "-q")
    yield Row("crosscheck of all", limited, 1, "did not end within 0.2 s", output=True)
    for verb in ("list", "cache", "info", "simulate", "export", "plot", "extremes", "tradeoff"):
        yield Row(f"{verb} --frob", (verb, "--frob"), 2, "frob|required")


def _values() -> Iterator[Row]:
    for value in ("nan", "inf", "-inf", "abc", "1furlong", "1e999", "--", "1kg"):
        for name in ("alpha", "omega", "diameter"):
            words = ("simulate", "crank_shaft", "-p", f"{name}={value}")
            yield Row(f"-p {name}={value}", words, 2, name)
    for word in ("=", "alpha", "=1", "alpha=", "alpha==1", "alpha=1=2"):
        code = 3 if word.startswith("=") else 2
        yield Row(f"-p {word}", ("simulate", "crank_shaft", "-p", word), code, ".")
    for option in ("--solver", "--outputs", "--on-invalid", "--drift-control"):
        for value in ("wrong", "x" * 200):
            words = ("simulate", "crank_shaft", option, value)
            yield Row(f"{option} {value[:8]}", words, 3, f"'{value}'")


def _targets() -> Iterator[Row]:
    def folder(place: Path) -> None:
        (place / "taken").mkdir()

    targets = (
        ("gone/a", "No such file|create"),
        ("taken", "directory"),
        ("/proc/a", "cannot write"),
        ("/dev/null/a", "cannot write"),
        ("n" * 300, "cannot write"),
        ("", "cannot write"),
    )
    for verb, (name, told) in itertools.product(("simulate", "export", "plot"), targets):
        suffix = ".png" if verb == "plot" and "taken" not in name and name else ""
        code = 3 if verb == "plot" and not suffix and name not in ("taken", "") else 1
        words = (verb, "crank_shaft", "-o", f"{name}{suffix}")
        yield Row(f"{verb} -o {name[:12]}", words, code, "." if code == 3 else told, folder)


# -- files ----------------------------------------------------------------------------------------


def _file(name: str, content: bytes) -> Prepare:
    return lambda place: (place / name).write_bytes(content)


def _pipe(name: str) -> Prepare:
    return lambda place: os.mkfifo(place / name)


def _link(name: str, to: str) -> Prepare:
    return lambda place: (place / name).symlink_to(to)


def _folder(name: str) -> Prepare:
    return lambda place: (place / name).mkdir()


def _odd_files(name: str) -> dict[str, tuple[Prepare | None, str]]:
    return {
        "missing": (None, "No such file"),
        "a folder": (_folder(name), "directory"),
        "a pipe": (_pipe(name), "no plain file"),
        "endless zeros": (_link(name, "/dev/zero"), "no plain file"),
        "endless noise": (_link(name, "/dev/urandom"), "no plain file"),
        "a link to nothing": (_link(name, "nothing"), "No such file"),
        "a link to itself": (_link(name, name), "symbolic link"),
    }


def _scenes() -> Iterator[Row]:
    texts = {
        "empty": b"",
        "no TOML": b"this is no toml",
        "no UTF-8": b"\xff\xfe\x00",
        "zeros": bytes(1000),
        "model is a number": b"model = 3",
        "unknown model": b"model = 'bicycl'",
        "unknown key": b"model = 'bicycle'\nstop_tyme = 3",
        "twice": b"model = 'bicycle'\nmodel = 'bicycle'",
        "nested": b"model = " + b"[" * 2000,
        "nan": b"model = 'bicycle'\nstop_time = nan",
    }
    for verb in ("simulate", "export", "crosscheck", "tradeoff"):
        for kind, (prepare, told) in _odd_files("s.toml").items():
            absent = kind == "missing" or "link" in kind  # which is what Path.exists says of them
            code, words = (3, "no scene 's.toml'") if absent else (2, told)
            yield Row(f"{verb} scene is {kind}", (verb, "s.toml"), code, words, prepare)
        for kind, text in texts.items():
            code = 3 if kind.startswith("unknown model") else -1
            yield Row(f"{verb} scene {kind}", (verb, "s.toml"), code, ".", _file("s.toml", text))


def _zip(entries: dict[str, bytes]) -> Prepare:
    def prepare(place: Path) -> None:
        with zipfile.ZipFile(place / "a.fmu", "w") as archive:
            for name, content in entries.items():
                archive.writestr(name, content)

    return prepare


def _zip_link(place: Path) -> None:
    with zipfile.ZipFile(place / "a.fmu", "w") as archive:
        entry = zipfile.ZipInfo("modelDescription.xml")
        entry.external_attr = (stat.S_IFLNK | 0o777) << 16
        archive.writestr(entry, "/etc/passwd")


def _cut(place: Path) -> None:
    _zip({"modelDescription.xml": b"<x/>" * 1000})(place)
    content = (place / "a.fmu").read_bytes()
    (place / "a.fmu").write_bytes(content[: len(content) // 2])


_XML = "modelDescription.xml"


def _archives() -> Iterator[Row]:
    kinds: dict[str, tuple[Prepare | None, str]] = {
        **_odd_files("a.fmu"),
        "empty": (_file("a.fmu", b""), "not a zip"),
        "garbage": (_file("a.fmu", os.urandom(1000)), "not a zip"),
        "cut": (_cut, "not a zip"),
        "an empty archive": (_zip({}), "no modelDescription"),
        "without description": (_zip({"a": b""}), "no modelDescription"),
        "above itself": (_zip({_XML: b"<a/>", "../x": b""}), "outside"),
        "absolute": (_zip({_XML: b"<a/>", "/x": b""}), "outside"),
        "of a drive": (_zip({_XML: b"<a/>", "c:/x": b""}), "outside"),
        "backslashes": (_zip({_XML: b"<a/>", "..\\x": b""}), "outside"),
        "clash of case": (_zip({_XML: b"<a/>", "a": b"", "A": b""}), "twice"),
        "a link inside": (_zip_link, "link"),
        "no XML": (_zip({_XML: b"no xml"}), "not well-formed"),
        "zeros as XML": (_zip({_XML: bytes(100)}), "not well-formed"),
        "document type": (_zip({_XML: b"<!DOCTYPE a []><a/>"}), "document type"),
        "laughs": (_zip({_XML: b"<!DOCTYPE a [<!ENTITY b 'ha'>]><a>&b;</a>"}), "document type"),
        "deep": (_zip({_XML: b"<a>" * 100 + b"</a>" * 100}), "nests"),
        "unknown encoding": (
            _zip({_XML: b"<?xml version='1.0' encoding='x'?><a/>"}),
            "well-formed",
        ),
    }
    for verb, (kind, (prepare, told)) in itertools.product(
        ("simulate", "crosscheck", "plot"), kinds.items()
    ):
        target = ("-o", "p.png") if verb == "plot" else ()
        yield Row(f"{verb} FMU is {kind}", (verb, "a.fmu", *target), 1, told, prepare)


# -- code of others -------------------------------------------------------------------------------


def _misbehaving() -> Iterator[Row]:
    faults = {
        "fmi2Instantiate status": "instantiate",
        "fmi2Instantiate abort": "SIGABRT",
        "fmi2SetupExperiment status 3": "status 3",
        "fmi2EnterInitializationMode status 4": "status 4",
        "fmi2ExitInitializationMode status 3": "status 3",
        "fmi2ExitInitializationMode segv": "SIGSEGV",
        "fmi2GetReal status 3": "status 3",
        "fmi2GetReal status 77": "illegal return code",
        "fmi2DoStep status 2": "status 2",
        "fmi2DoStep status 3": "status 3",
        "fmi2DoStep status 4": "status 4",
        "fmi2DoStep status 5": "illegal return code",
        "fmi2DoStep status -1": "no status of the FMI",
        "fmi2DoStep abort": "SIGABRT",
        "fmi2DoStep exit 0": "exit code 0",
        "fmi2DoStep _exit 7": "exit code 7",
        "fmi2DoStep raise 9": "SIGKILL",
        "fmi2DoStep raise 24": "time on the processor",
        "fmi2DoStep close": "cannot be run",
        "fmi2DoStep hang": "did not end within",
        "fmi2DoStep deaf": "did not end within",
        "fmi2Terminate status 3": "status 3",
        "fmi2FreeInstance segv": "SIGSEGV",
        "fmi2FreeInstance exit 0": "exit code 0",
    }
    of_model = ("fmi2GetDerivatives", "fmi2GetContinuousStates")
    for status, name in itertools.product((2, 3, 4, 5, 77, -1), of_model):
        faults[f"{name} status {status}"] = name
    for fault, told in faults.items():
        kind = "ModelExchange" if fault.startswith(of_model) else "CoSimulation"
        words = ("simulate", fault, "--trust", "--interface-type", kind, "--timeout", "5")
        yield Row(f"FMU {fault}", words, 1, told, output=told == "did not end within")
    own = {"GetDirectionalDerivative segv": "SIGSEGV", "Instantiate exit 3": "code 3"}
    for fault, told in own.items():
        yield Row(f"linearize FMU {fault}", ("linearize", f"fmi2{fault}", "--trust"), 1, told)
    for fault in ("child", "daemon", "leave", "litter", "escape"):
        words = ("simulate", f"fmi2DoStep {fault}", "--trust")
        told = r"\\x1b\[2J" if fault == "escape" else ""
        yield Row(f"FMU fmi2DoStep {fault}", words, 0, told, output=True)


_OWN = """
import sys, time
from casadi_models.dae import Model
def good():
    m = Model("good", description="d", source="s", stop_time=1.0)
    x = m.state("x", "m", 1.0, "p")
    m.derivative(x, -x)
    return m.freeze()
def loop():
    while True: pass
def sleep(): time.sleep(1000)
def leave(): sys.exit(3)
def base(): raise GeneratorExit("x")
def interrupt(): raise KeyboardInterrupt
def deep(): return deep()
def memory(): return bytearray(10**15)
def escape(): raise ValueError("\\x1b[2J bad\\nnews")
def nothing(): return None
"""


def _own_scene(name: str) -> Prepare:
    def prepare(place: Path) -> None:
        (place / "own.py").write_text(_OWN)
        (place / "own.toml").write_text(f'title = "own"\nmodel = "own.py:{name}"\n')

    return prepare


def _own_code() -> Iterator[Row]:
    ends = {
        "loop": (1, "did not end within 4 s"),
        "sleep": (1, "did not end within 4 s"),
        "leave": (2, "SystemExit: 3"),
        "base": (2, "GeneratorExit"),
        "interrupt": (130, "interrupted"),
        "deep": (2, "RecursionError"),
        "memory": (2, "MemoryError"),
        "escape": (2, r"\\x1b\[2J bad news"),
        "nothing": (2, "returned NoneType"),
        "absent": (3, "no function 'absent'"),
    }
    own = _file("own.py", _OWN.encode())
    for name, (code, told) in ends.items():
        words = ("simulate", f"own.py:{name}", "--timeout", "4" if "4 s" in told else "40")
        yield Row(f"own.py:{name}", words, code, told, own, APART)
    words = ("simulate", "own.toml", "--timeout", "4")
    yield Row("scene of own.py:loop", words, 1, "did not end within 4 s", _own_scene("loop"), APART)
    words = ("simulate", "own.py:good", *_INTERPRETED, "--timeout", "60")
    yield Row("own.py:good", words, 0, "", own, APART, output=True)


# -- the machine ----------------------------------------------------------------------------------


def _streams() -> Iterator[Row]:
    good = ("simulate", "crank_shaft", *_INTERPRETED, "--stop-time", "0.01")
    for words in (good, ("list",), ("--help",)):
        yield Row(f"{words[0]} | true", words, 0, "", None, APART, "| true")
    full = "cannot write the results: No space left"
    for words in (good, ("list",), ("info", "crank_shaft")):
        yield Row(f"{words[0]} >/dev/full", words, 1, full, None, APART, ">/dev/full")

    def shadow(place: Path) -> None:
        for name in ("cosim", "numpy", "casadi", "fmpy", "json", "casadi_models", "ziglang"):
            (place / f"{name}.py").write_text("raise SystemExit('shadowed')\n")

    yield Row("shadowing modules", good, 0, "", shadow, APART, output=True)
    words = ("simulate", "fmi2DoStep status 3", "--trust")
    yield Row("shadowing modules, FMU", words, 1, "status 3", shadow)
