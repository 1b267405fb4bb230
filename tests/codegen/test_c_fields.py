"""Structures that Python and C share have one declaration, that of the C headers."""

import ctypes
import re

import pytest

from cosim.codegen.c_fields import fields
from cosim.codegen.c_sources import master_source, source_text
from cosim.codegen.compiler import cached_library
from cosim.coupling.c_structures import PartOfC, SystemOfC
from cosim.fmi.run.c_structures import Ending, Functions, Recording, Run
from cosim.integrate.kernel import Reason, State, _texts


def test_fields_are_those_of_the_header_in_their_order():
    found = dict(fields("solvers/lanes_outputs.h", "Watched", t=ctypes.c_char_p))
    names = "points columns t x u p recorded places rows first margins"
    assert [*found] == names.split()
    assert found["columns"] is ctypes.c_longlong
    assert found["t"] is ctypes.c_char_p
    assert found["margins"] is ctypes.c_void_p
    assert dict(fields("master/fmu.h", "Functions"))["set_time"] is ctypes.c_void_p


def test_fields_may_be_arrays(monkeypatch):
    header = "typedef struct { double t, x[3]; const char\n*names[2]; } Row;"
    monkeypatch.setattr("cosim.codegen.c_fields.source_text", lambda _: header)
    expected = {"t": ctypes.c_double, "x": ctypes.c_double * 3, "names": ctypes.c_char_p * 2}
    assert dict(fields("row.h", "Row")) == expected


def test_structures_have_the_sizes_of_the_compiler():
    mirrored = (Functions, Recording, Run, PartOfC, SystemOfC)
    sizes = ", ".join(f"sizeof({mirror.__name__.removesuffix('OfC')})" for mirror in mirrored)
    text = master_source("open_system.h", "run.h")
    text += f"SHARED const size_t *all_sizes(void) {{ static size_t a[] = {{{sizes}}}; return a; }}"
    library = ctypes.CDLL(str(cached_library(f"sizes {text}", lambda: text)))
    library.all_sizes.restype = ctypes.POINTER(ctypes.c_size_t * len(mirrored))
    assert list(library.all_sizes().contents) == [ctypes.sizeof(mirror) for mirror in mirrored]


@pytest.mark.parametrize(
    ("header", "mirror"),
    [
        ("solvers/hybrid/settle.h", Reason),
        ("solvers/hybrid/switching.h", State),
        ("master/run.h", Ending),
    ],
)
def test_numbers_that_python_names_are_those_of_the_header(header, mirror):
    text = re.sub(r"/\*.*?\*/", "", source_text(header), flags=re.DOTALL)
    enumerations = (re.findall(r"\w+", body) for body in re.findall(r"enum \{([\s\w,]*)\}", text))
    (names,) = (found for found in enumerations if mirror(0).name in found)
    assert [member.name for member in mirror] == names
    assert [*mirror] == [*range(len(names))]


def test_every_ending_that_is_an_error_has_a_text_in_c():
    texts = _texts()
    assert {*Reason} - {*texts} == {Reason.GOES_ON, Reason.STOPPED}
    for text, facts in texts.values():
        assert text.count("%") == len(facts) > 0
