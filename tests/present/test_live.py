"""The solver of a page, in node: its numbers are those of the native FMU."""

import json
import shutil
import subprocess

import numpy as np
import pytest

import casadi_models
import cosim
from cosim.present.playback.animate import animate

NODE = shutil.which("node")
RUN = """
import fs from "fs";
import vm from "vm";
const [page, script, settings] = process.argv.slice(2);
const text = fs.readFileSync(page, "utf8");
const data = JSON.parse(/<script id="data" type="application.json">([^]*?)<.script>/.exec(text)[1]);
vm.runInThisContext(fs.readFileSync(script, "utf8") + "; globalThis.Solver = Solver;");
const solver = await Solver.of(data.live);
const run = solver.run(new Map(Object.entries(JSON.parse(settings))));
const names = data.columns.map((column) => column.name);
const values = run.curves.values.map((column) => Array.from(column));
console.log(JSON.stringify({ time: Array.from(run.time), names, values, reasons: run.reasons }));
"""

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(NODE is None, reason="no node here: apt-get install nodejs"),
]


def computed(dae, settings, folder):
    """Return what a page computes."""
    pytest.importorskip("ziglang")
    page, program = folder / "x.html", folder / "run.mjs"
    animate(dae, page)
    program.write_text(RUN, encoding="utf-8")
    script = cosim.present.playback.page.__file__.replace("page.py", "page/live.js")
    command = [NODE, program, page, script, json.dumps(settings)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


@pytest.mark.parametrize("name", [n for n in casadi_models.CATALOG if "/" in n])
def test_run_of_a_page_is_that_of_the_fmu(name, tmp_path):
    dae = cosim.load(name)
    found = computed(dae, {}, tmp_path)
    fmu = cosim.export_fmu(dae, tmp_path / "x.fmu")
    run = cosim.simulate_fmu(fmu, interface="CoSimulation", outputs=found["names"])
    np.testing.assert_array_equal(found["time"], run.time)
    for column, values in zip(found["names"], found["values"], strict=True):
        size = max(np.abs(run[column]).max(), run.column(column).nominal)
        np.testing.assert_allclose(values, run[column], rtol=0, atol=1e-11 * size, err_msg=column)


def test_page_says_which_limit_the_run_leaves(tmp_path):
    found = computed(cosim.load("bicycle"), {"phi_dot": 4.0}, tmp_path)
    assert any("it is no longer true that" in reason for reason in found["reasons"])


def test_page_says_why_a_run_cannot_start(tmp_path):
    found = computed(cosim.load("bicycle"), {"mB": -1.0}, tmp_path)
    assert found["time"] == []
    assert "mB" in " ".join(found["reasons"])
