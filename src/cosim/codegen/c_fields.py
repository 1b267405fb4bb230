"""C structures that the package's Python and C code share, as the C headers declare them."""

import ctypes
import re
from collections.abc import Sequence
from typing import Any

from cosim.codegen.c_sources import source_text

_COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)
_FUNCTION = re.compile(r"\((\*\w+)\)\([^;]*\)")  # a pointer to one
_DECLARATION = re.compile(r"(?:(?:const|volatile) )*(long long|\w+)\s+([^;]+);")
_NAME = re.compile(r"(\**)(\w+)(?:\[([^\]]+)\])?")
_TYPES = {"long long": ctypes.c_longlong, "double": ctypes.c_double, "char*": ctypes.c_char_p}


def fields(header: str, name: str, **types: Any) -> Sequence[tuple[str, Any]]:
    """Return the fields of a structure, for `ctypes.Structure`.

    An array whose size is no number, such as MODES, counts as a single one of its elements.

    Args:
        header: File in the package's folder of C code, e.g. "master/run.h".
        name: Name of the structure.
        types: Types of fields, or of their items, by name. By default, a pointer is an address,
            but to a text.
    """
    text = _COMMENT.sub("", source_text(header))
    body = text.partition(f"}} {name};")[0].rpartition("typedef struct {")[2]
    found = list[tuple[str, Any]]()
    for kind, names in _DECLARATION.findall(_FUNCTION.sub(r"\1", body)):
        for star, field, size in _NAME.findall(names):
            usual = ctypes.c_void_p if star else None
            own: Any = types.get(field, _TYPES.get(kind + star, usual))
            found.append((field, own * int(size) if size.isdigit() else own))
    return found
