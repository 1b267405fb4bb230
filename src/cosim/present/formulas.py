"""Equations of a model as formulas (MathML), with names for expressions that occur repeatedly."""

import html
import re
import unicodedata
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from casadi import SX

from casadi_models.dae import Dae
from casadi_models.dae.expressions import operation_count
from cosim.arrays import Vector
from cosim.study.linearize.linearization import Linearization

MOST_FORMULAS = 100  # lines that are printed in full, unless they are short
_LARGEST = 300  # operations of an equation that is printed in full
_WIDEST = 24  # names and numbers of a part of a line
_DIGITS = 4  # of numbers that were computed
_ROUNDING, _ZERO_RATE = 1e-9, 1e-12  # parts of a sum that are left out: of it, in nominal values
_OPERATIONS = {getattr(ca, n): n[3:].lower() for n in dir(ca) if n.startswith("OP_")}
_THIN = '<mspace width=".17em"/>'
_TIMES = f"<mo>\u2062</mo>{_THIN}"
_EQUAL, _MINUS, _ZERO = "<mo>=</mo>", "<mo>\u2212</mo>", "<mn>0</mn>"
_INFIX = {"add": ("<mo>+</mo>", 1), "sub": (_MINUS, 1), "mul": (_TIMES, 2)}
_INFIX |= {"lt": ("<mo>&lt;</mo>", 0), "le": ("<mo>≤</mo>", 0), "eq": (_EQUAL, 0)}
_INFIX |= {"ne": ("<mo>≠</mo>", 0), "and": ("<mo>∧</mo>", 0), "or": ("<mo>\u2228</mo>", 0)}
_INDENT = '<mspace width="2em"/>'
_BECOMES = "<mo>\u2190</mo>"
_ATOM = 9  # precedence of what needs no parentheses


@dataclass(frozen=True)
class Formulas:
    """Equations of a model as MathML.

    Attributes:
        equations: Differential and algebraic equations.
        outputs: Outputs and validity conditions.
        events: What happens, line by line: name and condition, and new values of states.
        named: Meanings of the names c_i.
        large: Names of the states and outputs whose equations are too large to be printed.
    """

    equations: tuple[str, ...]
    outputs: tuple[str, ...]
    events: tuple[str, ...]
    named: tuple[str, ...]
    large: tuple[str, ...]


@dataclass(frozen=True, eq=False)  # CasADi's == builds an expression
class _Row:
    """An equation: left side with sign, expression, and the name of its state or output."""

    left: str
    right: SX
    name: str = ""


def formulas(dae: Dae) -> Formulas:
    """Return the equations, the outputs, the validity conditions, 0 < margin, and the events.

    The smallest ones are printed in full, in about 100 lines. For a larger one, the formula
    shows its arguments and its number of operations.
    """
    outputs = [*zip(dae.output_variables, ca.vertsplit(dae.outputs), strict=True)]
    known = {value.element_hash(): v.name for v, value in outputs if value.n_dep()}
    rates = zip(dae.states, ca.vertsplit(dae.ode), strict=True)
    rows = [_Row(_derivative(v.name) + _EQUAL, rate, v.name) for v, rate in rates]
    rows += [_Row(_ZERO + _EQUAL, residual) for residual in ca.vertsplit(dae.alg)]
    equations = len(rows)
    rows += [_Row(symbol(v.name) + _EQUAL, value, v.name) for v, value in outputs]
    rows += [_Row(f"{_ZERO}<mo>&lt;</mo>", margin) for margin, _ in dae.limits]
    continuous = len(rows)
    for event in dae.events:
        rows.append(_Row(f"<mtext>{html.escape(event.name)}:\u2003</mtext>", event.condition))
        new = zip(event.states, ca.vertsplit(event.values), strict=True)
        rows += [_Row(_INDENT + symbol(dae.states[i].name) + _BECOMES, value) for i, value in new]
    readable = _readable(rows, equations, known)
    writer = _Writer([rows[i].right for i in readable], known)
    lines, large = list[str](), list[str]()
    for i, row in enumerate(rows):
        if i in readable:
            lines.append(_line(row.left + writer.whole(row.right, row.name)))
        else:
            large.append(row.name)
            lines.append(_line(row.left + _function(dae, row.right, len(large))))
    named = [_line(name + _EQUAL + text) for name, text in writer.named.values()]
    names = tuple(filter(None, large))
    return Formulas(
        tuple(lines[:equations]),
        tuple(lines[equations:continuous]),
        tuple(lines[continuous:]),
        tuple(named),
        names,
    )


def linear_formulas(dae: Dae, linear: Linearization, names: Collection[str]) -> list[str]:
    """Return linear equations with numbers, in SI units; terms that are mere rounding are left out.

    Args:
        dae: The model.
        linear: Its linear system x' = A x + B u, y = C x + D u.
        names: The states and outputs whose equations are returned.
    """
    nominal = {v.name: v.nominal for v in dae.variables}
    knowns = [*linear.states, *linear.inputs]
    sizes = np.array([1.0, *(nominal[name] for name in knowns)])
    rows = np.vstack([np.hstack([linear.rates[:, None], linear.A, linear.B]),
                      np.hstack([linear.y[:, None], linear.C, linear.D])])  # fmt: skip
    left = [_derivative(name) for name in linear.states] + [*map(symbol, linear.outputs)]
    found = []
    for name, text, row in zip((*linear.states, *linear.outputs), left, rows, strict=True):
        if name in names:
            parts = np.abs(row) * sizes  # of the sum, where variables deviate by nominal values
            noise = max(_ROUNDING * parts.max(), _ZERO_RATE * nominal[name])
            found.append(_line(text + _EQUAL + _sum(np.where(parts > noise, row, 0.0), knowns)))
    return found


def _sum(factors: Vector, names: Sequence[str]) -> str:
    """Return the sum of a value and of deviations, whose factors follow that value."""
    text = ""
    for factor, name in zip(factors, ("", *names), strict=True):
        if factor:
            variable = f"{_TIMES}<mo>Δ</mo>{symbol(name)}" if name else ""
            sign = _MINUS if factor < 0 else "<mo>+</mo>" * bool(text)
            text += sign + _number(abs(factor), _DIGITS) + variable
    return text or _ZERO


def _readable(rows: Sequence[_Row], equations: int, known: Mapping[int, str]) -> list[int]:
    """Return the positions of the rows that are printed in full, equations before outputs."""
    sizes = [_operations(row.right, known) for row in rows]
    chosen = list[int]()
    for group in (range(equations), range(equations, len(rows))):
        for i in sorted(group, key=sizes.__getitem__):
            if sizes[i] > _LARGEST:
                break
            trial = [*chosen, i]
            if sizes[i] > _WIDEST and _lines([rows[k] for k in trial], known) > MOST_FORMULAS:
                break
            chosen = trial
    return chosen


def _lines(rows: Sequence[_Row], known: Mapping[int, str]) -> int:
    """Return the number of lines of some equations, with those of their parts."""
    writer = _Writer([row.right for row in rows], known)
    for row in rows:
        writer.whole(row.right, row.name)
    return len(rows) + len(writer.named)


def _operations(expression: SX, known: Mapping[int, str]) -> int:
    """Return the number of operations behind known expressions; more than `_LARGEST` as one more.

    An expression may be deeper than Python's recursion is.
    """
    left, seen, count = [expression], set[int](), 0
    while left and count <= _LARGEST:
        node = left.pop()
        key = node.element_hash()
        if key in seen or (key in known and node is not expression):
            continue
        seen.add(key)
        count += bool(node.n_dep())
        left += [node.dep(k) for k in range(node.n_dep())]
    return count


def _function(dae: Dae, expression: SX, number: int) -> str:
    """Return the formula of a function of an expression's variables, with its size."""
    symbols = ca.symvar(expression)
    count = operation_count(ca.Function("row", symbols, [expression]))
    used = {variable.name() for variable in symbols}
    knowns = [v.name for v in (*dae.states, *dae.algebraics, *dae.inputs) if v.name in used]
    arguments = [symbol(name) for name in knowns] + ["<mi>t</mi>"] * (dae.t.name() in used)
    inside = "<mo>,</mo>".join(arguments)
    if any(v.name in used for v in dae.parameters):
        inside += "<mo>;</mo><mi>p</mi>"
    size = f"<mtext>\u2003({count} operations)</mtext>"
    return f"{symbol(f'f_{number}')}<mo>(</mo>{inside}<mo>)</mo>{size}"


def _line(text: str) -> str:
    return f'<math display="block"><mrow>{text}</mrow></math>'


def _number(value: float, digits: int) -> str:
    mantissa, _, exponent = f"{value:.{digits}g}".partition("e")
    text = f"<mn>{mantissa}</mn>"
    if exponent:
        power = f"<msup><mn>10</mn><mn>{int(exponent)}</mn></msup>"
        text = f"<mrow>{text}<mo>·</mo>{power}</mrow>"
    return text.replace("-", "\u2212")


def _derivative(name: str) -> str:
    change = f"<mrow><mi>d</mi>{_THIN}{symbol(name)}</mrow>"
    return f"<mfrac>{change}<mrow><mi>d</mi><mi>t</mi></mrow></mfrac>"


def symbol(name: str) -> str:
    """Return a variable's name as letters with index and dot: theta1_dot is one of Greek."""
    plain, dots = re.subn("(_dot)+$", "", name)
    parts = re.fullmatch(r"([A-Za-z]+?)_?(\d.*|_.*|(?<=[a-z])[A-Z])?", plain)
    head, index = (parts[1], (parts[2] or "").strip("_")) if parts else (plain, "")
    if not index[:1].isdigit() and len(_letter(head)) > (2 if "_" in plain else 1):
        head, index = plain, ""  # words, such as arm_mass, and mA
    text = f"<mi>{html.escape(_letter(head))}</mi>"
    text = f"<mover>{text}<mo>˙</mo></mover>" if dots else text
    shown = html.escape(",".join(map(_letter, index.split("_"))))
    return f"<msub>{text}<mi>{shown}</mi></msub>" if index else text


def _letter(name: str) -> str:
    """Return the Greek letter of a name, or the name."""
    size, plain = "CAPITAL" if name[:1].isupper() else "SMALL", name.upper()
    try:
        return unicodedata.lookup(f"GREEK {size} LETTER {plain.replace('LAMBDA', 'LAMDA')}")
    except KeyError:
        return name


class _Writer:
    """Formulas of expressions that share parts.

    Attributes:
        known: Names of expressions by their hashes, such as outputs.
        named: Name and formula of each part that occurs more than once or is too wide for a line,
            by its hash, in an order in which they can be computed.
    """

    def __init__(self, rows: Iterable[SX], known: Mapping[int, str]) -> None:
        self.known, self.named = known, dict[int, tuple[str, str]]()
        self.uses, self.living = Counter[int](), list[SX]()
        for row in rows:
            self._count(row)

    def _count(self, node: SX) -> None:
        key = node.element_hash()
        self.uses[key] += 1
        if self.uses[key] == 1:
            self.living.append(node)  # a hash is that of a living node
            for k in range(node.n_dep()):
                if node.dep(k).element_hash() not in self.known:
                    self._count(node.dep(k))

    def whole(self, node: SX, name: str) -> str:
        """Return the formula of the expression that has a name itself."""
        own = self.known.get(node.element_hash(), name) == name
        return self._formula(node)[0] if own else self.text(node)

    def text(self, node: SX, around: int = 0) -> str:
        """Return the formula of a node, in parentheses if what is around it binds more tightly."""
        key = node.element_hash()
        if key in self.known:
            return symbol(self.known[key])
        if key in self.named:
            return self.named[key][0]
        text, binds = self._formula(node)
        shared = self.uses[key] > 1 and _name(node) not in ("neg", "sq", "twice")
        if node.n_dep() and (shared or text.count("<mi>") + text.count("<mn>") > _WIDEST):
            name = symbol(f"c_{len(self.named) + 1}")
            self.named[key] = (name, f"<mrow>{text}</mrow>")
            return name
        row = f"<mrow>{text}</mrow>"
        return f"<mrow><mo>(</mo>{row}<mo>)</mo></mrow>" if binds < around else row

    def _formula(self, node: SX) -> tuple[str, int]:
        if node.is_symbolic():
            return symbol(node.name()), _ATOM
        if node.is_constant():
            value = float(node)
            return _number(value, 6), _ATOM if value >= 0 else 1
        name, parts = _name(node), [node.dep(k) for k in range(node.n_dep())]
        if name in _INFIX:
            sign, level = _INFIX[name]
            around = level or 1  # comparisons and "and" or "or" within each other are ambiguous
            first, last = self.text(parts[0], around), self.text(parts[1], around + (name == "sub"))
            return f"{first}{sign}{last}", level
        if name == "div":
            return f"<mfrac>{self.text(parts[0])}{self.text(parts[1])}</mfrac>", 8
        if name == "inv":
            return f"<mfrac><mn>1</mn>{self.text(parts[0])}</mfrac>", 8
        if name == "sqrt":
            return f"<msqrt>{self.text(parts[0])}</msqrt>", _ATOM
        if name in ("sq", "pow", "constpow"):
            power = "<mn>2</mn>" if name == "sq" else self.text(parts[1])
            return f"<msup>{self.text(parts[0], _ATOM)}{power}</msup>", 8
        if name == "neg":
            return f"{_MINUS}{self.text(parts[0], 2)}", 1
        if name == "twice":
            return f"<mn>2</mn>{_TIMES}{self.text(parts[0], 2)}", 2
        inside = "<mo>,</mo>".join(map(self.text, parts))
        return f"<mi>{name}</mi><mo>(</mo>{inside}<mo>)</mo>", _ATOM


def _name(node: SX) -> str:
    return _OPERATIONS.get(node.op(), "f")
