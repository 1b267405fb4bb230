"""`Plan`: everything that an FMU is made of, decided before any of it is written."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from importlib.resources.abc import Traversable
from warnings import warn

import casadi as ca

from casadi_models.dae import Dae
from casadi_models.dae.expressions import column
from casadi_models.dae.hybrid import Hybrid
from casadi_models.dae.time_bounds import Enclosures
from cosim.codegen.c_sources import runtime_sources, solver_sources
from cosim.codegen.fmu.equations import (
    bounded_limits,
    embedded_sources,
    fmu_laws,
    has_rank,
    model_functions,
)
from cosim.codegen.fmu.solver import FIXED_STEPS, is_unstable, solver_for, uses_dop853
from cosim.codegen.functions import Laws
from cosim.errors import ParameterError
from cosim.fmi.export.dependencies import (
    Dependencies,
    structural_dependencies,
    tunable_parameters,
    without_modes,
)
from cosim.fmi.export.dialect import DIALECTS, Dialect
from cosim.fmi.export.events import fmu_events, fmu_warnings
from cosim.fmi.export.options import FmuOptions, NameStyle
from cosim.fmi.export.variables import FmuVariable, fmu_variables, structured, with_margins
from cosim.model.reduction import checked_outputs
from cosim.model.times import reject_rounded
from cosim.model.values import listed


@dataclass(frozen=True)
class Plan:
    """The content of an FMU. What writes its files reads the plan and decides nothing.

    Attributes:
        options: The options of the export.
        dialect: What its version of FMI writes differently.
        name: C identifier of the FMU.
        dae: The model as exported: with the selected outputs, margins as outputs, modes as inputs.
        laws: Its equations, with constants for its parameters.
        system: Its relations, events and pulses; None if it has none.
        warnings: What may follow from values of parameters.
        bounds: Bounds of the margins of some limits.
        indicators: Number of event indicators, which are its last outputs.
        variables: All variables; the position of each is its value reference.
        depends: Structural dependencies of the unknowns.
        solver: Name of the solver for co-simulation.
        dop853: Whether this is the runtime's own solver.
        step_size: Longest step of a solver with fixed steps, s; None for other solvers.
        detects_singularity: Whether it detects singular configurations.
        watches_steps: Whether it needs a call after every step in model exchange.
        updates_within_steps: Whether a communication step has points at which it calls the importer
            back.
        functions: The CasADi functions that the runtime calls.
        embedded: C code of the external functions that the model calls, by file name.
    """

    options: FmuOptions
    dialect: Dialect
    name: str
    dae: Dae
    laws: Laws
    system: Hybrid | None
    warnings: tuple[str, ...]
    bounds: Enclosures
    indicators: int
    variables: tuple[FmuVariable, ...]
    depends: Dependencies
    solver: str
    dop853: bool
    step_size: float | None
    detects_singularity: bool
    watches_steps: bool
    updates_within_steps: bool
    functions: tuple[ca.Function, ...]
    embedded: Mapping[str, str]

    @cached_property
    def runtime(self) -> dict[str, bytes]:
        """Its files of fmu/runtime, by name: all but those of parts that it does not need."""
        idle = [part for part in PARTS if not part.needed(self)]
        files = (e for e in runtime_sources() if not any(part.contains(e) for part in idle))
        return {entry.name: entry.read_bytes() for entry in files}

    @cached_property
    def headers(self) -> dict[str, bytes]:
        """Its files of fmu/solvers, by name: those of the parts that it needs."""
        needed = [part for part in PARTS if part.needed(self)]
        files = (e for e in solver_sources() if any(part.contains(e) for part in needed))
        return {entry.name: entry.read_bytes() for entry in files}


@dataclass(frozen=True)
class Part:
    """C files of the package that not every FMU needs.

    Attributes:
        why: The reason why an FMU needs the files.
        needed: Whether the FMU of a plan needs them.
        files: How their names begin in fmu/runtime and fmu/solvers.
    """

    why: str
    needed: Callable[[Plan], bool]
    files: tuple[str, ...]

    def contains(self, entry: Traversable) -> bool:
        """Tell whether a file belongs to this part."""
        return entry.name.startswith(self.files)


MOST_STEPS = 1_000_000  # of equal length, in an output interval; tenths of a second
_KERNEL_OF_EVENTS = (
    *("laws.h", "switching.h", "sliding.h", "departure.h", "settle.h"),
    *("happen.h", "plan.h", "bounds.h", "enclosure.h", "margins.h", "search.h"),
    *("model_laws.h", "ode.h", "cubic.h", "quintic.h", "linear.h"),
)

# Every FMU contains the files of fmu/runtime that belong to no part.
PARTS = (
    Part("the functions of FMI 2.0", lambda plan: plan.options.fmi == 2, ("fmi2",)),
    Part("the functions of FMI 3.0", lambda plan: plan.options.fmi == 3, ("fmi3",)),
    Part(
        "co-simulation with the runtime's own solver",
        lambda plan: plan.dop853,
        ("integration_dop853.c", "dop853.h", "interpolant.h", "ode.h"),
    ),
    Part(
        "co-simulation with a generated solver",
        lambda plan: not plan.dop853,
        ("integration_step.c", "bounds.h", "cubic.h", "quintic.h", "ode.h"),
    ),
    Part(
        "relations, events or pulses",
        lambda plan: plan.system is not None,
        ("modes.c", "events.c", *_KERNEL_OF_EVENTS),
    ),
    Part(
        "validity conditions",
        lambda plan: bool(plan.dae.limits),
        ("margins.h", "bounds.h", "cubic.h", "quintic.h", "ode.h"),
    ),
    Part(
        "a motion between two points of an importer",
        lambda plan: bool(plan.bounds.relations or (plan.system and plan.system.relations)),
        ("looks.h", "cubic.h"),
    ),
    Part(
        "derivatives of results",
        lambda plan: plan.options.derivatives,
        ("sensitivity.h", "output_rates.h"),
    ),
    Part(
        "constraints that may become singular",
        lambda plan: plan.detects_singularity,
        ("rank.c", "projection.h", "cubic.h", "ode.h"),
    ),
)


def planned(dae: Dae, options: FmuOptions) -> Plan:
    """Decide on the content of a model's FMU.

    Raises:
        ExportError, UnknownName, UsageError: See `export_fmu`.
    """
    name = options.identifier_of(dae)
    if options.outputs is not None:
        outputs = checked_outputs(dae, options.outputs)
        dae = replace(dae.watching(outputs), observed=outputs)
    tunable = options.tunable and listed(f"{dae.full_name}: tunable", options.tunable)
    solver = solver_for(dae, options.solver)
    interval = dae.experiment.output_interval
    step_size = options.step_size or interval
    if interval > step_size * MOST_STEPS:
        raise ParameterError(
            f"export: step_size = {step_size:g} s makes more than {MOST_STEPS:.0e} steps in an "
            f"output interval of {interval:g} s; give a longer one"
        )
    reject_rounded("export: max_step", options.max_step, 0.0, dae.experiment.stop_time)
    if solver in FIXED_STEPS and is_unstable(dae, solver, step_size):
        warn(
            f"{dae.full_name}: steps of {step_size:g} s are too long for {solver} at the start "
            "values, as what should decay grows; give a smaller step_size",
            stacklevel=2,
        )
    dae = with_margins(dae, valid=options.valid)
    embedded = embedded_sources(dae)
    tunable = tunable_parameters(dae, tunable)
    system, warnings = fmu_events(dae), fmu_warnings(dae)
    if system is not None:
        dae = system.dae
    wanted = {"derivatives": options.derivatives, "adjoint": options.fmi == 3}
    laws = fmu_laws(dae, system, **wanted)
    modes = len(system.relations) if system else 0
    variables = fmu_variables(dae, tunable, valid=options.valid, modes=modes)
    if options.names == NameStyle.STRUCTURED:
        variables = structured(variables)
    depends = structural_dependencies(dae)
    if system is not None:
        depends = without_modes(depends, system)
    watched = system.of_time.count(False) if system else 0
    bounds, detects_singularity = bounded_limits(dae, system), has_rank(dae)
    moved = system is not None and any(system.of_input)
    dop853, fixed = uses_dop853(dae, solver), solver in FIXED_STEPS
    return Plan(
        options=options,
        dialect=DIALECTS[options.fmi],
        name=name,
        dae=dae,
        laws=laws,
        system=system,
        warnings=tuple(warnings),
        bounds=bounds,
        indicators=len(dae.limits) + watched,
        variables=variables,
        depends=depends,
        solver=solver,
        dop853=dop853,
        step_size=step_size if fixed else None,
        detects_singularity=detects_singularity,
        watches_steps=detects_singularity or moved or bool(bounds.relations),
        updates_within_steps=dop853 or fixed or bool(system or dae.limits or dae.inputs),
        functions=model_functions(laws, system, column(warnings.values()), **wanted),
        embedded=embedded,
    )
