"""A small DAE in the C contract of `fmu/runtime/equations.h`, made with CasADi's generator.

    q' = v,  v' = a,  w' = -w sqrt(q + 10),  s' = blow s^2        s blows up at 1 / (blow s(0))
    0 = mass a + damping v + stiffness q - force - 0.1 r,   0 = r - 2 a - w
    w(t0): w + w^2 = load + push t0

Made without the exporter, so that the contract is written down twice.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf
from pathlib import Path

import casadi as ca
from casadi import MX, SX

from cosim.codegen.runge_kutta.stage_sums import dop853_coefficients

GUID = "{toy-guid}"


@dataclass(frozen=True)
class Row:
    """One line of the generated table of variables."""

    name: str
    role: str
    kind: str = "EXACT"
    start: float = 0.0
    minimum: float = -inf
    maximum: float = inf
    nominal: float = 1.0
    tunable: bool = False


TABLE = (
    Row("time", "TIME"),
    Row("q", "STATE", start=1.0, minimum=-1e3, maximum=1e3, nominal=0.5),
    Row("v", "STATE", nominal=2.0),
    Row("w", "STATE", "CALCULATED", start=0.5),
    Row("s", "STATE", start=1.0),
    *(Row(f"{name}_dot", "DERIVATIVE", "CALCULATED") for name in "qvws"),
    Row("a", "ALGEBRAIC", "GUESS"),
    Row("r", "ALGEBRAIC", "GUESS", start=1.0),
    Row("force", "INPUT"),
    Row("push", "INPUT"),
    Row("mass", "PARAMETER", start=2.0, minimum=1e-3, maximum=1e3),
    Row("stiffness", "PARAMETER", start=8.0),
    Row("damping", "PARAMETER", start=0.5, minimum=0.0, tunable=True),
    Row("load", "PARAMETER", start=2.0, minimum=-1e6, maximum=1e6),
    Row("blow", "PARAMETER"),
    *(Row(name, "OUTPUT", "CALCULATED") for name in ("energy", "wave", "log")),
)
BARE = (
    Row("time", "TIME"),
    Row("x", "STATE", start=1.0),
    Row("x_dot", "DERIVATIVE", "CALCULATED"),
)


@dataclass(frozen=True)
class Equations:
    """dx/dt, residual and outputs over (t, x, z, u, p), and the residual of calculated starts."""

    t: SX
    x: SX
    z: SX
    u: SX
    p: SX
    ode: SX
    alg: SX
    y: SX
    start: SX
    calculated: int | None
    margins: SX


def toy() -> Equations:
    """Return the DAE above."""
    t, x, z, u, p = _symbols(4, 2, 2, 5)
    q, v, w, s = ca.vertsplit(x)
    a, r = ca.vertsplit(z)
    force, push = ca.vertsplit(u)
    mass, stiffness, damping, load, blow = ca.vertsplit(p)
    ode = ca.vertcat(v, a, -w * ca.sqrt(q + 10), blow * s**2)
    alg = ca.vertcat(mass * a + damping * v + stiffness * q - force - 0.1 * r, r - 2 * a - w)
    energy = mass * v**2 / 2 + stiffness * q**2 / 2
    y = ca.vertcat(energy, q * ca.sin(3 * t) + push, ca.log(q + 5))
    start = w + w**2 - load - push * t
    return Equations(t, x, z, u, p, ode, alg, y, start, calculated=2, margins=2 - q)


def bare() -> Equations:
    """Return x' = -x, with nothing else: arrays of length 0 everywhere."""
    t, x, z, u, p = _symbols(1, 0, 0, 0)
    nothing = SX(0, 1)
    return Equations(t, x, z, u, p, -x, nothing, nothing, nothing, calculated=None, margins=nothing)


def write(
    folder: Path,
    model: Equations,
    table: Sequence[Row],
    solver: str = "step",
    *,
    valid: bool = False,
    rank: bool = False,
    most_steps: int = 1000,
) -> None:
    """Write the generated files for the solver of `integration_SOLVER.c`, and what that needs.

    With `rank`, constraints are watched that lose rank where x_1 = 0. With `valid`, the model tells
    whether it holds, and its margins are its last outputs.
    The generated solver takes up to `most_steps` in an attempt, dop853 tries 20 times as many.
    """
    if valid:
        table = (*table, Row("margin", "OUTPUT", "CALCULATED"))
        model = replace(model, y=ca.vertcat(model.y, model.margins))
    counts = {role: sum(row.role == role for row in table) for role in ROLES}
    header = [
        '#define MODEL_IDENTIFIER "toy"',
        '#define MODEL_NAME "toy"',
        "#define MODEL_PREFIX toy_",
        f'#define MODEL_GUID "{GUID}"',
        "#define DEFAULT_TOLERANCE 1e-8",
        "#define HAS_ADJOINT 1",
        f"#define HAS_RANK {int(rank)}",
        "#define LEAST_RANK 1e-3",
        f"#define SOLVER_DOP853 {int(solver == 'dop853')}",
        "#define LARGEST_STEP 0.5",
        f"#define MOST_TRIALS {20 * most_steps}",
        f"#define N_LIMITS {model.margins.numel()}",
        f"#define HAS_VALID {int(valid)}",
        *(f"#define {macro} {counts[role]}" for role, macro in ROLES.items()),
        f"#define NC {2 * counts['PARAMETER']}",
    ]
    functions = [*_contract(model, most_steps), *_rank_functions(model)[: 3 * rank]]
    for kind in ("arg", "res", "iw", "w"):
        most = max(getattr(function, f"sz_{kind}")() for function in functions)
        header.append(f"#define WORK_{kind.upper()} {most}")
    (folder / "model.h").write_text("\n".join(header) + "\n")
    (folder / "dop853_coefficients.h").write_text(dop853_coefficients())
    generator = ca.CodeGenerator("equations.c")
    for function in functions:
        generator.add(function)
    generator.generate(f"{folder}/")
    code = (folder / "equations.c").read_text()
    # the integrator's tolerances are constants: let its third parameter take their place
    for name, factor in (("reltol", "1"), ("abstol", "0.1")):
        code = re.sub(rf"p\.{name} = [^;]*;", f"p.{name} = {factor}*arg[2][2];", code)
    rows = ",\n".join(
        f'    {{"{r.name}", {r.role}, {r.kind}, '
        + ", ".join(map(_number, (r.start, r.nominal, r.minimum, r.maximum, r.start)))
        + f", {str(r.tunable).lower()}, false}}"
        for r in table
    )
    (folder / "equations.c").write_text(f'#include "generated.h"\n{code}')
    (folder / "tables.h").write_text(
        f"#include <math.h>\nstatic const VariableInfo variables[] = {{\n{rows}\n}};\n"
        'static const char *const limits[] = {"q < 2 m", 0};\n'
        'static const char *const violations[] = {"not fulfilled: q < 2 m", 0};\n'
    )


ROLES = {"STATE": "NX", "ALGEBRAIC": "NZ", "INPUT": "NU", "PARAMETER": "NP", "OUTPUT": "NY"}


def _number(value: float) -> str:
    return repr(value) if abs(value) != inf else "-INFINITY" if value < 0 else "INFINITY"


def _symbols(nx: int, nz: int, nu: int, np: int) -> tuple[SX, SX, SX, SX, SX]:
    sizes = {"x": nx, "z": nz, "u": nu, "p": np}
    x, z, u, p = (SX.sym(name, size) for name, size in sizes.items())
    return SX.sym("t"), x, z, u, p


def _constants(m: Equations) -> tuple[Equations, SX]:
    """Return the equations with a copy of the parameters in their place, and both as constants."""
    copies = SX.sym("copy", m.p.numel())
    laws = {name: ca.substitute(getattr(m, name), m.p, copies) for name in ("ode", "alg", "y")}
    return replace(m, **laws), ca.vertcat(m.p, copies)


def _contract(m: Equations, most_steps: int) -> list[ca.Function]:
    known = [m.t, m.x, m.z, m.u, m.p]
    of_constants, c = _constants(m)
    known_constants = [*known[:-1], c]
    solved = m.z
    if m.z.numel():
        constant = ca.substitute(m.alg, m.z, SX.zeros(m.z.shape))
        solved = -ca.solve(ca.jacobian(m.alg, m.z), constant)
    ode, y = ca.substitute([m.ode, m.y], [m.z], [solved])

    inputs = ca.vertcat(m.x, m.u, m.p, m.t)
    outputs = [ode, solved, y]
    along = [SX.sym(f"seed_{n}", k.numel()) for n, k in zip("xupt", (m.x, m.u, m.p, m.t), strict=1)]
    weights = [SX.sym(f"weight_{n}", k.numel()) for n, k in zip("xzy", outputs, strict=True)]
    forward = [ca.jtimes(k, inputs, ca.vertcat(*along)) for k in outputs]
    backward = ca.jtimes(ca.vertcat(*outputs), inputs, ca.vertcat(*weights), True)
    sizes = [0, *(int(n) for n in _cumulated(m.x, m.u, m.p, m.t))]
    solved_with = ca.substitute(solved, m.p, c[m.p.numel() :])
    return [
        ca.Function("model_constants", [m.p], [ca.vertcat(m.p, m.p)]),
        *_start_functions(m),
        ca.Function("model_algebraic", known_constants, [solved_with]),
        ca.Function("model_ode", known_constants, [of_constants.ode]),
        ca.Function("model_outputs", known_constants, [of_constants.y, m.margins]),
        ca.Function("model_directional", [*known, *along], forward),
        ca.Function("model_adjoint", [*known, *weights], ca.vertsplit(backward, sizes)),
        ca.Function("model_jacobian", known, [_dense(ode, m), _dense(solved, m)]),
        _step_function(of_constants, c, most_steps),
    ]


def _rank_functions(m: Equations) -> list[ca.Function]:
    known, distance = [m.t, m.x, m.z, m.u, m.p], ca.fabs(m.x[0])
    return [
        ca.Function("model_rank", known, [distance]),
        ca.Function("model_rank_rate", known, [ca.jtimes(distance, m.x, m.ode)]),
        ca.Function("model_project", [m.t, m.x, m.u, m.p], [m.x, 0]),
    ]


def _dense(results: SX, m: Equations) -> SX:
    return ca.densify(ca.jacobian(results, ca.vertcat(m.x, m.u)))


def _cumulated(*columns: SX) -> list[int]:
    total, sums = 0, []
    for column in columns:
        total += column.numel()
        sums.append(total)
    return sums


def _start_functions(m: Equations) -> list[ca.Function]:
    known = [MX.sym("known", k.numel()) for k in (m.t, m.x, m.u, m.p)]
    t, guess, u, p = known
    x, defect = guess, MX(0)
    if m.calculated is not None:
        unknown, given = m.x[m.calculated], ca.vertcat(m.t, m.u, m.p)
        solve = ca.rootfinder(
            "solve", "fast_newton", {"x": unknown, "p": given, "g": m.start},
            {"linear_solver": "qr", "abstol": 1e-13},
        )  # fmt: skip
        root = solve(guess[m.calculated], ca.vertcat(t, u, p))
        x = ca.vertcat(guess[: m.calculated], root, guess[m.calculated + 1 :])
        residual = ca.Function("g", [unknown, given], [m.start])
        defect = ca.fabs(residual(root, ca.vertcat(t, u, p)))
    moved = (guess, u, p, t)
    seeds = [MX.sym("seed", k.numel()) for k in moved]
    forward = ca.jtimes(x, ca.vertcat(*moved), ca.vertcat(*seeds))
    return [
        ca.Function("model_start", known, [x, defect]),
        ca.Function("model_start_directional", [*known, *seeds], [forward]),
    ]


def _step_function(m: Equations, constants: SX, most_steps: int) -> ca.Function:
    """Integrate over s in [0, 1]; q = (t, h, tolerance, u0, u1, u2, u3, c)."""
    nu, s, q = m.u.numel(), SX.sym("s"), SX.sym("q", 3 + 4 * m.u.numel() + constants.numel())
    t, h, c = q[0], q[1], q[3 + 4 * nu :]
    u0, u1, u2, u3 = (q[3 + k * nu : 3 + (k + 1) * nu] for k in range(4))
    u = u0 + s * (u1 + s * (u2 + s * u3))
    ode, alg = ca.substitute(
        [m.ode, m.alg], [m.t, m.u, constants], [t + s * h, u, c]
    )  # fmt: skip
    problem = {"t": s, "x": m.x, "z": m.z, "p": q, "ode": h * ode, "alg": alg}
    method = "rosenbrock" if m.z.numel() else "erk"
    integrate = ca.integrator("integrate", method, problem, 0, 1, {"max_num_steps": most_steps})
    x, z, parameters = MX.sym("x", m.x.numel()), MX.sym("z", m.z.numel()), MX.sym("q", q.numel())
    end = integrate(x0=x, z0=z, p=parameters)
    return ca.Function("model_step", [x, z, parameters], [end["xf"], end["zf"]])
