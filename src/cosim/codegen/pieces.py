"""Division of long generated C functions, so that compile time grows in proportion to length.

CasADi writes a function as one block of assignments, and the time of an optimizing compiler grows
faster than the length of a block. Each piece reads values from an array and stores there the values
that later pieces need. The operations and their order are unchanged, and so are all bits of the
results.
"""

import re
from collections.abc import Iterator, Mapping, Sequence

LONGEST = 500_000  # characters of a function that is not divided
MOST_BRANCHES = 1000  # of a function that is not divided; each argument and result has one
PIECE = 15_000  # characters, some 500 operations

_ASSIGNED = re.compile(r" +(a\d+)=(.*)")
TEMPORARY = re.compile(r"\ba\d+\b")
DECLARATION = re.compile(r" +casadi_real a.*;")
STRAIGHT_LINE = re.compile(r" +(a\d+=.*|casadi_real a.*|if \(res\[\d+\].*|return 0);")
_BEGIN = re.compile(r"static int (casadi_f\d+)\(.*\) ?\{")
_NAME_COMMENT = re.compile(r"/\* (\w+):.*")
_NOT_INLINED = """#ifdef __GNUC__
#define APART __attribute__((noinline)) /* put together again, it would be long */
#else
#define APART
#endif
"""


def in_pieces(code: str, longest: int = LONGEST, piece: int = PIECE) -> str:
    """Return generated C code with long functions divided into pieces."""
    if len(code) <= longest and code.count("\n") <= MOST_BRANCHES:
        return code
    lines, result, begin = code.split("\n"), list[str](), None
    divided = False
    for i, line in enumerate(lines):
        if begin is None and _BEGIN.fullmatch(line):
            begin = i
        if begin is None:
            result.append(line)
        elif line == "}":
            body = lines[begin + 1 : i]
            if _is_long(body, longest) and all(map(STRAIGHT_LINE.fullmatch, body)):
                heading = result.pop() if result and _NAME_COMMENT.fullmatch(result[-1]) else ""
                result += _divided(heading, lines[begin], body, piece)
                divided = True
            else:
                result += [lines[begin], *body]
            result.append(line)
            begin = None
    return (_NOT_INLINED if divided else "") + "\n".join(result)


def _is_long(body: Sequence[str], longest: int) -> bool:
    branches = ("if (res" in line or "? arg" in line for line in body)
    return sum(map(len, body)) > longest or sum(branches) > MOST_BRANCHES


def _divided(heading: str, head: str, body: Sequence[str], size: int) -> Iterator[str]:
    """Yield the pieces as functions, then the function that calls them, without its last brace."""
    steps = [line for line in body if not DECLARATION.fullmatch(line) and "return 0;" not in line]
    pieces = list(_parts(steps, size))
    taken, left = _values_across(pieces)
    places = {name: f"kept[{i}]" for i, name in enumerate(sorted(set().union(*left)))}
    begin = _BEGIN.fullmatch(head)
    assert begin is not None
    arguments = "const casadi_real** arg, casadi_real** res, casadi_real* kept"
    about = _NAME_COMMENT.fullmatch(heading)
    for n, part in enumerate(pieces):
        lines = list(_with_stored_values(part, taken[n], left[n], places))
        own = sorted({name for line in lines for name in TEMPORARY.findall(line)})
        yield f"/* {about[1] if about else begin[1]}: part {n + 1} of {len(pieces)} */"
        yield f"static int APART {begin[1]}_{n + 1}({arguments}) {{"
        for i in range(0, len(own), 12):
            yield f" casadi_real {', '.join(own[i : i + 12])};"
        yield from lines
        yield " return 0;"
        yield "}"
        yield ""
    yield from [heading] if heading else []
    yield head
    yield f" casadi_real kept[{len(places) or 1}];"
    for n in range(1, len(pieces) + 1):
        yield f" if ({begin[1]}_{n}(arg, res, kept)) return 1;"
    yield " return 0;"


def _parts(steps: Sequence[str], size: int) -> Iterator[list[str]]:
    part, length = list[str](), 0
    for line in steps:
        part.append(line)
        length += len(line)
        if length >= size:
            yield part
            part, length = [], 0
    if part:
        yield part


def _with_stored_values(
    part: Sequence[str], taken: set[str], left: set[str], places: Mapping[str, str]
) -> Iterator[str]:
    """Yield the lines of a piece, with the values shared with other pieces in the array.

    CasADi uses a variable for several values. A piece takes the value that it reads before it sets
    the variable, and leaves the value that it sets last.
    """
    last = {found[1]: i for i, line in enumerate(part) if (found := _ASSIGNED.fullmatch(line))}
    outside = {name: places[name] for name in taken}
    for i, line in enumerate(part):
        assignment = _ASSIGNED.fullmatch(line)
        text = assignment[2] if assignment else line
        text = TEMPORARY.sub(lambda found: outside.get(found[0], found[0]), text)
        if assignment is None:
            yield text
            continue
        name = assignment[1]
        if name in left and last[name] == i:
            outside[name] = places[name]
        else:
            outside.pop(name, None)
        yield f" {outside.get(name, name)}={text}"


def _values_across(pieces: Sequence[Sequence[str]]) -> tuple[list[set[str]], list[set[str]]]:
    """Return for each piece the values it takes from earlier pieces and those it leaves."""
    taken, sets = list[set[str]](), list[set[str]]()
    for part in pieces:
        before, here = set[str](), set[str]()
        for line in part:
            assignment = _ASSIGNED.fullmatch(line)
            text = assignment[2] if assignment else line
            before.update(name for name in TEMPORARY.findall(text) if name not in here)
            if assignment:
                here.add(assignment[1])
        taken.append(before)
        sets.append(here)
    left, wanted = list[set[str]](), set[str]()
    for before, here in zip(reversed(taken), reversed(sets), strict=True):
        left.append(here & wanted)
        wanted = (wanted - here) | before
    return taken, left[::-1]
