"""Progress of long work: bars on a terminal, and nothing anywhere else."""

import io
import os
import re
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest
from helpers.scenes import spinning

import cosim
from cosim.cli.main import main
from cosim.fmi.export import build
from cosim.fmi.platforms import targets
from cosim.host import progress
from cosim.host.progress import doing, shown_on_terminal
from cosim.study.extremes import campaign

pty = pytest.importorskip("pty", reason="Windows has no pseudo-terminals")
LONG = "import sys; from cosim.cli.main import main; sys.exit(main(sys.argv[1:]))"
MODEL = """
from casadi_models.dae import Model

def build():
    model = Model("slow", description="a fast oscillation for long", source="a test",
                  stop_time=STOP, output_interval=STOP / 400)
    x, v = model.state("x", "1", 1.0, "place"), model.state("v", "1", 0.0, "rate")
    model.derivative(x, NUMBER * v)
    model.derivative(v, -NUMBER * x)
    return model.freeze()
"""


class Terminal(io.StringIO):
    def isatty(self):
        return True


def on_a_terminal(command, folder, **environment):
    """Run a command on a terminal; return its exit code, its output, and what the terminal saw."""
    ours, theirs = pty.openpty()
    own = os.environ | {"TERM": "xterm", "COLUMNS": "100"} | environment
    process = subprocess.Popen(
        command, cwd=folder, env=own, stdout=subprocess.PIPE, stderr=theirs, stdin=theirs
    )
    os.close(theirs)
    seen = bytearray()

    def read():
        try:
            while part := os.read(ours, 4096):
                seen.extend(part)
        except OSError:  # Linux's end of a terminal
            pass

    reader = threading.Thread(target=read)
    reader.start()
    output, _ = process.communicate(timeout=120)
    reader.join(10)
    os.close(ours)
    return process.returncode, output.decode(), seen.decode()


def slow(folder, stop):
    number = f"1.{stop % 97:02d}{int(stop)}"  # whose code no cache has
    text = MODEL.replace("STOP", str(float(stop))).replace("NUMBER", number)
    (folder / "slow.py").write_text(text)
    return [sys.executable, "-c", LONG, "simulate", "slow.py:build", "--solver", "dop853"]


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    """Return what a terminal and a pipe see of one long run, whose code nobody has compiled yet."""
    folder = tmp_path_factory.mktemp("progress")
    command = [*slow(folder, 3_000_000), "-o", "run.csv"]
    cache = str(tmp_path_factory.mktemp("cache"))
    terminal = on_a_terminal(command, folder, COSIM_CACHE=cache, NO_COLOR="1")
    environment = os.environ | {"COSIM_CACHE": cache}
    run = {"cwd": folder, "env": environment, "capture_output": True, "text": True}
    pipe = subprocess.run(command, check=False, timeout=120, **run)
    return terminal, pipe


@pytest.mark.slow
def test_terminal_shows_the_share_of_simulated_time_and_the_time_left(seen):
    (code, _, text), _ = seen
    assert code == 0, text
    assert "slow, 00:0" in text
    shares = [int(share) for share in re.findall(r"solving: (\d+) %", text)]
    assert len(shares) > 1
    assert shares == sorted(shares)
    assert re.search(r"solving: \d+ %\|.*\| \d\d:\d\d, \d\d:\d\d left", text)


@pytest.mark.slow
def test_bars_are_gone_at_the_end_and_have_no_color(seen):
    (_, _, text), _ = seen
    assert not re.search(r"\x1b\[[\d;]*m", text)
    assert not text.split("\r")[-1].strip()


@pytest.mark.slow
def test_pipe_gets_no_progress(seen):
    _, pipe = seen
    assert pipe.returncode == 0
    assert pipe.stdout + pipe.stderr == ""


def test_compiling_is_shown_and_its_time_is_reported(tmp_path, monkeypatch):
    monkeypatch.setenv("COSIM_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(progress, "DELAY", 0.0)
    monkeypatch.setattr(progress, "INTERVAL", 0.001)
    model = cosim.Model("only_here", stop_time=0.1)  # which no other test has had compiled
    x = model.state("x", "1", 1.0, "what decays")
    model.derivative(x, -x)
    dae = model.freeze()
    terminal = Terminal()
    with monkeypatch.context() as patch:
        patch.setattr(sys, "stderr", terminal)
        with shown_on_terminal(False):
            run = cosim.simulate(dae)
        assert sys.stderr is terminal
    assert "only_here" in terminal.getvalue()
    assert "compiling (once)" in terminal.getvalue()
    assert 0 < run.stats.compile_time < run.stats.wall_time
    assert "compile_time" not in cosim.simulate(dae, stop_time=0.2).stats


def test_other_text_is_printed_above_the_bar(monkeypatch):
    monkeypatch.setattr(progress, "DELAY", 0.0)
    monkeypatch.setattr(progress, "INTERVAL", 0.01)
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    with shown_on_terminal(False), doing("waiting"):
        time.sleep(0.1)
        print("a message", file=sys.stderr)
        time.sleep(0.05)
    assert re.search(r"waiting, 00:00 *\r +\ra message\n\r", terminal.getvalue())


@pytest.mark.parametrize("why", ["quiet", "dumb", "pipe"])
def test_nothing_is_shown_if_quiet_or_without_a_terminal(why, monkeypatch):
    stream = Terminal() if why != "pipe" else io.StringIO()
    monkeypatch.setattr(sys, "stderr", stream)
    monkeypatch.setattr(progress, "DELAY", 0.0)
    if why == "dumb":
        monkeypatch.setenv("TERM", "dumb")
    with shown_on_terminal(why == "quiet"), doing("waiting"):
        time.sleep(0.3)
    assert stream.getvalue() == ""


def test_time_left_follows_from_the_share_that_is_done(monkeypatch):
    terminal = shown_at_once(monkeypatch)
    began = time.time()
    monkeypatch.setattr("tqdm.std.time", lambda: began + 10)
    with shown_on_terminal(False), doing("solving", lambda: 0.25):
        time.sleep(0.3)
    assert re.search(r"solving: 25 %\|.*\| 00:(10|09), 00:(29|30) left", terminal.getvalue())


def shown_at_once(monkeypatch):
    """Replace stderr by a terminal that shows progress without delay."""
    stream = Terminal()
    monkeypatch.setattr(sys, "stderr", stream)
    monkeypatch.setattr(progress, "DELAY", 0.0)
    monkeypatch.setattr(progress, "INTERVAL", 0.001)
    return stream


def lines(text):
    """Return the different lines of the terminal in order, without bars."""
    parts = re.split(r"[\r\n]+", text.replace("\x1b[A", ""))
    return list(dict.fromkeys(re.sub(r"\|.*\|", "", part).strip() for part in parts))


def test_export_shows_the_remaining_platforms_and_the_time_left(monkeypatch):
    ends = {name: threading.Event() for name in ("linux64", "win64")}

    def compiled(_sources, _name, target, _halted):
        assert ends[target.folder(2)].wait(10)
        return b"library"

    monkeypatch.setattr(build, "compiled_library", compiled)
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    terminal = shown_at_once(monkeypatch)
    with shown_on_terminal(False), ThreadPoolExecutor(1) as other:

        def let_go():
            for name in ends:
                time.sleep(0.15)
                ends[name].set()

        other.submit(let_go)
        made = build.binaries({}, "model", targets(list(ends), 2))
    assert len(made) == 2
    both, one = (f"compiling for {names}" for names in ("linux64, win64", "win64"))
    seen = lines(terminal.getvalue())
    assert f"{both}: 0 % 00:00, ? left" in seen
    assert f"{one}: 50 % 00:00, 00:00 left" in seen


def sampled(interval=0.01):
    """Return a model that is sampled for 3 s."""
    model = cosim.Model("sampled", stop_time=3.0)
    x, samples = model.state("x", "1", 1.0, "state"), model.discrete("n", "1", 0, "samples")
    model.derivative(x, -x)
    model.every(interval, {samples: samples + 1})
    return model.freeze()


@pytest.mark.parametrize(("solver", "events"), [("dop853", 10_000), ("cvodes", 300)])
def test_run_with_many_events_shows_the_share_of_simulated_time(solver, events, monkeypatch):
    model = sampled(3.0 / events)
    terminal = shown_at_once(monkeypatch)
    with shown_on_terminal(False):
        run = cosim.simulate(model, solver=solver, output_interval=3.0)
    assert len(run.events) == events + 1
    shares = [int(share) for share in re.findall(r"events: (\d+) %", terminal.getvalue())]
    assert shares == sorted(shares)
    assert any(20 < share < 80 for share in shares)


@pytest.mark.slow
def test_coupled_run_shows_the_share_of_simulated_time(monkeypatch):
    system = cosim.couple({"a": sampled()}, {})
    terminal = shown_at_once(monkeypatch)
    with shown_on_terminal(False):
        system.simulate(stop_time=300.0, macro_step=0.001, output_interval=300.0)
    shares = [int(share) for share in re.findall(r"solving: (\d+) %", terminal.getvalue())]
    assert shares == sorted(shares)
    assert any(20 < share < 80 for share in shares)


def test_extremes_show_the_case_its_number_and_the_time_left(monkeypatch, capsys):
    terminal = shown_at_once(monkeypatch)
    cases = campaign.select_cases(["crank_shaft/driven"])[:3]
    monkeypatch.setattr(campaign, "select_cases", lambda *_, **__: cases)
    assert main(["extremes", "crank_shaft/driven"]) == 0
    seen = lines(terminal.getvalue())
    assert any(line.startswith(f"0/3 {cases[0].model}, {cases[0].name}") for line in seen)
    later = rf"[123]/3 {re.escape(cases[2].model)}, .*: \d+ % \d\d:\d\d, \d\d:\d\d left"
    assert any(re.fullmatch(later, line) for line in seen), seen
    assert "crank" in capsys.readouterr().out


AT_ONCE = f"from cosim.host import progress; progress.DELAY = progress.INTERVAL = 0.001; {LONG}"


@pytest.mark.slow
def test_crosscheck_shows_backends_on_a_terminal_and_nothing_in_a_pipe(tmp_path):
    words = ["crosscheck", "crank_shaft/driven", "--stop-time", "0.5"]
    command = [sys.executable, "-c", AT_ONCE, *words]
    code, output, text = on_a_terminal(command, tmp_path, NO_COLOR="1", COLUMNS="150")
    assert code == 0, text
    assert "fmu-cs" in output
    seen = "\n".join(lines(text))
    for what in ("native", "crank_shaft/driven", "export", "fmu-me", "running the FMU", "fmu-cs"):
        assert what in seen
    pipe = subprocess.run(
        command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=120
    )
    assert pipe.returncode == 0
    assert "\r" not in pipe.stderr
    assert "running" not in pipe.stderr


@pytest.mark.slow
def test_movie_shows_how_many_pictures_are_drawn(tmp_path, monkeypatch):
    terminal = shown_at_once(monkeypatch)
    run = cosim.simulate(spinning(1.0), stop_time=0.3, compiled=False)
    with shown_on_terminal(False):
        cosim.animate(run, tmp_path / "x.gif", dpi=20)
    assert re.search(r"drawing \d+ pictures: +\d+ %", terminal.getvalue())
