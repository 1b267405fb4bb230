"""`cosim fit`: the command, and the scene that it writes."""

import json

import numpy as np
import pytest
from helpers.measured_decay import DECAY, TIMES, noisy, record

import cosim
from cosim.cli.main import main
from cosim.errors import UsageError
from cosim.study.fit.fit import fit


def test_command_fits_a_german_csv_file_and_writes_a_scene(tmp_path, capsys):
    times = np.linspace(0, 1, 21)
    rows = [f"{1000 * t - 500:.3f};{np.degrees(50 * t + 5 * t * t):.9f}" for t in times]
    text = "Zeit [ms];Winkel [deg]\n" + "\n".join(rows).replace(".", ",") + "\n"
    data, scene, picture = (tmp_path / name for name in ("d.csv", "fitted.toml", "fit.png"))
    data.write_text(text)
    words = ["fit", "crank_shaft", str(data), "-p", "alpha=1rad/s2:50rad/s2", "--free", "omega"]
    words += ["--column", "phi=Winkel", "--time", "Zeit", "--time-offset=500ms"]
    assert main([*words, "-o", str(scene), "--figure", str(picture)]) == 0
    shown = capsys.readouterr()
    assert "2 values fitted to 21 measured ones" in shown.out
    assert picture.stat().st_size > 1000
    fitted = cosim.read_scene(scene).request.values
    assert fitted == pytest.approx({"alpha": 10.0, "omega": 50.0}, rel=1e-6)
    assert main([*words, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["rank"] == 2


OWN = """
import cosim
def build():
    model = cosim.Model("drop")
    x, a = model.state("x", "m", 1.0, "x"), model.parameter("a", "m/s", 1.0, "rate")
    model.derivative(x, a)
    return model.freeze()
"""


def test_command_takes_the_solver_of_a_scene_and_ends_series_of_what_it_sets(
    tmp_path, capsys, monkeypatch
):
    used = []

    def noted(*given, **settings):
        used.append(settings["solver"])
        return fit(*given, **settings)

    monkeypatch.setattr("cosim.cli.verbs.fit.fit", noted)
    (tmp_path / "drop.py").write_text(
        OWN.replace("a)\n", 'a * (0.5 - x) + model.input("u", "m/s", 0.0, "u"))\n')
    )
    (tmp_path / "u.csv").write_text("time,u\n0,0\n2,1\n")
    scene = tmp_path / "driven.toml"
    scene.write_text(
        'model = "drop.py:build"\n[inputs]\nfile = "u.csv"\n[run]\nsolver = "cvodes_adams"\n'
    )
    dae = cosim.load(f"{tmp_path / 'drop.py'}:build")
    run = cosim.simulate(dae, start_values={"a": 2.0, "u": 0.3}, output_times=TIMES)
    run.to_csv(tmp_path / "data.csv")
    for given in ("u=0.3", "u=0:1"):
        words = ["fit", str(scene), str(tmp_path / "data.csv"), "-p", "a=0.1:10", "-p", given]
        assert main([*words, "--json"]) == 0
        found = json.loads(capsys.readouterr().out)
        assert found["values"]["a"] == pytest.approx(2.0, rel=1e-6)
    assert used == ["cvodes_adams"] * 2


def test_command_begins_free_values_where_they_are_set(tmp_path, capsys, monkeypatch):
    begun = []

    def noted(*given, parameters, **settings):
        begun.append(parameters)
        return fit(*given, parameters=parameters, **settings)

    monkeypatch.setattr("cosim.cli.verbs.fit.fit", noted)
    cosim.simulate("crank_shaft", stop_time=0.1, outputs=["phi"]).to_csv(tmp_path / "data.csv")
    scene = tmp_path / "fast.toml"
    scene.write_text('model = "crank_shaft"\n[start]\nomega = 70.0\n')
    words = ["fit", str(scene), str(tmp_path / "data.csv")]
    assert main([*words, "--free", "omega,alpha", "-p", "alpha=4"]) == 0
    assert begun == [{"omega": 70.0, "alpha": 4.0}]  # before: None, of the model
    assert main([*words, "-p", "alpha=1:20", "-p", "alpha=4"]) == 2
    assert "alpha is given twice" in capsys.readouterr().err


def test_scene_of_a_fitted_model_of_the_user_names_its_file(tmp_path, capsys):
    (tmp_path / "own.py").write_text(OWN)
    (tmp_path / "d.csv").write_text("time,x\n0,2\n1,5\n2,8\n3,11\n")
    (tmp_path / "below").mkdir()
    first, second = tmp_path / "first.toml", tmp_path / "below" / "second.toml"
    words = ["--free", "x,a", "-o"]
    assert main(["fit", f"{tmp_path}/own.py:build", f"{tmp_path}/d.csv", *words, str(first)]) == 0
    assert main(["fit", str(first), f"{tmp_path}/d.csv", *words, str(second)]) == 0
    assert 'model = "own.py:build"' in first.read_text()
    assert 'model = "../own.py:build"' in second.read_text()
    for scene in (first, second):
        assert cosim.read_scene(scene).request.values == pytest.approx({"x": 2.0, "a": 3.0})
    found = fit(DECAY, noisy(0), ["k"])
    with pytest.raises(UsageError, match=r"decay: a scene names its model; give model="):
        found.write_scene(tmp_path / "third.toml")


def test_scene_of_a_fitted_system_is_read_from_any_folder(tmp_path):
    folder = tmp_path / "\U0001f600"
    folder.mkdir()
    code = OWN.replace(
        "return model.freeze()", "return cosim.couple({'m': model.freeze()}, {}).dae"
    )
    (folder / "own.py").write_text(code)
    measured = record({"m.x": 1 + 3 * TIMES})
    found = fit(f"{folder / 'own.py'}:build", measured, ["m.a"])
    found.write_scene(tmp_path / "fitted.toml")
    scene = cosim.read_scene(tmp_path / "fitted.toml")
    assert scene.request.values == pytest.approx({"m.a": 3.0})


def test_command_rejects_a_scene_that_does_not_begin_at_0(tmp_path, capsys):
    scene, data = tmp_path / "late.toml", tmp_path / "d.csv"
    scene.write_text('model = "crank_shaft"\n[run]\nstart_time = 2.0\nstop_time = 3.0\n')
    data.write_text("time [s],phi [rad]\n2.0,0.0\n2.5,1.0\n3.0,2.0\n")
    assert main(["fit", str(scene), str(data), "--free", "alpha"]) == 2
    text = capsys.readouterr().err
    assert "begins at 2 s, but the runs of a fit begin at 0 s; set its start_time to 0" in text


def test_command_names_what_a_written_scene_does_not_hold(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.py").write_text(PUSHED)
    (tmp_path / "force.csv").write_text("time,force\n0,1\n3,1\n")
    run = '[run]\nstop_time = 2.0\nsolver = "erk"\n'
    series = 'model = "own.py:build"\noutputs = ["x"]\n[inputs]\nfile = "force.csv"\n'
    (tmp_path / "in.toml").write_text(series + run)
    (tmp_path / "d.csv").write_text("time,x\n0,2\n1,1.4\n2,1.1\n")
    assert main(["fit", "in.toml", "d.csv", "--free", "x", "-o", "out.toml"]) == 0
    expected = "it holds values only; add the inputs, run of in"
    assert expected in capsys.readouterr().err
    assert main(["fit", "own.py:build", "d.csv", "--free", "x", "-o", "out.toml"]) == 0
    assert "holds values only" not in capsys.readouterr().err


@pytest.mark.parametrize("speed", [np.float64(50.0), np.int64(50)])
def test_scene_holds_start_values_of_any_type(tmp_path, speed):
    measured = cosim.simulate("crank_shaft", stop_time=1, outputs=["phi"])
    found = fit("crank_shaft", measured, {"alpha": (1.0, 50.0)}, start_values={"omega": speed})
    found.write_scene(tmp_path / "own.toml")
    values = cosim.read_scene(tmp_path / "own.toml").request.values
    assert values == pytest.approx({"alpha": 10.0, "omega": 50.0}, rel=1e-6)


PUSHED = """
import cosim

def build():
    model = cosim.Model("pushed")
    x, force = model.state("x", "m", 0.0, "x"), model.input("force", "m/s", 0.5, "force")
    model.derivative(x, force - x)
    model.output("twice", "m", 2 * x, "twice x")
    model.start_through(x, "twice")
    return model.freeze()
"""


def test_scene_has_inputs_and_alternative_start_values_where_they_are_read(tmp_path):
    (tmp_path / "own.py").write_text(PUSHED)
    measured = record({"x": 2 + np.exp(-TIMES)})
    given = {"twice": 6.0}  # x = 3
    found = fit(f"{tmp_path}/own.py:build", measured, {"force": 1.0}, start_values=given)
    found.write_scene(tmp_path / "own.toml")
    values = cosim.read_scene(tmp_path / "own.toml").request.values
    assert values == pytest.approx({"force": 2.0, "twice": 6.0}, rel=1e-6)


def test_command_draws_measurements_over_a_run(tmp_path):
    data, picture = tmp_path / "d.csv", tmp_path / "d.png"
    data.write_text("time;angle\n0;0\n0,5;25\n")
    words = [
        "plot",
        "crank_shaft",
        "--data",
        str(data),
        "--column",
        "phi=angle",
        "-o",
        str(picture),
    ]
    assert main(words) == 0
    assert picture.stat().st_size > 1000
    assert main([*words[:2], "bicycle", *words[2:]]) == 2
