"""Plain words: no private term of this project in what users and readers of the code see.

The table gives for each term what to write instead. Text, identifiers and string literals of
README, changelog, docs, and the Python, C, JavaScript, CSS, HTML and TOML files of the product are
searched; parts of an identifier count as words.
"""

import re

import pytest
from helpers.import_graph import ROOT

INSTEAD = {
    r"roads?": "native simulation, FMU simulation, backend",
    r"told": "reported; name the thing",
    r"felt": "name the thing",
    r"mend(ed|s|ing)?": "fix",
    r"nobody|somebody": "name the person or the program; or leave it out",
    r"promise[ds]?": "predicted error, error bound",
    r"taken at (its|their) word": "say what is assumed",
    r"(lost|losing) rank|loss(es)? of rank": "singular configuration",
    r"held speeds?": "constrained speed",
    r"second opinions?": "independent check",
    r"doctors?": "FMU checker",
    r"twins?": "second formulation",
    r"closing\srates?": "Baumgarte stabilization rate",
    r"proofs?": "reference result",
    r"first guess(es)?": "initial guess",
    r"limit cases?": "extreme cases",
    r"counts? in nominal values": "are scaled by nominal values",
    r"(the|its|their) begin": "the start",
    r"alike": "leave it out, or say what is equal",
    r"(col|behavi|neighb|fav|hon)our\w*|grey|centres?|centred": "American spelling",
    r"(initial|normal|optim|minim|summar|linear|recogn|general|discret)is(e|ed|es|ing|ation)": (
        "American spelling: -ize"
    ),
}
# End of a path and part of a line (lower case), with the reason why the word is right there
ALLOWED: dict[tuple[str, str], str] = {
    ("docs/examples.md", "bumpy road"): "the road under a car",
    (".js", "promise"): "a class of JavaScript",
}
LANGUAGES = {".py", ".c", ".h", ".js", ".css", ".html", ".toml"}
FILES = [
    *(ROOT / name for name in ("README.md", "CHANGELOG.md", "pyproject.toml")),
    *sorted((ROOT / "docs").glob("*.md")),
    *(
        path
        for folder in ("src/cosim", "casadi_models", "fmu")
        for path in sorted((ROOT / folder).rglob("*"))
        if path.suffix in LANGUAGES
    ),
]
# Letters bound a word, underscores do not: `_told` and `told_by` are found, `untold` is not
PATTERNS = {
    re.compile(rf"(?<![A-Za-z])(?:{term.replace(' ', '[ _]')})(?![A-Za-z])", re.IGNORECASE): better
    for term, better in INSTEAD.items()
}


def private_words(text: str) -> list[tuple[int, str, str]]:
    """Return line, term and replacement of every private term in a text."""
    found = []
    for number, line in enumerate(text.splitlines(), 1):
        for pattern, better in PATTERNS.items():
            found += [(number, match[0], better) for match in pattern.finditer(line)]
    return found


def allowed(path: str, line: str) -> bool:
    """Return whether the table of exceptions has this line."""
    return any(path.endswith(end) and part in line.lower() for end, part in ALLOWED)


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_text_has_no_private_words(path):
    text = path.read_text(encoding="utf-8")
    lines, name = text.splitlines(), path.relative_to(ROOT).as_posix()
    assert [
        f"{name}:{number}: '{word}'; write: {better}"
        for number, word, better in private_words(text)
        if not allowed(name, lines[number - 1])
    ] == []


@pytest.mark.parametrize(
    "line",
    ["The same equations go down two roads.", "told = 1", "def _felt(x): ...", "PROMISED = 2",
     "it is taken at its word", "the lost rank", "lost_rank(x)", "the centre of mass"],
)  # fmt: skip
def test_guard_sees_a_private_word(line):
    assert len(private_words(line)) == 1


@pytest.mark.parametrize("line", ["broad", "an untold story", "compromise", "amended", "center"])
def test_guard_lets_other_words_pass(line):
    assert private_words(line) == []


def test_every_exception_is_needed():
    found = {
        (end, part)
        for end, part in ALLOWED
        for path in FILES
        if path.as_posix().endswith(end)
        for number, word, _ in private_words(path.read_text(encoding="utf-8"))
        if part in path.read_text(encoding="utf-8").splitlines()[number - 1].lower()
    }
    assert found == set(ALLOWED)
