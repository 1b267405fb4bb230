"""Pages that compute, run in node: the same WebAssembly and JavaScript as in a browser."""

import json
import shutil
import subprocess

from cosim.present.playback import page as pages
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
const chosen = new Map(Object.entries(JSON.parse(settings)));
let run, milliseconds = Infinity;
for (let k = 0; k < 7; ++k) {
  const begin = performance.now();
  run = solver.run(chosen);
  milliseconds = Math.min(milliseconds, performance.now() - begin);
}
const names = data.columns.map((column) => column.name);
const values = run.curves.values.map((column) => Array.from(column));
const { events, reasons, invalid_from } = run, time = Array.from(run.time);
console.log(JSON.stringify({ time, names, values, events, reasons, invalid_from, milliseconds }));
"""


def computed(dae, settings, folder):
    """Return what a page computes, the shortest time of seven runs, and the size of the page."""
    page, program = folder / "x.html", folder / "run.mjs"
    animate(dae, page)
    program.write_text(RUN, encoding="utf-8")
    script = pages.__file__.replace("page.py", "page/live.js")
    command = [NODE, program, page, script, json.dumps(settings)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return json.loads(done.stdout) | {"bytes": page.stat().st_size}
