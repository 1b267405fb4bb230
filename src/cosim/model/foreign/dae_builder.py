"""Import of models of CasADi's `DaeBuilder` as a `Dae`."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any

import casadi as ca
from casadi import MX, SX

from casadi_models.dae import Dae, Model
from casadi_models.units import known as known_unit
from cosim.errors import UsageError
from cosim.model.foreign.casadi_system import System, evaluated
from cosim.model.foreign.from_casadi import declare_jump
from cosim.model.foreign.named_symbols import Symbol, identifier

_DEPTH = 1000  # of definitions that use definitions


def from_dae_builder(builder: ca.DaeBuilder) -> Dae:
    """Return the DAE of a `casadi.DaeBuilder`.

    Parameters of every variability and integer ones are parameters, constants are numbers,
    quadratures are states, dependent variables are outputs, `set_init` gives calculated starts, and
    the rate of a state that only equations determine is an algebraic unknown. Start values, units,
    display units, bounds, nominal values and descriptions are those of the builder; a variable
    without unit is a number, an unknown unit has the factor 1, and the default of a description is
    the name.
    `body.x` and `v[1]` are called `body_x` and `v_1`.

    Raises:
        UsageError: The builder holds events or discrete states, something is not determined, or
            its expressions cannot be written out in scalar operations.

    Example:
        >>> import casadi as ca
        >>> builder = ca.DaeBuilder("decay")
        >>> x = builder.add("x")
        >>> builder.set_start("x", 1.0)
        >>> builder.eq(builder.der(x), -x)
        >>> from_dae_builder(builder).states[0].name
        'x'
    """
    UsageError.reject("from_dae_builder", builder, ca.DaeBuilder, "a casadi.DaeBuilder")
    who = f"DaeBuilder {builder.name()}"
    if not builder.symbolic():
        raise UsageError(
            f"{who}: it holds an FMU, whose equations lie in its library; run that by simulate_fmu"
        )
    try:
        return _converted(_Builder(builder, who))
    except ValueError as error:  # begins with the name
        raise UsageError(f"DaeBuilder {error}") from error
    except RuntimeError as error:
        raise UsageError(f"{who}: {' '.join(str(error).split())}") from error


@dataclass(frozen=True)
class _Builder:
    """Variables and equations that are read from a builder."""

    own: ca.DaeBuilder
    who: str

    def states(self) -> dict[str, MX]:
        """Return each state that is integrated, and its rate."""
        rates = dict(zip(self.own.x(), self.own.ode(), strict=True))
        rates |= dict(zip(self.own.q(), self.own.quad(), strict=True)) if self.own.nq() else {}
        for name in self.own.z():  # states whose rates stand in equations only
            if f"der({name})" in self.own.z():
                rates[name] = self.own.var(f"der({name})")
        for name in rates:
            if self.own.variability(name) != "continuous":
                raise UsageError(f"{self.who}: '{name}' is a discrete state, which has no export")
        return rates

    def definitions(self) -> dict[str, MX]:
        """Return what dependent variables and calculated parameters are."""
        found = dict(zip(self.own.w(), self.own.wdef(), strict=True)) if self.own.nw() else {}
        for name in self.own.d():
            if not self.own.has(f"__assign__{name}__"):
                raise UsageError(f"{self.who}: '{name}' has no definition; give it one by assign()")
            found[name] = self.own.var(f"__assign__{name}__")
        return found

    def names(self) -> list[str]:
        """Return what stands for itself in equations, states first."""
        own = self.own
        every = [*self.states(), *own.z(), *own.u(), *own.p(), *own.c()]
        return list(dict.fromkeys(every))

    def kind(self, name: str) -> str:
        """Return x, z, u or p; "" for a constant."""
        if name in self.states():
            return "x"
        if name in self.own.z():
            return "z"
        if name in self.own.u():
            return "u"
        return "" if self.own.variability(name) == "constant" else "p"

    def numbers(self, name: str, values: Any) -> list[float]:
        """Return an attribute of every entry of a variable."""
        size = self.own.numel(name)
        found = [float(v) for v in values] if isinstance(values, list) else [float(values)]
        return found if len(found) == size else found[:1] * size

    def facts(self, name: str, entry: int) -> dict[str, Any]:
        """Return unit, meaning, bounds and sizes of an entry of a variable."""
        own = self.own
        unit, shown = own.unit(name) or "1", own.display_unit(name)
        size = own.numel(name)
        meaning = own.description(name) or name
        if size > 1:
            meaning = f"{meaning}, entry {entry + 1}"
        facts: dict[str, Any] = {
            "unit": unit,
            "minimum": self.numbers(name, own.min(name))[entry],
            "maximum": self.numbers(name, own.max(name))[entry],
            "nominal": self.numbers(name, own.nominal(name))[entry],
        }
        if not known_unit(unit):
            facts["foreign_unit"] = True
            meaning = f"{meaning} (unit '{unit}' is unknown here: factor 1)"
        elif shown and known_unit(shown):
            facts["display_unit"] = shown
        return facts | {"meaning": meaning}

    def declare(self, declare: Callable[..., Any], name: str, values: Sequence[Any]) -> list[Any]:
        """Declare every entry of a variable by a method of `Model`, with its start or law."""
        return [
            declare(entry, facts.pop("unit"), value, facts.pop("meaning"), **facts)
            for i, (entry, value) in enumerate(zip(self.entries(name), values, strict=True))
            for facts in [self.facts(name, i)]
        ]

    def entries(self, name: str) -> tuple[str, ...]:
        """Return the name of every entry of a variable."""
        shape, size = self.own.dimension(name), self.own.numel(name)
        if len(shape) == 2 and size > 1:
            base, (rows, columns) = identifier(name), shape
            return tuple(f"{base}_{i + 1}_{j + 1}" for i in range(rows) for j in range(columns))
        return Symbol(name, (size, 1), MX(0, 1)).entries


def _converted(builder: _Builder) -> Dae:
    own = builder.own
    stop = own.stop_time()
    model = Model(
        own.name(),
        description=f"{own.name()}, built with casadi.DaeBuilder",
        source="casadi.DaeBuilder",
        stop_time=stop if isfinite(stop) and stop > 0 else 10.0,
    )
    rates = builder.states()
    names = builder.names()
    declared = {name: _declared_variable(builder, model, name) for name in names}
    used = {name for name in names if builder.kind(name)}
    every = dict.fromkeys((*own.y(), *own.w(), *own.d()))
    # not rates and helpers of CasADi, which are not their author's
    shown = [n for n in every if n not in used and not n.startswith(("der(", "__"))]
    definitions = builder.definitions()
    outputs = {name: definitions.get(name, own.var(name)) for name in shown}
    init = {s.name(): law for s, law in zip(own.init_lhs(), own.init_rhs(), strict=True)}
    laws = {f"rate of {name}": rate for name, rate in rates.items()}
    laws |= {f"equation {i}": law for i, law in enumerate(own.alg(), start=1)}
    laws |= {f"start of {name}": law for name, law in init.items()}
    given: list[Any] = [own.time() if own.has_t() else MX(0, 1)]
    given += [ca.veccat(*map(own.var, kind)) for kind in (own.x(), own.z(), own.p(), own.u())]
    for i, zero in enumerate(own.zero() if own.nzero() else []):
        laws[f"zero {i}"] = zero
        laws[f"jump {i}"], *_ = own.transition("transition").call([i, *given])
    results = _in_the_models_symbols(builder, model, declared, definitions, laws | outputs)

    for name in rates:
        model.derivative(declared[name], results[f"rate of {name}"])
    for i in range(len(own.alg())):
        model.equation(results[f"equation {i + 1}"])
    x = ca.vertcat(SX(0, 1), *(declared[name] for name in own.x()))
    for i in range(own.nzero()):
        declare_jump(model, results[f"zero {i}"], x, results[f"jump {i}"], f"event {i + 1}")
    for name in shown:
        builder.declare(model.output, name, ca.vertsplit(results[name]))
    for name in init:
        if name not in rates:
            raise UsageError(
                f"{builder.who}: set_init of '{name}', which is no state; use set_start for it"
            )
        model.start(declared[name], results[f"start of {name}"], f"set_init of {name}")
    return model.freeze()


def _declared_variable(builder: _Builder, model: Model, name: str) -> SX:
    kind = builder.kind(name)
    starts = builder.numbers(name, builder.own.start(name))
    if not kind:
        return SX(starts)
    declare = {"x": model.state, "z": model.algebraic, "u": model.input, "p": model.parameter}[kind]
    column: SX = ca.vertcat(*builder.declare(declare, name, starts))
    return column


def _in_the_models_symbols(
    builder: _Builder,
    model: Model,
    declared: Mapping[str, SX],
    definitions: Mapping[str, MX],
    laws: Mapping[str, MX],
) -> dict[str, SX]:
    own = builder.own
    rows = [*laws.values()]
    symbols = [own.var(name) for name in definitions]
    for _ in range(_DEPTH):
        if not symbols or not ca.depends_on(ca.veccat(*rows), ca.veccat(*symbols)):
            break
        rows = ca.substitute(rows, symbols, [*definitions.values()])
    else:
        raise UsageError(f"{builder.who}: dependent variables define each other in a circle")
    system = System(
        {
            "t": (Symbol("t", (1, 1), own.time()),) if own.has_t() else (),
            # an array has its entries in the order of FMI, row by row
            "x": tuple(Symbol(name, (own.numel(name), 1), own.var(name)) for name in declared),
            **dict.fromkeys("zup", ()),
        },
        {},
    )
    values = {"t": model.t, "x": ca.vertcat(SX(0, 1), *declared.values())}
    values |= dict.fromkeys("zup", SX(0, 1))
    return evaluated(builder.who, system, values, dict(zip(laws, rows, strict=True)))
