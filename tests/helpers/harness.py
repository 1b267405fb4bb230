"""Compile the runtime with a toy model, and call it through ctypes as an importer does."""

import ctypes
import os
import shutil
import subprocess
from collections.abc import Callable, Sequence
from ctypes import (
    CFUNCTYPE,
    byref,
    c_bool,
    c_char,
    c_char_p,
    c_double,
    c_int,
    c_size_t,
    c_uint,
    c_void_p,
)
from functools import cache
from pathlib import Path
from typing import Any

import fmpy
import pytest
from helpers import event_models, toy

from cosim.codegen.compiler import SUFFIX, compile_library
from cosim.codegen.fmu.solver import LOOK_STEPS

RUNTIME = Path(__file__).parents[2] / "fmu" / "runtime"
SOLVERS = RUNTIME.parent / "solvers"
INCLUDES = [f"-I{SOLVERS}", f"-I{SOLVERS / 'hybrid'}"]
HERE = Path(__file__).parents[1] / "runtime"
HEADERS = Path(fmpy.__file__).parent / "c-code"
# A shared library has FMI's own names; two instances of a model in one program need no others.
NAMES = "-DFMI3_OVERRIDE_FUNCTION_PREFIX"
POSIX = "-D_POSIX_C_SOURCE=200809L"  # whose clocks and threads the programs of the tests use
STRICT = [
    "-std=c11",
    NAMES,
    "-Wall",
    "-Wextra",
    "-Wpedantic",
    "-Wconversion",
    "-Werror",
    "-Wno-unused-function",
]  # no model uses all
SANITIZED = ["-g", "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
THREADED = ["-g", "-O1", "-fsanitize=thread"]
# The C library's functions of memory are the test's
WRAPPED = [f"-Wl,--wrap={name}" for name in ("calloc", "malloc", "free")]
FUZZED_STEPS = 100  # of a solver: what a call does when they are used up, it does sooner
OK, WARNING, DISCARD, ERROR = range(4)
NAN, INF = float("nan"), float("inf")


def compiler() -> str | None:
    """Return a C compiler of this machine."""
    return next((path for name in ("cc", "gcc", "clang") if (path := shutil.which(name))), None)


def sources(model: Path, version: int) -> list[Path]:
    """Return the runtime's files for one FMI version and the solver that a model is written for."""
    dop853 = "SOLVER_DOP853 1" in (model / "model.h").read_text()
    others = (f"fmi{5 - version}", "integration_step" if dop853 else "integration_dop853")
    return sorted(path for path in RUNTIME.glob("*.c") if not path.name.startswith(others))


def compiled(model: Path, version: int, flags: Sequence[str], folder: Path) -> Path:
    """Compile runtime (strictly) and model (leniently) as one unit, as exports do."""
    unit, include = _unit(model, version, folder)
    target = unit.with_suffix(".o")
    run([compiler(), *STRICT, *flags, *include, "-c", unit, "-o", target])
    return target


def library(model: Path, version: int, folder: Path) -> ctypes.CDLL:
    """Check the same unit as strictly, and load its library from the compiler of the tests."""
    unit, include = _unit(model, version, folder)
    run([compiler(), *STRICT, *include, "-fsyntax-only", unit])
    options = ["-std=c11", NAMES, *map(str, include)]
    return ctypes.CDLL(str(compile_library([unit], folder / f"fmu{SUFFIX}", options=options)))


def _unit(model: Path, version: int, folder: Path) -> tuple[Path, list[Any]]:
    """Write the file that includes runtime and model; return it and where its headers are."""
    folder.mkdir(parents=True, exist_ok=True)
    unit = folder / f"fmu{version}.c"
    names = (*(file.name for file in sources(model, version)), "equations.c")
    unit.write_text("".join(f"#include <{name}>\n" for name in names))
    return unit, [f"-I{RUNTIME}", *INCLUDES, "-isystem", model, "-isystem", HEADERS]


def program(
    name: str, model: Path, version: int, folder: Path, flags: Sequence[str] = SANITIZED
) -> Path:
    """Build a C program of this folder with model and runtime, under the sanitizers."""
    unit = compiled(model, version, flags, folder)
    include = [f"-I{model}", f"-I{RUNTIME}", *INCLUDES, "-isystem", HEADERS]
    target = folder / name
    source = HERE / f"{name}.c"
    run(
        [
            compiler(),
            *STRICT,
            POSIX,
            *flags,
            *include,
            source,
            unit,
            "-o",
            target,
            "-lm",
            "-pthread",
        ]
    )
    return target


def fuzzers(new_folder: Callable[[str], Path]) -> Callable[..., Path]:
    """Return what builds a program of random calls on the toy, once for a solver and flags.

    "step rank" is the solver "step" of a toy with a watch; "dop853 events" and "rosenbrock events"
    are solvers of a model with every kind of event. That of FMI 2 lets memory run out, and counts
    it.
    """

    @cache
    def folder(solver: str, *flags: str) -> Path:
        made = new_folder("fuzz")
        kind, _, more = solver.partition(" ")
        if more == "events":
            dae = event_models.everything(slides=kind == "dop853")
            steps = 1 if kind == "dop853" else LOOK_STEPS
            event_models.write(made, dae, kind, fmi=3, most_trials=20 * FUZZED_STEPS // steps)
            return made
        options = {"rank": more == "rank", "most_steps": FUZZED_STEPS}
        toy.write(made, toy.toy(), toy.TABLE, kind, **options)
        return made

    @cache
    def build(solver: str, version: int, *flags: str) -> Path:
        model, more = folder(solver, *flags), WRAPPED if version == 2 else []
        return program(f"fuzz_fmi{version}", model, version, model / "built", [*flags, *more])

    return build


def run(command: Sequence[Any], timeout: float = 300) -> str:
    """Run a command; return what it printed, or fail with what it complained of."""
    environment = os.environ | {"ASAN_OPTIONS": "detect_leaks=1"}
    done = subprocess.run(
        [str(part) for part in command],
        capture_output=True, text=True, timeout=timeout, env=environment, check=False,
    )  # fmt: skip
    assert done.returncode == 0, f"{command[0]}: {done.returncode}\n{done.stderr[-4000:]}"
    return done.stdout


class Callbacks(ctypes.Structure):
    """fmi2CallbackFunctions; without memory functions the instance uses its own."""

    _fields_ = [
        ("logger", c_void_p),
        ("allocate", c_void_p),
        ("free", c_void_p),
        ("finished", c_void_p),
        ("environment", c_void_p),
    ]


class EventInfo(ctypes.Structure):
    """fmi2EventInfo."""

    _fields_ = [
        *((name, c_int) for name in ("needed", "terminate", "nominals", "values", "defined")),
        ("next_time", c_double),
    ]


# fmi3IntermediateUpdateCallback
UPDATE = CFUNCTYPE(
    None, c_void_p, c_double, c_bool, c_bool, c_bool, c_bool,
    ctypes.POINTER(c_bool), ctypes.POINTER(c_double),
)  # fmt: skip


def rows_of(table: str) -> list[Any]:
    """Return the rows of a table of functions for `parametrize`.

    Each has an interface, the name of a function, and a mark for each state. A bar separates the
    states of model exchange, 0, from those of co-simulation, 1.
    """
    head, *lines = table.strip("\n").splitlines()
    columns = [part.split() for part in head.split("|")]
    rows = []
    for line in lines:
        function, marks = line.split(maxsplit=1)
        for interface, part in enumerate(marks.split("|")):
            own = dict(zip(columns[interface], part.split(), strict=True))
            rows.append(pytest.param(interface, function, own, id=f"{function}-{interface}"))
    return rows


def reals(*values: float) -> ctypes.Array:
    """Return a C array of doubles."""
    return (c_double * len(values))(*values)


def references(*values: int) -> ctypes.Array:
    """Return a C array of value references."""
    return (ctypes.c_uint * len(values))(*values)


class Fmu:
    """One instance; `fmu("Terminate")` calls fmiNTerminate on it and returns the status."""

    prefix: str
    reader: str
    writer: str
    state: str  # as it is called in names of functions

    def __init__(self, lib: ctypes.CDLL, names: Sequence[str]) -> None:
        self.lib = lib
        self.reference = {name: i for i, name in enumerate(names)}
        self.messages: list[tuple[int, str, str]] = []
        self.instance_names: set[bytes] = set()
        self.component: int | None = None

    def __call__(self, function: str, *arguments: Any) -> int:
        plain = [_plain(argument) for argument in arguments]
        called = getattr(self.lib, f"{self.prefix}{function}")
        return int(called(c_void_p(self.component), *plain))

    def free(self) -> None:
        """Free the instance."""
        getattr(self.lib, f"{self.prefix}FreeInstance")(c_void_p(self.component))
        self.component = None

    @property
    def said(self) -> str:
        """The last message."""
        return self.messages[-1][2]

    def refs(self, *names: str) -> ctypes.Array[c_uint]:
        """Return value references by name."""
        return references(*(self.reference[name] for name in names))

    def counts(self, count: int) -> tuple[int, ...]:
        """Return the arguments that say how many values there are."""
        raise NotImplementedError

    def get(self, *names: str) -> list[float]:
        """Read variables; they must be readable."""
        values = reals(*[NAN] * len(names))
        status = self(self.reader, self.refs(*names), len(names), values, *self.counts(len(names)))
        assert status == OK, self.said
        return list(values)

    def set(self, **values: float) -> int:
        """Set variables; return the status."""
        array = reals(*values.values())
        return self(self.writer, self.refs(*values), len(values), array, *self.counts(len(values)))

    def states(self, function: str = "GetContinuousStates", count: int = 4) -> list[float]:
        """Return what a function yields per state."""
        values = reals(*[NAN] * count)
        assert self(function, values, count) == OK, self.said
        return list(values)

    def take(self) -> c_void_p:
        """Return a new FMU state."""
        snapshot = c_void_p()
        assert self(f"Get{self.state}", byref(snapshot)) == OK, self.said
        return snapshot

    def serialize(self, snapshot: c_void_p) -> ctypes.Array[c_char]:
        """Return the bytes of an FMU state."""
        size = c_size_t()
        assert self(f"Serialized{self.state}Size", snapshot, byref(size)) == OK, self.said
        blob = (c_char * size.value)()
        assert self(f"Serialize{self.state}", snapshot, blob, size.value) == OK, self.said
        return blob


class Fmu2(Fmu):
    """An FMI 2 instance."""

    prefix, reader, writer, state = "fmi2", "GetReal", "SetReal", "FMUstate"

    def __init__(
        self,
        lib: ctypes.CDLL,
        names: Sequence[str],
        interface: int = 0,
        *,
        guid: str | None = "{toy-guid}",
        name: str | None = "one",
        resources: str | None = None,
        logging: bool = True,
    ) -> None:
        super().__init__(lib, names)
        signature = CFUNCTYPE(None, c_void_p, c_char_p, c_int, c_char_p, c_char_p)
        self._logger = signature(self._log)
        self._callbacks = Callbacks(logger=ctypes.cast(self._logger, c_void_p))
        lib.fmi2Instantiate.restype = c_void_p
        texts = [text if text is None else text.encode() for text in (name, guid, resources)]
        self.component = lib.fmi2Instantiate(
            texts[0], interface, texts[1], texts[2], byref(self._callbacks), 0, int(logging)
        )

    def _log(self, _: Any, name: bytes, status: int, category: bytes, text: bytes) -> None:
        self.instance_names.add(name)
        self.messages.append((status, category.decode(), text.decode()))

    def counts(self, count: int) -> tuple[int, ...]:
        """Return nothing: FMI 2 gives the count once."""
        return ()

    def set_up(self, start: float = 0.0, stop: float | None = None, tolerance: float = 0.0) -> int:
        """Call fmi2SetupExperiment."""
        has_tolerance, has_stop = int(tolerance != 0), int(stop is not None)
        return self("SetupExperiment", has_tolerance, tolerance, start, has_stop, stop or 0.0)

    def initialize(self, experiment: dict[str, float] | None = None, **start: float) -> "Fmu2":
        """Go through initialization mode."""
        assert self.set_up(**experiment or {}) == OK
        assert self.set(**start) == OK, self.said
        assert self("EnterInitializationMode") == OK
        assert self("ExitInitializationMode") == OK, self.said
        return self


class Fmu3(Fmu):
    """An FMI 3 instance; interface 0 is model exchange, 1 co-simulation, 2 scheduled execution."""

    prefix, reader, writer, state = "fmi3", "GetFloat64", "SetFloat64", "FMUState"

    def __init__(
        self,
        lib: ctypes.CDLL,
        names: Sequence[str],
        interface: int = 0,
        *,
        token: str | None = "{toy-guid}",
        name: str | None = "one",
        events: bool = False,
        logging: bool = True,
        early: bool = True,
        update: Callable[..., None] | None = None,
        wanted: Sequence[str] = (),
    ) -> None:
        super().__init__(lib, names)
        signature = CFUNCTYPE(None, c_void_p, c_int, c_char_p, c_char_p)
        self._logger = signature(self._log)
        kind = ("ModelExchange", "CoSimulation", "ScheduledExecution")[interface]
        create = getattr(lib, f"fmi3Instantiate{kind}")
        create.restype = c_void_p
        texts = [text if text is None else text.encode() for text in (name, token)]
        list_of_wanted = self.refs(*wanted) if wanted else None
        required = [list_of_wanted, c_size_t(len(wanted))]
        extra = {0: [], 1: [events, early, *required], 2: []}[interface]
        self._update = UPDATE(update) if update else None
        callbacks = {0: [], 1: [self._update], 2: [None, None, None]}[interface]
        self.component = create(
            *texts, None, False, logging, *extra, None, self._logger, *callbacks
        )

    def _log(self, _: Any, status: int, category: bytes, text: bytes) -> None:
        self.messages.append((status, category.decode(), text.decode()))

    def counts(self, count: int) -> tuple[int, ...]:
        """Return the number of values, which FMI 3 wants besides that of the references."""
        return (count,)

    def enter(self, start: float = 0.0, stop: float | None = None, tolerance: float = 0.0) -> int:
        """Call fmi3EnterInitializationMode."""
        has_tolerance, has_stop = tolerance != 0, stop is not None
        return self(
            "EnterInitializationMode", has_tolerance, tolerance, start, has_stop, stop or 0.0
        )

    def initialize(self, experiment: dict[str, float] | None = None, **start: float) -> "Fmu3":
        """Go through initialization mode."""
        assert self.set(**start) == OK, self.said
        assert self.enter(**experiment or {}) == OK
        assert self("ExitInitializationMode") == OK, self.said
        return self

    def step(self, time: float, length: float) -> tuple[int, list[bool], float]:
        """Call fmi3DoStep; return status, the three flags and the time reached."""
        flags, reached = [c_bool(True) for _ in range(3)], c_double(NAN)
        status = self("DoStep", time, length, True, *map(byref, flags), byref(reached))
        return status, [flag.value for flag in flags], reached.value


def _plain(argument: Any) -> Any:
    if isinstance(argument, bool):
        return c_bool(argument)
    if isinstance(argument, float):
        return c_double(argument)
    return c_size_t(argument) if isinstance(argument, int) else argument
