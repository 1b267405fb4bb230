"""Names as the FMI's structured convention has them: components of a vector become an array.

    fx_A, fy_A, fz_A    A.f[1], A.f[2], A.f[3]      along the axes x, y, z
    f1_G_F, f2_G_F      G.f_F[1], G.f_F[2]          resolved in frame F
    x_tip, y_tip        tip.r[1], tip.r[2]          a place
    q1_w ... q1_z       q1[1] ... q1[4]
    slip_1, slip_2      slip[1], slip[2]

Only what is whole, of one kind and of one unit becomes an array; everything else keeps its name.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

from cosim.fmi.export.variables import FmuVariable, Role

_SUFFIX = re.compile(r"(?P<stem>[A-Za-z]+\d*)_(?P<axis>[wxyz])(?P<rest>\d*(?:_dot)*)")
_PREFIX = re.compile(
    r"(?P<stem>[a-z]{0,2}?)(?P<axis>[xyz123k])_(?P<point>[A-Za-z]\w*?)(?:_(?P<frame>[A-Z]))?"
    r"(?P<rest>(?:_dot)*)"
)
_NUMBER = re.compile(r"(?P<stem>[A-Za-z]\w*?)_(?P<axis>\d+)(?P<rest>(?:_dot)*)")
_AXES = ("wxyz", "xyz", "123", "12k", "xy", "12")


def structured(variables: Sequence[FmuVariable]) -> tuple[FmuVariable, ...]:
    """Return the variables under structured names, each with its flat name as alias."""
    names = structured_names({v.name: f"{v.role.value} {v.unit}" for v in variables
                              if v.role not in (Role.TIME, Role.DERIVATIVE)})  # fmt: skip
    names |= {f"der({flat})": f"der({name})" for flat, name in names.items()}
    return tuple(
        replace(v, name=names[v.name], alias=v.name) if names.get(v.name, v.name) != v.name else v
        for v in variables
    )


def structured_names(kinds: Mapping[str, str]) -> dict[str, str]:
    """Return the structured name of each flat one.

    Args:
        kinds: What must be equal among the elements of an array, by flat name.

    Examples:
        >>> from cosim.fmi.export.description.structured_names import structured_names
        >>> structured_names({"fx_A": "N", "fy_A": "N", "T": "N.m"})
        {'fx_A': 'A.f[1]', 'fy_A': 'A.f[2]', 'T': 'T'}
    """
    groups: dict[tuple[str, str], dict[str, str]] = {}
    for name, kind in kinds.items():
        if found := next(_readings(name), None):
            array, axis = found
            groups.setdefault((array, kind), {})[axis] = name
    names = {name: name for name in kinds}
    arrays = [array for array, _ in groups]
    for (array, _), members in groups.items():
        root = re.split(r"[.\[]", array)[0]
        if root in kinds or arrays.count(array) > 1 or not (order := _order(members)):
            continue
        names |= {members[axis]: f"{array}[{i}]" for i, axis in enumerate(order, start=1)}
    return names


def _readings(name: str) -> Iterator[tuple[str, str]]:
    """Yield the array that a name may belong to, and its axis there."""
    if match := _SUFFIX.fullmatch(name):
        rest = match["rest"]
        yield match["stem"] + (f"_{rest}" if rest[:1].isdigit() else rest), match["axis"]
    elif match := _PREFIX.fullmatch(name):
        frame = f"_{match['frame']}" if match["frame"] else ""
        yield f"{match['point']}.{match['stem'] or 'r'}{frame}{match['rest']}", match["axis"]
    elif match := _NUMBER.fullmatch(name):
        yield f"{match['stem']}{match['rest']}", match["axis"]


def _order(members: Mapping[str, str]) -> Sequence[str]:
    """Return the axes of a whole array in their order; nothing where one is missing."""
    for axes in _AXES:
        if set(members) == set(axes):
            return axes
    numbers = [str(i) for i in range(1, len(members) + 1)]
    return numbers if len(numbers) > 1 and set(members) == set(numbers) else ()
