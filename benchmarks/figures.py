"""Figures of the documentation, drawn anew by the commands and programs of its pages.

    python benchmarks/figures.py [NAME ...]    # all, or those named, into docs/figures
    python benchmarks/figures.py --quick       # those that take some seconds each

`tests/test_figures_of_docs.py` compares the content of all with the files, except trade-offs, which
measure times (draw them on an idle machine), and `live_bicycle`, which needs Chromium and
`websockets`.
"""

import re
import runpy
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from contextlib import chdir, redirect_stdout
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import xarray

import cosim
from cosim.colors import CURVES
from cosim.plotting import STYLE, Picture, save

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "docs" / "figures"


def fit(target: Path) -> None:
    """Run the program of docs/fit.md, which writes into the current folder."""
    with tempfile.TemporaryDirectory() as scratch, chdir(scratch):
        Path("examples").mkdir()
        shutil.copy(ROOT / "examples" / "bar_swing.csv", "examples")
        runpy.run_path(str(ROOT / "examples" / "fit_bar.py"), run_name="__main__")
        shutil.copy("fit.png", target)


def furuta(target: Path) -> None:
    """Run the first two programs of docs/kane.md: the model and a run."""
    page = (ROOT / "docs" / "kane.md").read_text(encoding="utf-8")
    names: dict[str, Any] = {}
    for code in re.findall(r"```python\n(.*?)```", page, re.DOTALL)[:2]:
        exec(code, names)
    panels = (("swing",), ("arm",), ("lift",))
    spec = cosim.FigureSpec("Furuta's pendulum with an alternating voltage", panels)
    save(cosim.draw_figures([spec], names["run"]), str(target))


def sweep_bicycle(target: Path) -> None:
    """Run the sweep of docs/sweeps.md and draw the quantiles of its roll angle."""
    page = (ROOT / "docs" / "sweeps.md").read_text(encoding="utf-8")
    command = re.search(r"```\n(cosim sweep bicycle --design .*?)\n```", page, re.DOTALL)[1]
    with tempfile.TemporaryDirectory() as scratch:
        words = shlex.split(command.replace("\\\n", " "))
        run(["-m", *words, "-q"], Path(scratch))
        data = xarray.open_zarr(Path(scratch) / "falls.zarr", consolidated=False)
        time, phi = data["time"].values, np.degrees(data["phi"].values)
    low, lower, middle, upper, high = np.nanquantile(phi, [0.05, 0.25, 0.5, 0.75, 0.95], axis=0)
    with matplotlib.rc_context(STYLE):
        figure = Picture(figsize=(9.0, 3.4), layout="constrained")
        left, right = figure.subplots(1, 2)
        left.fill_between(time, low, high, color=CURVES[0], alpha=0.2, label="5 % to 95 % of runs")
        left.fill_between(time, lower, upper, color=CURVES[0], alpha=0.45, label="25 % to 75 %")
        left.plot(time, middle, color="black", label="median")
        left.set(xlabel="time [s]", ylabel="roll angle phi [deg]")
        left.margins(x=0)
        figure.legend(loc="outside lower left", ncols=3)
        right.hist(phi[:, -1], bins=np.arange(-90, 91, 5), color=CURVES[1], edgecolor="white")
        right.set(xlabel="roll angle phi after 5 s [deg]", ylabel="number of runs", yscale="log")
        figure.suptitle("1024 bicycles with different speeds, masses and initial roll rates")
        save([figure], str(target))


def live_bicycle(target: Path) -> None:
    """Take a picture of the page that docs/live.md describes, in a headless Chromium."""
    from base64 import b64decode

    sys.path.insert(0, str(ROOT / "tests"))
    from helpers.browser import opened

    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "bicycle.html"
        run(["-m", "cosim", "animate", "bicycle", "--live", "-o", str(path), "-q"])
        with opened(path, Path(scratch), size=(1400, 900)) as page:
            page.ask("player.go(0.9); await new Promise(done => setTimeout(done, 1500))")
            target.write_bytes(b64decode(page.call("Page.captureScreenshot", format="png")["data"]))


# A command of cosim, a script of this folder, or a function. The file to write is appended to a
# command or script; of several figures the first one is taken, or that with this `NUMBER`.
QUICK: dict[str, str | Callable[[Path], None]] = {
    "bar_two_body": "cosim plot bar_on_frame.toml --compare two_body --output-file",
    "bicycle_angles": "cosim plot bicycle_model_1.toml -o",
    "bicycle_jump": "cosim animate examples/bicycle_jump.py:build --at 0.1,0.34,0.52,0.9"
    " --size 6.4x3.2 -o",
    "bicycle_kick": "cosim plot bicycle_steer_kick.toml --compare fmu-cs -o",
    "bicycle_path_book": "cosim plot bicycle_path.toml --compare book --output-file",
    "coupling": "cosim tradeoff examples/coupled/ride.toml --repeats 0 --figure",
    "coupling_stiff": "cosim tradeoff examples/coupled/cut_pendulum.toml --repeats 0 --figure",
    "eigenvalues": "cosim linearize bicycle -p phi_dot=0 --outputs speed"
    " --along thetaR_dot=-3:-30:100 --figure",
    "fit": fit,
    "furuta": furuta,
    "scene_bicycle": "cosim animate bicycle --at 0,0.5,1,1.5 --stop-time 1.5 -o",
    "scene_crank_shaft": "cosim animate crank_shaft --at 0.02 --stop-time 0.2"
    " --output-interval 0.001 -o",
    "scene_bar_on_frame": "cosim animate bar_on_frame --at 0,0.1,0.2 --stop-time 2 -o",
    "scene_disk_two_bars": "cosim animate disk_two_bars --at 1.2 --stop-time 1.2 --size 4.8x4.8 -o",
    "scene_double_pendulum": "cosim animate double_pendulum --at 0,0.2,0.4 --stop-time 3"
    " --size 4x4.8 -o",
    "sensitivity": "cosim sensitivity bicycle --outputs phi,delta --stop-time 5 --by"
    " IBxx,IBxz,IBzz,mB,zGB,c,phi_dot,steer_torque --figure",
    "sweep_bicycle": sweep_bicycle,
}
LONG: dict[str, str | Callable[[Path], None]] = {
    "drift": "drift.py --figure",
    "extremes": "cosim extremes --figure",
    "live_bicycle": live_bicycle,
    "tradeoff_bicycle": "cosim tradeoff bicycle --figure",
    "tradeoff_pendulum": "cosim tradeoff double_pendulum --figure",
    "tradeoff_stiff_bar": "cosim tradeoff bar_on_frame -p b=2000ft.lbf.s/rad --figure",
}
NUMBER = {"bar_two_body": 5, "bicycle_angles": 17}
CHECKED = [*QUICK, "drift", "extremes"]
# Errors of solvers differ between processors
SOLVER_ERRORS = {"bar_two_body", "bicycle_kick", "coupling", "coupling_stiff", "drift"}


def draw(name: str, target: Path) -> None:
    """Draw a figure into a file."""
    how = (QUICK | LONG)[name]
    if not isinstance(how, str):
        with redirect_stdout(None):  # the programs print their results
            how(target)
        return
    with tempfile.TemporaryDirectory() as scratch:
        program, *words = shlex.split(how)
        words.append(str(Path(scratch) / "figure.png"))
        if program == "cosim":
            run(["-m", "cosim", *words, "-q"])
        else:
            run([str(ROOT / "benchmarks" / program), *words])
        drawn = sorted(Path(scratch).glob("*.png"))
        shutil.copy(drawn[NUMBER.get(name, 1) - 1], target)


def run(words: list[str], folder: Path = ROOT) -> None:
    """Run Python with these arguments in a folder."""
    subprocess.run([sys.executable, *words], check=True, stdout=subprocess.DEVNULL, cwd=folder)


def main(names: list[str]) -> None:
    for name in names:
        print(name, flush=True)
        draw(name, FOLDER / f"{name}.png")


if __name__ == "__main__":
    given = sys.argv[1:]
    main([*QUICK] if given == ["--quick"] else given or [*QUICK, *LONG])
