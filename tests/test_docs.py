"""What README and docs show: Python runs as printed, commands are ones that `cosim` takes."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from cosim.cli.main import command_line, main

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
# "```python fragment" is a part of something that stands elsewhere
FENCE = re.compile(r"^```(\w+)(?! fragment)[^\n]*\n(.*?)^```", re.MULTILINE | re.DOTALL)
EXTRAS = ("zarr", "xarray", "pandas", "dask", "meshcat", "libcosimpy", "ecospy")


def blocks(page, *languages):
    """Return the code blocks of a page in some languages, in their order."""
    return [body for language, body in FENCE.findall(page.read_text()) if language in languages]


def commands(page):
    """Return the `cosim` command lines of a page, without comments, prompts and shell parts."""
    found = []
    for body in blocks(page, "sh", "console", "bash"):
        for line in body.replace("\\\n", " ").splitlines():
            words = re.sub(r"^(\$ |\+ )", "", line.strip())
            if not words.startswith("cosim "):
                continue
            try:
                parts = shlex.split(words, comments=True)
            except ValueError:
                continue
            stop = next((i for i, p in enumerate(parts) if p in ("|", ">", "&&", ";", "2>")), None)
            found.append(parts[1:stop])
    return found


FILES_FROM_COMMANDS = ("embedding",)  # whose Python takes the files that its commands write
WITH_PYTHON = [page for page in PAGES if page.exists() and blocks(page, "python")]
WITH_COMMANDS = [page for page in PAGES if page.exists() and commands(page)]


SLOW = (
    "embedding",
    "fmu_casadi",
    "integrators",
    "drift",
    "tutorial",
    "sweeps",
    "python",
    "accuracy",
    "sessions",
    "steps",
    "linearize",
    "large_models",
)
BY_PAGE = [
    pytest.param(page, id=page.stem, marks=[pytest.mark.slow] * (page.stem in SLOW))
    for page in WITH_PYTHON
]


@pytest.mark.slow_rows(
    "README", "animate", "coupling", "events", "examples", "figures", "fit", "fmu", "kane", "scenes"
)
@pytest.mark.parametrize("page", BY_PAGE)
def test_python_of_a_page_runs_from_top_to_bottom(page, tmp_path):
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    exports = [words for words in commands(page) if words[0] == "export"]
    if page.stem in FILES_FROM_COMMANDS:
        with pytest.MonkeyPatch.context() as patch:
            patch.chdir(tmp_path)
            assert [main(words) for words in exports] == [0] * len(exports)
    names = [f"block {i}" for i, _ in enumerate(blocks(page, "python"))]
    code = "\n".join(f"# {n}\n{b}" for n, b in zip(names, blocks(page, "python"), strict=True))
    (tmp_path / "page.py").write_text(code)
    environment = os.environ | {"MPLBACKEND": "Agg", "COLUMNS": "100"}
    command = [sys.executable, "-W", "ignore", "page.py"]
    run = subprocess.run(
        command, cwd=tmp_path, capture_output=True, text=True, check=False, env=environment
    )
    missing = re.search(r"No module named '(\w+)'|The (\w+) package is required", run.stderr)
    if run.returncode and missing and (missing[1] or missing[2]) in EXTRAS:
        pytest.skip(f"{missing[1] or missing[2]} is an extra of the package")
    assert run.returncode == 0, run.stderr[-3000:]


@pytest.mark.parametrize("page", WITH_COMMANDS, ids=lambda page: page.stem)
def test_commands_of_a_page_are_ones_that_cosim_takes(page):
    parser = command_line()
    for words in commands(page):
        try:
            unknown: list[str] = []
            _, unknown = parser.parse_known_args(words)
        except SystemExit as end:
            code = end.code or 0
        else:
            code = 0
        assert code == 0, f"cosim {shlex.join(words)}"
        assert not unknown, f"cosim {shlex.join(words)}"


QUOTED = re.compile(r"^(?:\$ )?(?:cosim|pip|python3?|\.venv\S*pip) [^#\n]*'", re.MULTILINE)


@pytest.mark.parametrize("page", [page for page in PAGES if page.exists()], ids=lambda p: p.stem)
def test_commands_are_quoted_so_that_cmd_and_powershell_take_them(page):
    assert QUOTED.findall("\n".join(blocks(page, "sh", "console", "bash"))) == []


def test_messages_quote_what_to_install_so_that_cmd_takes_it():
    sources = (path.read_text(encoding="utf-8") for path in (ROOT / "src" / "cosim").rglob("*.py"))
    assert not [line for text in sources for line in text.splitlines() if "pip install '" in line]


@pytest.mark.parametrize("page", [page for page in PAGES if page.exists()], ids=lambda p: p.stem)
def test_links_of_a_page_lead_to_files(page):
    targets = re.findall(r"\]\(([^)#\s]+)[^)]*\)", page.read_text())
    missing = [t for t in targets if "://" not in t and not (page.parent / t).exists()]
    assert missing == []


PRINTED = ("conditions", "reduce")  # their console blocks show what a command prints, or its end
NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
SIZE = re.compile(r"\d+ kB")


def numbers_and_words(text):
    """Return the numbers of a text but sizes of files, and the words of each line without them."""
    text = SIZE.sub("kB", text)
    numbers = [float(number) for number in NUMBER.findall(text)]
    return numbers, [NUMBER.sub("0", line).split() for line in text.splitlines()]


@pytest.mark.slow_rows("conditions")
@pytest.mark.parametrize("name", PRINTED)
def test_console_blocks_of_a_page_show_what_the_program_prints(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    text = "".join(blocks(ROOT / "docs" / f"{name}.md", "console"))
    for part in re.split(r"^\$ cosim ", text, flags=re.MULTILINE)[1:]:
        command, _, shown = part.partition("\n")
        main(shlex.split(command))
        printed = "".join(capsys.readouterr())
        if shown.startswith("...\n"):
            shown = shown.removeprefix("...\n")
            printed = "\n".join(printed.splitlines()[-len(shown.splitlines()) :])
        numbers, words = numbers_and_words(printed)
        expected_numbers, expected_words = numbers_and_words(shown)
        assert words == expected_words
        # last digits differ between processors; drift is rounding
        assert numbers == pytest.approx(expected_numbers, rel=1e-6, abs=1e-12)
