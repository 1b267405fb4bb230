"""The kernel of events (fmu/solvers/hybrid) with the laws of a model, as a compiled library."""

from typing import NamedTuple

import casadi as ca

from casadi_models.dae.hybrid import Hybrid
from cosim.codegen.c_sources import solver_source
from cosim.codegen.casadi_library import library_around
from cosim.codegen.functions import dense
from cosim.codegen.hybrid_laws import law_functions, law_sizes, law_tables
from cosim.codegen.initialization import algebraic_function
from cosim.memo import cached_per_thread

_SIZES = ("MODES", "EVENTS", "ASSIGNED", "DEFECTS", "BOUNDED", "ENCLOSED")


class LawText(NamedTuple):
    """C text of a model's laws, around headers of fmu/solvers.

    Attributes:
        functions: CasADi's functions, whose code comes first.
        sizes: Definitions of sizes, before the headers.
        tables: Tables of relations and rules, and the definition of all that the kernel needs,
            after model_laws.h.
    """

    functions: list[ca.Function]
    sizes: str
    tables: str


NO_LAWS = LawText(
    [],
    "".join(f"#define {name} 0\n" for name in _SIZES),
    "static const ModelLaws model_laws = {0};\n",
)  # of a smooth model


@cached_per_thread(16)
def law_text(system: Hybrid, inputs: ca.Function | None = None) -> LawText:
    """Return the C text of a model's laws.

    Args:
        system: Frozen equations. Where relations slide by these, there are tables only: events are
            left to the caller of a run.
        inputs: `model_inputs(t, u, c) -> (u, du/dt)` if inputs follow a series within a step.
    """
    functions = list[ca.Function]()
    if not system.sliding:
        laws = system.blended()
        functions = [algebraic_function(laws.dae), *law_functions(laws)]
        functions = [dense(f) for f in (*functions, *([] if inputs is None else [inputs]))]
    return LawText(
        functions,
        "".join(f"#define {name} {size}\n" for name, size in law_sizes(system).items()),
        f"{law_tables(system, functions)}static const ModelLaws model_laws = MODEL_LAWS;\n",
    )


@cached_per_thread(16)
def kernel_library(system: Hybrid) -> str:
    """Return the path of the kernel's library for a model, from the cache if possible.

    Raises:
        MissingTool: There is no compiler, or it fails.
        UsageError: The laws call a library function whose C code is not available.
    """
    dae, text = system.dae, law_text(system)
    sizes = {"NX": dae.x.numel(), "NZ": dae.z.numel(), "NU": dae.u.numel(), "NC": dae.p.numel()}
    before = "".join(f"#define {name} {size}\n" for name, size in sizes.items()) + text.sizes
    after = solver_source("instants.h") + text.tables
    return library_around("kernel", before, text.functions, after)
