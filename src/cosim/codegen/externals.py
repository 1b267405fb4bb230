"""The C code of functions that come from a library: it goes where that of their callers goes.

CasADi's generated code calls a `casadi.external` by name and leaves it to others to link one. Found
is the C file that an `Importer` compiles, or the one of a library's name beside it.
"""

import hashlib
import re
from pathlib import Path

import casadi as ca
import numpy as np

from cosim.codegen.compiler import cached_library
from cosim.errors import MissingTool, UsageError
from cosim.memo import kept_per_thread

_KINDS = ("External", "GenericExternal")
_INTEGRATORS = ("Erk", "Rosenbrock")
_NAME = b"ImporterInternal::name"
_INCLUDED = re.compile(r'^[ \t]*#[ \t]*include[ \t]+"(.+)".*$', re.MULTILINE)
_SYSTEM_HEADER = re.compile(r"^[ \t]*#[ \t]*include[ \t]+<.+>.*$", re.MULTILINE)
_SAME = 1e-9  # of a value: what flags of compilers may change
_TRIALS = 5

# An embedded function is for its caller alone, not for who loads the library
_WITHIN = """#if defined __GNUC__ && !defined _WIN32
#define COSIM_VISIBLE _Pragma("GCC visibility push(default)")
#define COSIM_HIDDEN _Pragma("GCC visibility push(hidden)")
#define COSIM_END _Pragma("GCC visibility pop")
#else
#define COSIM_VISIBLE
#define COSIM_HIDDEN
#define COSIM_END
#endif
#define CASADI_SYMBOL_EXPORT
COSIM_HIDDEN
"""
_ALONE = """#if defined __GNUC__ && !defined _WIN32
#pragma GCC visibility push(default)
#elif defined _WIN32
#define CASADI_SYMBOL_EXPORT __declspec(dllexport)
#endif
"""


def sources_beside(*functions: ca.Function) -> dict[str, str]:
    """Return the C code of what functions call in libraries, by file name; {} where they do not.

    Raises:
        UsageError: C code is not at hand, does not compile, or is not that of the library.
    """
    called = {}
    for function in functions:
        for found in (function, *function.find_functions()):
            if found.class_name() in _KINDS:
                called[found.name()] = found
    files: dict[str, str] = {}
    for path, code in {_source(function) for function in called.values()}:
        name, text = f"external_{path.stem}.c", _embedded(code)
        if files.setdefault(name, text) != text:
            raise UsageError(f"two external functions have sources named {path.name}; rename one")
    return dict(sorted(files.items()))


def add_integrator(generator: ca.CodeGenerator, run: ca.Function) -> None:
    """Add an integrator, or what calls one, to generated code.

    CasADi does not find the integrator's own functions there where they call a library.
    """
    called = run.find_functions()
    if any(function.class_name() in _KINDS for function in called):
        for function in (run, *called):
            if function.class_name() in _INTEGRATORS:
                for part in function.find_functions(0):
                    generator.add(part)
    generator.add(run)


def _embedded(code: str) -> str:
    """Return C code whose functions stay within a library; what it includes is as it is."""
    visible = _SYSTEM_HEADER.sub(r"COSIM_VISIBLE\n\g<0>\nCOSIM_END", code)
    return f"{_WITHIN}{visible}\nCOSIM_END\n"


def _source(function: ca.Function) -> tuple[Path, str]:
    """Return file and content of the C code that a function was compiled from."""
    name, library = function.name(), _library(function)
    places = [] if library is None else _places(library)
    path = next((place for place in places if place.is_file()), None)
    if path is None:
        wanted = f"put {places[-1].name} beside {library}" if places else "keep it with its C code"
        raise UsageError(
            f"external function '{name}': its C code is not at hand, which machine code and FMUs "
            f"need; {wanted}, or import it with casadi.Importer('FILE.c', 'shell')"
        )
    path = path.resolve()
    code = _unfolded(path, ())
    _refuse_other_code(name, function, path, code)
    return path, code


def _places(library: Path) -> list[Path]:
    """Return where the C code of a library may be, the likeliest last."""
    if library.suffix == ".c":
        return [library]
    stems = dict.fromkeys((library.stem, library.stem.removeprefix("lib")))
    return [library.with_name(f"{stem}.c") for stem in stems]


def _library(function: ca.Function) -> Path | None:
    """Return the file that an external function was imported from; only its archive tells."""
    letters = function.serialize({"debug": True})
    halves = letters.translate(str.maketrans("abcdefghijklmnop", "0123456789abcdef"))
    pairs = zip(halves[1::2], halves[::2], strict=True)  # of each byte, the lower half comes first
    content = bytes.fromhex("".join(f"{high}{low}" for high, low in pairs))
    _, found, rest = content.rpartition(_NAME)
    if not found or rest[:2] != b"si":
        return None
    size = int.from_bytes(rest[2:6], "little")
    return Path(rest[6 : 6 + size].decode())


def _unfolded(path: Path, within: tuple[Path, ...]) -> str:
    """Return a C file with the headers that lie beside it in their places."""

    def header(found: re.Match[str]) -> str:
        place = path.parent / found[1]
        if not place.is_file() or place in within:
            return found[0]
        return _unfolded(place, (*within, place))

    try:
        return _INCLUDED.sub(header, path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"{path} cannot be read as C code: {error}") from error


def _refuse_other_code(name: str, function: ca.Function, path: Path, code: str) -> None:
    """Refuse C code that does not compute what a library does: an older one, or another."""
    twin = _twin(name, path, code)
    random = np.random.default_rng(1)
    for _ in range(_TRIALS):
        arguments = [
            ca.DM(pattern, random.uniform(-2, 2, pattern.nnz()))
            for pattern in map(function.sparsity_in, range(function.n_in()))
        ]
        for own, other in zip(function.call(arguments), twin.call(arguments), strict=True):
            values = np.array(own), np.array(other)
            if not np.allclose(*values, rtol=_SAME, atol=_SAME, equal_nan=True):
                raise UsageError(
                    f"external function '{name}': {path} computes something else than the "
                    "library; compile the library anew"
                )


@kept_per_thread(16)
def _twin(name: str, path: Path, code: str) -> ca.Function:
    key = f"external {hashlib.sha256(code.encode()).hexdigest()}"
    try:
        return ca.external(name, str(cached_library(key, lambda: _ALONE + code)))
    except (MissingTool, RuntimeError) as error:
        reason = " ".join(str(error).split())
        raise UsageError(f"external function '{name}': {path} is of no use: {reason}") from error
