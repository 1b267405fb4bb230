"""Long generated functions in pieces: what a compiler takes grows with their length, not faster.

CasADi writes a function as one block of assignments, however long; the work that optimising
compilers put into a block grows faster than the block. A piece takes the values that it needs from
an array and leaves there what later pieces need. The operations and their order stay, so that
results are the same bits.
"""

import re
from collections.abc import Iterator, Mapping, Sequence

LONGEST = 500_000  # characters of a function that stays whole
MOST_BRANCHES = 1000  # within one; each argument and result that is looked at has one
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
    """Return code of CasADi's generator with long functions in pieces; other code as it is.

    Args:
        code: The whole file.
        longest: Characters of a function that stays whole.
        piece: Characters of a piece.
    """
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
    if sum(map(len, body)) > longest:
        return True
    return len(body) > MOST_BRANCHES and sum(map(_has_branch, body)) > MOST_BRANCHES


def _has_branch(line: str) -> bool:
    return "if (res" in line or "? arg" in line


def _divided(heading: str, head: str, body: Sequence[str], size: int) -> Iterator[str]:
    """Yield the functions of the pieces, and the function that calls them up to its brace."""
    steps = [line for line in body if not DECLARATION.fullmatch(line) and "return 0;" not in line]
    pieces = list(_parts(steps, size))
    taken, left = _values_across(pieces)
    places = {name: f"kept[{i}]" for i, name in enumerate(sorted(set().union(*left)))}
    begin = _BEGIN.fullmatch(head)
    assert begin is not None
    arguments = "const casadi_real** arg, casadi_real** res, casadi_real* kept"
    about = _NAME_COMMENT.fullmatch(heading)
    for n, part in enumerate(pieces):
        lines = list(_with_kept(part, taken[n], left[n], places))
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


def _with_kept(
    part: Sequence[str], taken: set[str], left: set[str], places: Mapping[str, str]
) -> Iterator[str]:
    """Yield the lines of a piece, values of other pieces and for them in their places.

    CasADi uses a variable for one value after the other: what crosses is the first that a piece
    reads without having set it, and the last that it sets.
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
    """Return for each piece which values it takes from earlier ones and which it leaves."""
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
