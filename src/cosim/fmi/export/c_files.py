"""Generated C files of an FMU: constants, table of variables, equations."""

import re
from collections.abc import Sequence
from math import inf

import casadi as ca

from casadi_models.dae.hybrid import Hybrid
from casadi_models.dae.invariants import SINGULAR_CONDITION
from cosim.codegen.casadi_library import work_sizes
from cosim.codegen.fmu.equations import generated_code
from cosim.codegen.fmu.solver import most_trials, of_fixed_steps
from cosim.codegen.hybrid_laws import law_sizes, law_tables
from cosim.codegen.pieces import in_pieces
from cosim.errors import UsageError
from cosim.fmi.export.events import LEAST_STEPS, fmu_pulses
from cosim.fmi.export.plan import Plan
from cosim.fmi.export.variables import FmuVariable, Role
from cosim.text import violated


def model_header(plan: Plan, guid: str, equations: str) -> str:
    """Return `model.h`: sizes and names for compiling the runtime with the equations' code."""
    dae, options, step_size = plan.dae, plan.options, plan.step_size
    stages, order = of_fixed_steps(plan.solver)
    longest = min(options.max_step or inf, dae.experiment.stop_time / LEAST_STEPS)
    return f"""/* Generated from {dae.full_name}. */
#ifndef MODEL_H
#define MODEL_H
#define MODEL_IDENTIFIER {_literal(plan.name)}
#define MODEL_PREFIX {plan.name}_
#define MODEL_NAME {_literal(dae.full_name)}
#define MODEL_GUID {_literal(guid)}
#define NX {len(dae.states)}
#define NZ {len(dae.algebraics)}
#define NU {len(dae.inputs)}
#define NP {len(dae.parameters)}
#define NC {plan.laws.c.numel()}
#define NY {len(dae.output_variables)}
#define N_LIMITS {len(dae.limits)}
#define N_WARNINGS {len(plan.warnings)}
#define BOUNDED_LIMITS {len(plan.bounds.relations)}
#define LIMITS_OF_TIME {int(plan.bounds.of_time)}
#define LAWS_OF_TIME {int(ca.depends_on(ca.vertcat(dae.ode, dae.alg), dae.t))}
#define HAS_VALID {int(options.valid)}
#define DEFAULT_TOLERANCE {options.tolerance!r}
#define HAS_RANK {int(plan.detects_singularity)}
#define LEAST_RANK {1 / SINGULAR_CONDITION!r}
#define HAS_ADJOINT {int(options.fmi == 3 and options.derivatives)}
#define NO_DERIVATIVES {int(not options.derivatives)}
#define SOLVER_DOP853 {int(plan.dop853)}
#define FIXED_STEPS {stages}
#define ORDER_OF_STEPS {order}
#define LARGEST_STEP {longest if step_size is None else step_size!r}
#define MOST_TRIALS {most_trials(dae, plan.solver)}
{work_sizes(equations)}{_event_sizes(plan.system)}#endif
"""


def variable_table(plan: Plan) -> str:
    """Return `tables.h`: variables by value reference, validity conditions, relations, events."""
    limits = [meaning for _, meaning in plan.dae.limits]
    bounds = plan.bounds
    bounded, moving = (*bounds.relations, -1), (*bounds.moving, -1)
    numbers = [variable for variable in plan.variables if variable.role is not Role.VALIDITY]
    rows = "".join(f"    {{{', '.join(_fields(variable))}}},\n" for variable in numbers)
    return f"""/* Generated. */
#include <float.h>
#include <stddef.h>

static const VariableInfo variables[] = {{
{rows}}};

{_texts("limits", limits)}
{_texts("violations", [violated(meaning) for meaning in limits])}
{_texts("warnings", plan.warnings) if plan.warnings else ""}
static const int bounded_limits[] = {{{", ".join(map(str, bounded))}}};
static const int moving_limits[] = {{{", ".join(map(str, moving))}}};
{_event_tables(plan)}"""


def _event_sizes(system: Hybrid | None) -> str:
    """Return the sizes of events for model.h; empty without events."""
    if system is None:
        return ""
    sizes = law_sizes(system) | {
        "N_WATCHED": system.of_time.count(False),
        "N_PULSES": len(fmu_pulses(system.dae)),
    }
    return "".join(f"#define {name} {size}\n" for name, size in sizes.items())


def _event_tables(plan: Plan) -> str:
    """Return the tables of relations, events and pulses for tables.h; empty without events."""
    if (system := plan.system) is None:
        return ""
    pulses = [*map(repr, fmu_pulses(system.dae).tolist()), "0.0"]
    inputs = [variable.name for variable in plan.variables if variable.role is Role.INPUT]
    movers = map(system.movers, range(len(system.relations)))
    texts = {
        "relation_names": [system.described(i) for i in range(len(system.relations))],
        "relation_movers": [", ".join(inputs[k] for k in own) for own in movers],
        "rule_names": [event.name for event in system.events],
        "rule_messages": [event.message for event in system.events],
    }
    return f"""
{law_tables(system, plan.functions)}
{"".join(_texts(name, own) for name, own in texts.items())}
static const double pulses[] = {{{", ".join(pulses)}}};
"""


def _texts(name: str, texts: Sequence[str]) -> str:
    lines = "".join(f"    {literal},\n" for literal in (*map(_literal, texts), "NULL"))
    return f"static const char *const {name}[] = {{\n{lines}}};\n"


# Start values and derivatives are most of the code, and no solver evaluates them in every step.
_SMALL_FUNCTION = re.compile(
    r"^(/\* (?:along|back|blocks|constants|start)\w*:.*\n)(?=static int )", re.MULTILINE
)


# The heading of at least one function: not every model has functions of its derivatives.
_HEADING = re.compile(r"^/\* \w+:.*\n(?:SMALL )?(?:static )?int ", re.MULTILINE)

_SYSTEM_HEADER = re.compile(r"^#include <[^>]*>\n", re.MULTILINE)


def equations_c(plan: Plan) -> str:
    """Return `equations.c`: CasADi's code, its functions static.

    Raises:
        UsageError: This version of CasADi generates code in another form.
    """
    generated = generated_code(
        plan.laws, plan.name, plan.functions, plan.solver, has_events=plan.system is not None
    )
    code = re.sub(r"^ \* +$", " *", generated, flags=re.MULTILINE)
    code = _SMALL_FUNCTION.sub(r"\1SMALL ", in_pieces(code))
    if not _HEADING.search(code):
        raise UsageError(
            f"casadi {ca.CasadiMeta.version()} names generated functions differently; "
            "use casadi 3.8"
        )
    # system headers come first, as everything after generated.h is hidden
    headers = sorted({"#include <math.h>\n", *_SYSTEM_HEADER.findall(code)})
    return "".join((*headers, '#include "generated.h"\n', code))


_NOT_ALL_USED = """/* The whole FMU; no other file here is compiled by itself. */
#if defined __GNUC__
#pragma GCC diagnostic ignored "-Wunused-function" /* no FMU uses all */
#endif
"""


def whole_unit(plan: Plan) -> str:
    """Return `fmu.c`, the one file to compile: it includes the others, the equations last."""
    parts = (*sorted(name for name in plan.runtime if name.endswith(".c")), "equations.c")
    return _NOT_ALL_USED + "".join(f'#include "{name}"\n' for name in parts)


def _fields(variable: FmuVariable) -> tuple[str, ...]:
    guess = variable.start if variable.guess is None else variable.guess
    start = guess if variable.start is None else variable.start
    return (
        _literal(variable.name),
        variable.role.name,
        variable.start_kind.name,
        _double(start or 0.0),
        _double(variable.nominal),
        _double(variable.minimum),
        _double(variable.maximum),
        _double(guess or 0.0),
        str(variable.tunable).lower(),
        str(variable.rests_at_zero).lower(),
    )


def _double(value: float) -> str:
    """Return a C literal with the same bits."""
    if value in (float("inf"), float("-inf")):
        return "DBL_MAX" if value > 0 else "-DBL_MAX"
    return repr(float(value))


def _literal(text: str) -> str:
    """Return a text as C literal, on one line."""
    escaped = " ".join(text.split()).replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'
