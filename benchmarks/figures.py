"""Figures of the documentation, drawn anew by the commands that made them.

    python benchmarks/figures.py [NAME ...]    # all, or those named, into docs/figures
    python benchmarks/figures.py --quick       # those without measured times, some seconds each

`tests/test_figures_of_docs.py` compares the content of the quick ones with the files.
"""

import shlex
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "docs" / "figures"
QUICK = {
    "bicycle_jump": "animate examples/bicycle_jump.py:build --at 0.1,0.34,0.52,0.9 -o",
    "eigenvalues": "linearize bicycle -p phi_dot=0 --outputs speed --along thetaR_dot=-3:-30:100"
    " --figure",
    "scene_bicycle": "animate bicycle --at 0,0.5,1,1.5 --stop-time 2 -o",
    "scene_crank_shaft": "animate crank_shaft --at 0.02 --stop-time 0.2 --output-interval 0.001 -o",
    "scene_bar_on_frame": "animate bar_on_frame --at 0,0.1,0.2 --stop-time 2 -o",
    "scene_disk_two_bars": "animate disk_two_bars --at 1.2 --stop-time 1.2 -o",
    "scene_double_pendulum": "animate double_pendulum --at 0,0.2,0.4 --stop-time 3 -o",
    "sensitivity": "sensitivity bicycle --outputs phi,delta --stop-time 5 --by"
    " IBxx,IBxz,IBzz,mB,zGB,c,phi_dot,steer_torque --figure",
}
LONG = {
    "extremes": "extremes --figure",
    "tradeoff_bicycle": "tradeoff bicycle --figure",
    "tradeoff_pendulum": "tradeoff double_pendulum --figure",
    "tradeoff_stiff_bar": "tradeoff bar_on_frame -p b=2000ft.lbf.s/rad --figure",
}
SCRIPTS = {"coupling": "coupling.py", "drift": "drift.py --figure"}


def draw(name: str, target: Path) -> None:
    """Draw a figure into a file."""
    if name in SCRIPTS:
        call = [f"{ROOT}/benchmarks/{SCRIPTS[name]}", str(target)]
    else:
        call = [f"-m cosim {(QUICK | LONG)[name]}", str(target), "-q"]
    words = [word for part in call for word in shlex.split(part)]
    subprocess.run([sys.executable, *words], check=True, stdout=subprocess.DEVNULL, cwd=ROOT)


def main(names: list[str]) -> None:
    for name in names:
        print(name, flush=True)
        draw(name, FOLDER / f"{name}.png")


if __name__ == "__main__":
    given = sys.argv[1:]
    main([*QUICK] if given == ["--quick"] else given or [*QUICK, *LONG, *SCRIPTS])
