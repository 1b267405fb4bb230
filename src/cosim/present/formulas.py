"""Equations of a model as formulas (MathML), with names for expressions that occur repeatedly."""

import html
import re
import unicodedata
from collections import Counter
from collections.abc import Iterable

import casadi as ca
from casadi import SX

from casadi_models.dae import Dae

MOST_FORMULAS = 100  # of a model; more of them are not read
_OPERATIONS = {getattr(ca, n): n[3:].lower() for n in dir(ca) if n.startswith("OP_")}
_TIMES = '<mo>\u2062</mo><mspace width=".17em"/>'
_INFIX = {"add": ("<mo>+</mo>", 1), "sub": ("<mo>-</mo>", 1), "mul": (_TIMES, 2)}
_INFIX |= {"lt": ("<mo>&lt;</mo>", 0), "le": ("<mo>≤</mo>", 0), "eq": ("<mo>=</mo>", 0)}
_INFIX |= {"ne": ("<mo>≠</mo>", 0), "and": ("<mo>∧</mo>", 0), "or": ("<mo>\u2228</mo>", 0)}
_ATOM = 9  # precedence of what needs no parentheses


def formulas(dae: Dae) -> list[str]:
    """Return the differential and algebraic equations; empty if they are too many to be read."""
    rows = [*ca.vertsplit(dae.ode), *ca.vertsplit(dae.alg)]
    writer = _Writer(rows)
    left = [*(_derivative(state.name) for state in dae.states)]
    left += ["<mn>0</mn>"] * len(dae.algebraics)
    found = [_equation(name, writer.text(row)) for name, row in zip(left, rows, strict=True)]
    lines = [_equation(name, text) for name, text in writer.named.values()]
    return [*lines, *found] if len(lines) + len(found) <= MOST_FORMULAS else []


def _equation(left: str, right: str) -> str:
    return f'<math display="block"><mrow>{left}<mo>=</mo>{right}</mrow></math>'


def _derivative(name: str) -> str:
    return f"<mfrac><mrow><mi>d</mi>{symbol(name)}</mrow><mrow><mi>d</mi><mi>t</mi></mrow></mfrac>"


def symbol(name: str) -> str:
    """Return a variable's name as letters with index and dot: theta1_dot is one of Greek."""
    plain, dots = re.subn("(_dot)+$", "", name)
    parts = re.fullmatch(r"([A-Za-z]+?)_?(\d.*|_.*)?", plain)
    head, index = (parts[1], (parts[2] or "").strip("_")) if parts else (plain, "")
    text = f"<mi>{html.escape(_letter(head))}</mi>"
    text = f"<mover>{text}<mo>˙</mo></mover>" if dots else text
    return f"<msub>{text}<mi>{html.escape(index)}</mi></msub>" if index else text


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
        named: Name and formula of each part that occurs more than once, by its hash, in an order
            in which they can be computed.
    """

    def __init__(self, rows: Iterable[SX]) -> None:
        self.named = dict[int, tuple[str, str]]()
        self.uses, self.known = Counter[int](), list[SX]()
        for row in rows:
            self._count(row)

    def _count(self, node: SX) -> None:
        key = node.element_hash()
        self.uses[key] += 1
        if self.uses[key] == 1:
            self.known.append(node)  # a hash is that of a living node
            for k in range(node.n_dep()):
                self._count(node.dep(k))

    def text(self, node: SX, around: int = 0) -> str:
        """Return the formula of a node, in parentheses if what is around it binds more tightly."""
        key = node.element_hash()
        if key in self.named:
            return self.named[key][0]
        text, binds = self._formula(node)
        if self.uses[key] > 1 and node.n_dep() and _name(node) not in ("neg", "sq", "twice"):
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
            return f"<mn>{value:.6g}</mn>", _ATOM if value >= 0 else 1
        name, parts = _name(node), [node.dep(k) for k in range(node.n_dep())]
        if name in _INFIX:
            sign, level = _INFIX[name]
            first, last = self.text(parts[0], level), self.text(parts[1], level + (name == "sub"))
            return f"{first}{sign}{last}", level
        if name == "div":
            return f"<mfrac>{self.text(parts[0])}{self.text(parts[1])}</mfrac>", _ATOM
        if name == "inv":
            return f"<mfrac><mn>1</mn>{self.text(parts[0])}</mfrac>", _ATOM
        if name == "sqrt":
            return f"<msqrt>{self.text(parts[0])}</msqrt>", _ATOM
        if name in ("sq", "pow", "constpow"):
            power = "<mn>2</mn>" if name == "sq" else self.text(parts[1])
            return f"<msup>{self.text(parts[0], _ATOM)}{power}</msup>", 8
        if name == "neg":
            return f"<mo>-</mo>{self.text(parts[0], 2)}", 1
        if name == "twice":
            return f"<mn>2</mn>{_TIMES}{self.text(parts[0], 2)}", 2
        inside = "<mo>,</mo>".join(map(self.text, parts))
        return f"<mi>{name}</mi><mo>(</mo>{inside}<mo>)</mo>", _ATOM


def _name(node: SX) -> str:
    return _OPERATIONS.get(node.op(), "f")
