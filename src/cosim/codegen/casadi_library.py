"""Compiled twins of CasADi functions, from the cache of shared libraries."""

import hashlib
from collections.abc import Sequence

import casadi as ca

from cosim.codegen.compiler import cached_library
from cosim.codegen.externals import sources_beside


def external(functions: Sequence[ca.Function], key: str, names: Sequence[str]) -> list[ca.Function]:
    """Return compiled twins of functions, by name, from the cache where it has them.

    Args:
        functions: What is compiled into one library.
        key: See `cache_key`.
        names: Which of the functions are wanted.

    Raises:
        MissingTool: There is no compiler, or it fails.
        UsageError: They call a library's function whose C code is not at hand.
    """

    def generate() -> str:
        generator = ca.CodeGenerator("code", {"with_header": False})
        for function in functions:
            generator.add(function)
        return str(generator.dump())

    path = str(cached_library(key, generate, sources_beside(*functions)))
    return [ca.external(name, path) for name in names]


def cache_key(kind: str, function: ca.Function, *more: bytes) -> str:
    """Return what the compiled twin of a function is known by: same key, same code."""
    digest = hashlib.sha256(b"\0".join((function.serialize().encode(), *more))).hexdigest()
    return f"{kind} {ca.CasadiMeta.version()} {digest}"
