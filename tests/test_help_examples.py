"""Every example that a `--help` shows runs as it is printed."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest

import cosim
from cosim.cli.main import main
from cosim.cli.verbs import VERBS
from cosim.errors import MissingTool

EXAMPLES = [example for verb in VERBS.values() for example in verb.examples]
LONG = "cosim extremes --figure map.png -o cases.csv"  # all cases: about an hour


def test_every_verb_has_an_example():
    assert all(example.startswith("cosim ") for example in EXAMPLES)
    assert {example.split()[1] for example in EXAMPLES} == set(VERBS)


def write_measured_swing(path, degrees):
    swing = cosim.simulate("bar_on_frame", stop_time=1)
    name, values = (
        ("angle [deg]", np.degrees(swing["theta"])) if degrees else ("theta", swing["theta"])
    )
    rows = (f"{t},{value}" for t, value in zip(swing.time, values, strict=True))
    path.write_text("\n".join([f"time,{name}", *rows]) + "\n", encoding="utf-8")


@pytest.mark.slow
@pytest.mark.parametrize(
    "example", [pytest.param(e, marks=[pytest.mark.nightly] * (e == LONG)) for e in EXAMPLES]
)
def test_example_of_the_help_runs(example, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    if "--clear" in example:
        monkeypatch.setenv("COSIM_CACHE", str(tmp_path / "cache"))
    if "bicycle.fmu" in example and " export " not in example:
        main(["export", "bicycle", "-o", "bicycle.fmu"])  # with the reference result
    if "swing.csv" in example:
        write_measured_swing(Path("swing.csv"), degrees="angle [deg]" in example)
    words = shlex.split(example)[1:]
    code = main(words)
    if code == MissingTool.exit_code:
        pytest.skip("a tool or an extra of the package is missing")
    assert code == 0
    for file in re.findall(r"(?:-o|--figure) (\S+)", example):
        path = Path(file)
        written = [*tmp_path.glob(f"{path.stem}*{path.suffix}")]  # a picture file for each figure
        assert written
        assert all(each.stat().st_size for each in written)
