"""The HTML file in a browser: bodies stand where the run says, nothing is asked of the network."""

import re
import shutil
import subprocess

import numpy as np
import pytest
from helpers.scenes import spinning
from PIL import Image

import cosim
from cosim.drawing.camera import View, camera_for, scale_of
from cosim.present.playback.animate import animate
from cosim.present.playback.html import html
from cosim.present.playback.playback import playback

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
SIZE = 900, 700
HALF_ANGLE = np.radians(75 / 2)  # viser's camera

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here: apt-get install chromium"),
]


def picture(page, folder, milliseconds):
    """Return what the browser shows after some time, (rows, columns, 3), and what it logged."""
    target = folder / "shot.png"
    options = (
        "--headless=new --no-sandbox --disable-dev-shm-usage --use-gl=angle --hide-scrollbars "
        "--use-angle=swiftshader --enable-unsafe-swiftshader --enable-logging=stderr "
        "--host-resolver-rules=MAP*~NOTFOUND --disable-background-networking"
    ).replace("MAP*~", "MAP * ~")
    words = re.split(r" (?=--)", options)
    for attempt in range(3):  # headless Chromium hangs now and then, whatever the page
        command = [
            CHROMIUM,
            *words,
            f"--window-size={SIZE[0]},{SIZE[1]}",
            f"--user-data-dir={folder / f'profile {attempt}'}",
            f"--virtual-time-budget={milliseconds}",
            f"--screenshot={target}",
            page.as_uri(),
        ]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
            break
        except subprocess.TimeoutExpired:
            continue
    else:
        pytest.skip("headless Chromium hung three times on this machine")
    with Image.open(target) as shot:
        return np.asarray(shot.convert("RGB")).astype(int), done.stderr


def problems(log):
    """Return what the page itself complains of."""
    lines = [line for line in log.splitlines() if "CONSOLE" in line]
    return [line for line in lines if "ERR_" in line or "Uncaught" in line or "rror:" in line]


@pytest.mark.parametrize("angle", [0.4, 2.0])
def test_a_known_point_is_where_the_run_says(angle, tmp_path):
    pytest.importorskip("viser")
    run = cosim.simulate(spinning(4.0), stop_time=1.0, compiled=False)
    played = playback(run, run.drawing, times=[angle / 4.0])
    page = tmp_path / "x.html"
    page.write_text(html([played]), encoding="utf-8")
    shot, log = picture(page, tmp_path, 3000)
    assert not problems(log)

    camera = camera_for(played.world, View.ISO, scale_of([played], None))
    mark = np.array([0.5 * np.cos(angle), 0.5 * np.sin(angle), 1.0])
    local = (mark - camera.eye) @ camera.axes.T
    rows, columns = shot.shape[:2]
    pixels = rows / 2 / np.tan(HALF_ANGLE)
    wanted = np.array([rows / 2 + pixels * local[1] / local[2],
                       columns / 2 - pixels * local[0] / local[2]])  # fmt: skip
    r, g, b = np.moveaxis(shot, -1, 0)
    blue = np.argwhere((b > 1.4 * g) & (b > 2.5 * r) & (b > 60))  # the mark's #0072B2
    assert len(blue) > 30
    assert (
        np.linalg.norm(blue.mean(axis=0) - wanted) < 0.05 * rows
    )  # a part of the mark is hidden by the disk


@pytest.mark.parametrize(
    "model", ["crank_shaft", "bar_on_frame", "bicycle", "disk_two_bars", "double_pendulum"]
)
def test_every_system_moves_in_the_browser(model, tmp_path):
    pytest.importorskip("viser")
    run = cosim.simulate(cosim.load(model), compiled=False)
    page = animate(run, tmp_path / "x.html")
    first, log = picture(page, tmp_path, 2500)
    second, more = picture(page, tmp_path, 4500)
    assert not problems(log + more)
    for shot in (first, second):
        colored = (np.ptp(shot, axis=2) > 60)[150:, 150:-150]
        assert colored.sum() > 300  # not blank
    assert (np.abs(first - second).max(axis=2) > 40)[150:-60].sum() > 100  # not the same
