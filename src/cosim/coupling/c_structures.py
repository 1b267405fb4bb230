"""The C structures of fmu/master/coupling.h, and the compiled master."""

import ctypes

from cosim.codegen.c_fields import fields
from cosim.codegen.c_sources import master_source
from cosim.codegen.compiler import cached_library
from cosim.fmi.run.c_structures import Functions, Recording
from cosim.memo import cached_per_thread

_ROWS = dict.fromkeys(("recording", "given", "shown", "steady"), ctypes.POINTER(Recording))


class PartOfC(ctypes.Structure):
    """`Part` in fmu/master/part.h."""

    _fields_ = fields("master/part.h", "Part", call=ctypes.POINTER(Functions), **_ROWS)


class SystemOfC(ctypes.Structure):
    """`System` in fmu/master/interface.h."""

    _fields_ = fields("master/interface.h", "System", parts=ctypes.POINTER(PartOfC))


@cached_per_thread(1)
def coupling_library() -> ctypes.CDLL:
    """Return the library of fmu/master/open_system.h."""
    text = master_source("open_system.h")
    library = ctypes.CDLL(str(cached_library(f"master {text}", lambda: text)))
    library.numbers_of_coupled.argtypes = [
        ctypes.POINTER(SystemOfC),
        ctypes.c_void_p,
        ctypes.c_int,
    ]
    library.numbers_of_coupled.restype = ctypes.c_longlong
    return library
