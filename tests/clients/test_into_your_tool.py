"""The numbers of docs/into_your_tool.md, from the tools that run here."""

import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import fmpy
import pytest

from cosim.cli.main import main

PAGE = (Path(__file__).parents[2] / "docs" / "into_your_tool.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    found = tmp_path_factory.mktemp("tool")
    export = ["export", "bicycle", "--outputs", "phi,delta", "-o", str(found / "bicycle.fmu"), "-q"]
    assert main(export) == 0
    return found


def block(language, word):
    """Return the code block of a language that contains a word."""
    blocks = re.findall(rf"```{language}[^\n]*\n(.*?)```", PAGE, re.DOTALL)
    return next(text for text in blocks if word in text)


def near(text):
    """Return the two numbers at the end of a text, of which the page shows nine digits."""
    return pytest.approx([float(word) for word in re.findall(r"0\.0\d+", text)[-2:]], abs=2e-9)


@pytest.mark.slow
def test_fmpy_prints_the_numbers_of_the_page(folder):
    shown = block("console", "fmpy simulate")
    line = re.search(r"\$ fmpy (.*)", shown)[1].split()
    subprocess.run([sys.executable, "-m", "fmpy", *line], cwd=folder, check=True)
    last = (folder / "out.csv").read_text().splitlines()[-1]
    assert [float(word) for word in last.split(",")[1:]] == near(shown)
    assert near(shown) == [0.0561808095, 0.0630973198]
    assert "phi = 0.0561808" in PAGE


@pytest.mark.slow
def test_ecos_prints_the_numbers_of_the_page(folder, monkeypatch, capfd):
    try:
        import ecospy  # noqa: F401
    except (ImportError, OSError) as error:  # its library needs libtbb
        pytest.skip(f"ecospy cannot be loaded: {error}")
    monkeypatch.chdir(folder)
    exec(compile(block("python", "ecospy"), "page", "exec"), {})
    printed = capfd.readouterr().out.strip()
    assert [float(word) for word in printed.split()[-2:]] == near(
        re.search(r"It prints `(.*?)`. libcosim", PAGE)[1]
    )


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("gcc") is None, reason="the command of the page is for gcc")
def test_own_c_program_prints_the_numbers_of_the_page(folder):
    zipfile.ZipFile(folder / "bicycle.fmu").extractall(folder / "bicycle")
    (folder / "main.c").write_text(block("c", "fmi2Functions.h"))
    guid = re.search(r'guid="(.*?)"', (folder / "bicycle/modelDescription.xml").read_text())[1]
    command = re.search(r"^gcc .*", block("sh", "-lm"), re.MULTILINE)[0]
    headers = Path(fmpy.__file__).parent / "c-code"
    command = command.replace("{...}", guid).replace("-I c-code", f"-I '{headers}'")
    subprocess.run(command, shell=True, cwd=folder, check=True)
    printed = subprocess.check_output(folder / "ride", text=True).strip()
    assert f"It prints `{printed}`" in PAGE
