"""Compiled CasADi functions, and the C code of the external functions that they call."""

import re
from collections.abc import Sequence
from pathlib import Path

import casadi as ca
import numpy as np

from cosim.codegen.compiler import cached_library
from cosim.errors import MissingTool, UsageError
from cosim.memo import cached_per_thread, digest_of

_KINDS = ("External", "GenericExternal")
_INTEGRATORS = ("Erk", "Rosenbrock")
_NAME = b"ImporterInternal::name"
_INCLUDED = re.compile(r'^[ \t]*#[ \t]*include[ \t]+"(.+)".*$', re.MULTILINE)
_SYSTEM_HEADER = re.compile(r"^[ \t]*#[ \t]*include[ \t]+<.+>.*$", re.MULTILINE)
_SAME = 1e-9  # difference that compiler flags may cause, relative and absolute; of results ...
_ROUNDING = 1e-14  # ... that hardly change with the arguments, the absolute one is smaller
_TRIALS = 5

# An embedded function is visible inside the library only, system headers everywhere
_WITHIN = Path(__file__).with_name("embedded.h").read_text(encoding="utf-8")
_ALONE = Path(__file__).with_name("exported.h").read_text(encoding="utf-8")


def sources_beside(*functions: ca.Function) -> dict[str, str]:
    """Return the C code of the external functions that functions call, by file name.

    Raises:
        UsageError: C code is missing, does not compile, or differs from its library.
    """
    called = {}
    for function in functions:
        for found in (function, *function.find_functions()):
            if found.class_name() in _KINDS:
                called[found.name()] = found
    files: dict[str, str] = {}
    for path, code in {_source(function) for function in called.values()}:
        visible = _SYSTEM_HEADER.sub(r"COSIM_VISIBLE\n\g<0>\nCOSIM_END", code)
        name, text = f"external_{path.stem}.c", f"{_WITHIN}{visible}\nCOSIM_END\n"
        if files.setdefault(name, text) != text:
            raise UsageError(f"two external functions have sources named {path.name}; rename one")
    return dict(sorted(files.items()))


def add_integrator(generator: ca.CodeGenerator, run: ca.Function) -> None:
    """Add an integrator, or a function that calls one, to generated code.

    CasADi omits the integrator's own functions if they call a library, so they are added here.
    """
    called = run.find_functions()
    if any(function.class_name() in _KINDS for function in called):
        for function in (run, *called):
            if function.class_name() in _INTEGRATORS:
                for part in function.find_functions(0):
                    generator.add(part)
    generator.add(run)


def _source(function: ca.Function) -> tuple[Path, str]:
    """Return path and content of the C code that an external function was compiled from."""
    name, library = function.name(), _library(function)
    places = [] if library is None else _places(library)
    path = next((place for place in places if place.is_file()), None)
    if path is None:
        remedy = (
            f"put {places[-1].name} beside {library}" if places else "store its C code beside it"
        )
        raise UsageError(
            f"external function '{name}': its C code is missing, which machine code and FMUs "
            f"need; {remedy}, or import it with casadi.Importer('FILE.c', 'shell')"
        )
    path = path.resolve()
    code = _unfolded(path, ())
    _reject_other_code(name, function, path, code)
    return path, code


def _places(library: Path) -> list[Path]:
    """Return possible paths of a library's C code, the most likely one last."""
    if library.suffix == ".c":
        return [library]
    stems = dict.fromkeys((library.stem, library.stem.removeprefix("lib")))
    return [library.with_name(f"{stem}.c") for stem in stems]


def _library(function: ca.Function) -> Path | None:
    """Return the file of an external function, which only its serialized form contains."""
    letters = function.serialize({"debug": True})
    halves = letters.translate(str.maketrans("abcdefghijklmnop", "0123456789abcdef"))
    pairs = zip(halves[1::2], halves[::2], strict=True)  # the lower half of each byte comes first
    content = bytes.fromhex("".join(f"{high}{low}" for high, low in pairs))
    _, found, rest = content.rpartition(_NAME)
    if not found or rest[:2] != b"si":
        return None
    size = int.from_bytes(rest[2:6], "little")
    return Path(rest[6 : 6 + size].decode())


def _unfolded(path: Path, within: tuple[Path, ...]) -> str:
    """Return the text of a C file with the headers in its folder inserted."""

    def header(found: re.Match[str]) -> str:
        place = path.parent / found[1]
        if not place.is_file() or place in within:
            return found[0]
        return _unfolded(place, (*within, place))

    try:
        return _INCLUDED.sub(header, path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"{path} cannot be read as C code: {error}") from error


def _reject_other_code(name: str, function: ca.Function, path: Path, code: str) -> None:
    """Reject C code whose results differ from those of the library, e.g. an older version."""
    compiled = _compiled(name, path, code)
    random = np.random.default_rng(1)
    for _ in range(_TRIALS):
        arguments = [
            ca.DM(pattern, random.uniform(-2, 2, pattern.nnz()))
            for pattern in map(function.sparsity_in, range(function.n_in()))
        ]
        nearby = [(1 + _SAME) * argument for argument in arguments]
        pairs = [map(f.call, (arguments, nearby)) for f in (function, compiled)]
        both = np.array([[ca.veccat(*results).full().ravel() for results in p] for p in pairs])
        with np.errstate(invalid="ignore", over="ignore"):  # infinity minus infinity
            moved = 1e3 * np.abs(both[:, 1] - both[:, 0]).max(axis=0)
        absolute = np.clip(np.nan_to_num(moved), _ROUNDING, _SAME)
        if not np.allclose(both[0, 0], both[1, 0], rtol=_SAME, atol=absolute, equal_nan=True):
            raise UsageError(
                f"external function '{name}': {path} computes something else than the "
                "library; compile the library again"
            )


@cached_per_thread(16)
def _compiled(name: str, path: Path, code: str) -> ca.Function:
    """Return an external function compiled from its C code."""
    key = f"external {digest_of([code.encode()])}"
    try:
        return ca.external(name, str(cached_library(key, lambda: _ALONE + code)))
    except (MissingTool, RuntimeError) as error:
        reason = " ".join(str(error).split())
        raise UsageError(
            f"external function '{name}': {path} cannot be compiled or loaded: {reason}"
        ) from error


def external(functions: Sequence[ca.Function], key: str, names: Sequence[str]) -> list[ca.Function]:
    """Return compiled versions of functions, from the cache if possible.

    Raises:
        MissingTool: There is no compiler, or it fails.
        UsageError: The functions call a library whose C code is missing.
    """
    sources = sources_beside(*functions)
    path = str(cached_library(key, lambda: generated("code", *functions), sources))
    return [ca.external(name, path) for name in names]


def generated(name: str, *functions: ca.Function) -> str:
    """Return the C code that CasADi generates for functions, under the name of a file."""
    generator = ca.CodeGenerator(name, {"with_header": False})
    for function in functions:
        generator.add(function)
    return str(generator.dump())


_WORK = re.compile(r"\*sz_(arg|res|iw|w) = (\d+);")


def work_sizes(code: str) -> str:
    """Return definitions of the work space that is enough for each function in CasADi's code."""
    most = dict.fromkeys(("arg", "res", "iw", "w"), 0)
    for kind, size in _WORK.findall(code):
        most[kind] = max(most[kind], int(size))
    return "".join(f"#define WORK_{kind.upper()} {size}\n" for kind, size in most.items())


def generated_with_sizes(name: str, *functions: ca.Function) -> str:
    """Return what `generated` does, after definitions of the work space that is enough."""
    code = generated(name, *functions)
    return work_sizes(code) + code


def library_around(kind: str, before: str, functions: Sequence[ca.Function], after: str) -> str:
    """Return the path of the library of functions' C code within other text, from the cache.

    Args:
        kind: Begins the key in the cache.
        before, after: C text around the functions, one at least.
        functions: They; code after them finds the sizes of their work space as well.

    Raises:
        MissingTool: There is no compiler, or it fails.
        UsageError: The functions call a library whose C code is missing.
    """

    def generate() -> str:
        return f"{before}{generated_with_sizes('code', *functions)}\n{after}"

    first, *others = functions
    more = "".join((before, after, *(function.serialize() for function in others)))
    key = cache_key(kind, first, more.encode())
    return str(cached_library(key, generate, sources_beside(*functions)))


def cache_key(kind: str, function: ca.Function, *more: bytes) -> str:
    """Return the key of a compiled function in the cache; the same key means the same code."""
    digest = digest_of((function.serialize().encode(), *more))
    return f"{kind} {ca.CasadiMeta.version()} {digest}"
