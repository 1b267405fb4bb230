"""Products and sums stay apart in compiled equations, whatever the processor can fuse.

Compiled for processors by name, so that the test says the same on every x86-64.
"""

import platform
from functools import cache
from tempfile import TemporaryDirectory

import pytest
from helpers.instructions import fused, needs_objdump
from helpers.samples import sampled

import casadi_models
import cosim
from cosim.codegen import compiler as compiling

pytestmark = [
    pytest.mark.usefixtures("optimized"),
    needs_objdump,
    pytest.mark.skipif(platform.machine() != "x86_64", reason="names processors of x86-64"),
]
PROCESSORS = ("native", "haswell", "icelake-server")  # the last two: 16 and 32 vector registers
ALTERNATING = """
void answer(double *restrict r, const double *a, const double *b, const double *c) {
    r[0] = a[0] * b[0] - c[0];
    r[1] = a[1] * b[1] + c[1];
}
"""


class _Seen(Exception):
    """Instead of compiling."""


@cache
def compiler_calls(name):
    """Return the C code and the options of what the runs of a formulation compile."""
    seen = []

    def see(sources, target, *, options, **_):
        seen.append((sources[0].read_text(encoding="utf-8"), tuple(options)))
        raise _Seen

    dae = cosim.load(name)
    with pytest.MonkeyPatch.context() as patch, TemporaryDirectory() as cold:
        patch.setenv("COSIM_CACHE", cold)
        patch.setattr(compiling, "compile_library", see)
        for solver in ("idas" if dae.algebraics else "cvodes", "dop853"):
            with pytest.raises(_Seen):
                cosim.simulate(dae, solver=solver, compiled=True)
    return seen


def compiled_for(processor, code, options, folder):
    source, library = folder / "code.c", folder / "code.so"
    source.write_text(code, encoding="utf-8")
    if "ziglang" in compiling.find_compiler():
        processor = processor.replace("-", "_")
    assert "-march=native" in options
    options = [f"-march={processor}" if o == "-march=native" else o for o in options]
    return compiling.compile_library([source], library, options=options)


@pytest.mark.slow_rows(
    "crank_shaft/multipliers", "bicycle/multipliers", "double_pendulum/quaternion"
)
@pytest.mark.parametrize("name", sampled(casadi_models.CATALOG))
def test_no_library_of_a_formulation_has_a_fused_instruction(name, tmp_path):
    for code, options in compiler_calls(name):
        # Long code is compiled without the optimizations that could fuse: one processor will do
        for processor in PROCESSORS[:1] if "-O1" in options else PROCESSORS[-1:]:
            assert fused(compiled_for(processor, code, options, tmp_path)) == {}


@pytest.mark.parametrize("processor", PROCESSORS)
def test_alternating_sums_and_differences_are_not_fused(processor, tmp_path):
    own, _ = compiling._own_processor()
    assert fused(compiled_for(processor, ALTERNATING, [*own, "-O3"], tmp_path)) == {}


def test_inspection_sees_fused_instructions(tmp_path):
    options = ["-march=native", "-ffp-contract=fast", "-O3"]
    library = compiled_for("haswell", ALTERNATING, options, tmp_path)
    assert sum(fused(library).values()) > 0


def test_other_options_mean_another_library(tmp_path, monkeypatch):
    monkeypatch.setenv("COSIM_CACHE", str(tmp_path))
    own, abilities = compiling._own_processor()
    first = compiling.cached_library("key", lambda: ALTERNATING)
    without = tuple(o for o in own if o != "-fno-tree-slp-vectorize")
    monkeypatch.setattr(compiling, "_own_processor", lambda: (without, abilities))
    assert compiling.cached_library("key", lambda: ALTERNATING) != first
    assert without != own
