"""GLB files through the Khronos validator, where `.ci/run` could install it with npm.

Without it, `test_animate.py` judges their structure.
"""

import json
import os
import shutil
import subprocess
from pathlib import Path

import pytest

import cosim

ROOT = Path(__file__).parents[2]
MODULES = Path(os.environ.get("COSIM_NODE_MODULES", ROOT / "build" / "node" / "node_modules"))
SCRIPT = """
const validator = require("gltf-validator"), fs = require("fs");
validator.validateBytes(new Uint8Array(fs.readFileSync(process.argv[1])), {maxIssues: 20}).then(
  report => console.log(JSON.stringify(report)),
  error => { console.error(error); process.exit(1); });
"""
SYSTEMS = ["crank_shaft", "bar_on_frame", "bicycle", "disk_two_bars", "double_pendulum"]

pytestmark = pytest.mark.skipif(
    shutil.which("node") is None or not (MODULES / "gltf-validator").is_dir(),
    reason="needs node and its package gltf-validator: npm install --prefix build/node",
)


def report(path):
    """Return what the validator says of a file."""
    own = os.environ | {"NODE_PATH": str(MODULES)}
    command = ["node", "-e", SCRIPT, str(path)]
    run = subprocess.run(command, capture_output=True, text=True, check=False, env=own)
    assert run.returncode == 0, run.stderr
    return json.loads(run.stdout)


@pytest.mark.parametrize("system", SYSTEMS)
def test_file_of_every_system_is_valid(system, tmp_path):
    pytest.importorskip("pygltflib", reason="an extra of the package")
    run = cosim.simulate(system, stop_time=1.0)
    found = report(run.animate(tmp_path / "x.glb"))
    issues = found["issues"]
    assert issues["numErrors"] == 0, issues["messages"]
    assert issues["numWarnings"] == 0, issues["messages"]
    assert found["info"]["animationCount"] == 1


def test_validator_sees_what_is_wrong(tmp_path):
    pytest.importorskip("pygltflib", reason="an extra of the package")
    path = cosim.simulate("crank_shaft", stop_time=0.2).animate(tmp_path / "x.glb")
    broken = path.read_bytes().replace(b'"count":', b'"couns":', 1)
    path.write_bytes(broken)
    assert report(path)["issues"]["numErrors"] > 0
