"""The C structures of fmu/master/coupling.h, and the compiled master."""

import ctypes

from cosim.codegen.c_sources import master_source
from cosim.codegen.compiler import cached_library
from cosim.fmi.run.c_structures import Functions, Recording
from cosim.memo import cached_per_thread

_LONG, _DOUBLE, _POINTER = ctypes.c_longlong, ctypes.c_double, ctypes.c_void_p


class PartOfC(ctypes.Structure):
    """`Part` in fmu/master/part.h."""

    _fields_ = (
        ("call", ctypes.POINTER(Functions)),
        *((name, ctypes.POINTER(Recording)) for name in ("recording", "given", "shown")),
        *((name, _LONG) for name in ("place", "turn", "inputs", "outputs")),
        *((name, _LONG) for name in ("first_input", "first_output")),
        *((name, _LONG) for name in ("moving_inputs", "moving_outputs")),
        ("input_references", _POINTER),
        ("output_references", _POINTER),
        *((name, _LONG) for name in ("order", "rates", "rolls_back", "directional", "event_mode")),
        ("own_step", _DOUBLE),
        *((name, _LONG) for name in ("steps", "restored", "waits")),
        ("reached", _DOUBLE),
        ("saved", _POINTER),
    )


class SystemOfC(ctypes.Structure):
    """`System` in fmu/master/coupling.h."""

    _fields_ = (
        ("parts", ctypes.POINTER(PartOfC)),
        *((name, _LONG) for name in ("n_parts", "inputs", "outputs")),
        *(
            (name, _POINTER)
            for name in ("source", "factor", "offset", "held", "feeds", "u", "scale", "grows")
        ),
        ("times", _POINTER),
        ("points", _LONG),
        *((name, _DOUBLE) for name in ("start", "stop", "macro_step", "tolerance", "quantum")),
        ("refinement", _DOUBLE),
        *((name, _LONG) for name in ("method", "threads")),
        ("called", _POINTER),
        *((name, _LONG) for name in ("how", "rows", "macro_steps", "rejected", "iterations")),
        *((name, _LONG) for name in ("unsettled", "forced", "part", "input", "status")),
        ("function", ctypes.c_char_p),
        *((name, _DOUBLE) for name in ("time", "mismatch", "noise")),
    )


@cached_per_thread(1)
def coupling_library() -> ctypes.CDLL:
    """Return the library with `settle_coupled`, `run_coupled` and `give_inputs`."""
    text = master_source("coupling.h")
    library = ctypes.CDLL(str(cached_library(f"master {text}", lambda: text)))
    for call in (library.settle_coupled, library.run_coupled):
        call.argtypes, call.restype = [ctypes.POINTER(SystemOfC)], None
    return library
