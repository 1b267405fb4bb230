"""Errors of the command line: one sentence, before anything is computed or written.

Exit codes: 2 wrong usage, 3 unknown name; 1 a file that cannot be.
"""

import re

import pytest

from cosim.cli.main import main


@pytest.fixture
def refused(capsys, monkeypatch, tmp_path):
    """Return a function that runs a command line which must fail without computing anything.

    It takes the line, the exit code, and a pattern of the message.
    """
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("cosim.integrate.nominal.call", lambda *_: pytest.fail("it ran"))

    def run(line, code, expected):
        try:
            found = main(line.split())
        except SystemExit as end:  # of argparse
            found = end.code
        printed = capsys.readouterr()
        assert found == code, printed.err
        assert printed.out == ""
        assert len(printed.err.splitlines()) == 1, printed.err  # one sentence, no traceback
        assert not list(tmp_path.iterdir())
        assert re.search(expected, printed.err), printed.err

    return run


# -- what is not understood: 2 --------------------------------------------------------------------


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("", "the following arguments are required: VERB; see: cosim --help"),
        ("simlate bicycle", "no verb 'simlate'; did you mean simulate[?]; see: cosim --help"),
        ("zz", "cosim: there is no verb 'zz'; see: cosim --help"),
        ("simulate crank_shaft -o out.", "out.: give a name with .csv or .mat or .json"),
        ("sweep crank_shaft -o a.b.", "a.b.: give a name with .csv"),
        ("tradeoff bicycle --output-file a.txt", "a.txt: give a name with .csv or .json;"),
        ("tradeoff bicycle -o a.png", "with .csv or .json, or draw with --figure a.png"),
        ("extremes crank_shaft -o a.pdf", "with .csv, or draw with --figure a.pdf"),
        ("sweep crank_shaft -o a.png", "a.png: give a name with .csv; see"),
        ("simulate", "required: MODEL|SCENE.toml|FILE.fmu; see: cosim simulate --help"),
        ("simulate bicycle --stop-time \x1b[31m1", r"invalid float value: '\\x1b\[31m1'"),
        ("extremes own.py:build", "has no extreme cases"),
        ("plot bicycle --size 0x0 -o a.png", "cannot have 0 x 0 pixels; change its size or dpi"),
        ("plot bicycle --dpi 0 -o a.png", "cannot have 0 x 0 pixels"),
        ("animate bicycle --size=-1x-1 -o a.gif", "cannot have -120 x -120 pixels"),
        ("animate bicycle --size 1e5x1e5 -o a.png", "cannot have 1.2e[+]07 x 1.2e[+]07 pixels"),
        ("simulate bicycle --frob", "cannot take '--frob'; see: cosim simulate --help"),
        ("simulate bicycle --inputs a.csv", "write --input-file or --input; see"),
        ("simulate bicycle crank_shaft", "cannot take 'crank_shaft'; see"),
        ("simulate bicycle --outputs phi delta", "write a list with commas: phi,delta; see"),
        ("export bicycle --platform win64 linux64", "commas: win64,linux64; see"),
        ("simulate bicycle --stop-time 5 s", "write the unit without a blank: 5s; see"),
        ("simulate bicycle -p phi_dot=30 deg/s", "without a blank: phi_dot=30deg/s; see"),
        ("simulate bicycle -p phi = 3", "cannot take '='; write no blanks around it, or put"),
        ("simulate bicycle --stop-when phi>45deg && t>1", "'&&'; write no blanks around it, or"),
        ("simulate bicycle --rtol 1e-6", "'--rtol'; write --relative-tolerance; see"),
        ("sensitivity bicycle --outputs phi --parameters mA", "write --by or -p; see"),
        ("run bicycle", "there is no verb 'run'; write simulate; see"),
        ("simulate bicycle -p phi_dot=30deg", "not the same kind of unit; fitting: rad/s, deg/s"),
        ("sweep bicycle --design sobol:8 -p phi_dot=0.1,0.2", "a design needs A:B, a distrib"),
        ("simulate bicycle --input steer_torque=2sin(t)", r"write \* between factors, as in 2"),
        ("simulate bicycle --input steer_torque=math.sin(t)", r"write sin\(...\) instead of math"),
        ("simulate bicycle --stop-when phi=45deg", "write <, > or, for discrete variables, =="),
        ("simulate bicycle --input steer_torque=t>1?2:0", r"write where\(t > 1, 2, 0\)"),
        ("simulate bicycle --stop-time soon", "--stop-time: invalid float value: 'soon'"),
        ("simulate bicycle --stop-time 1,5", "--stop-time: invalid float value: '1,5'"),
        ("simulate bicycle --solver", "--solver: expected one argument"),
        ("simulate bicycle -p mA", "-p mA: write NAME=VALUE"),
        ("tradeoff bicycle --repeats -1", "repeats = -1; give a whole number, 0 or more"),
        ("tradeoff bicycle --repeats 1.5", "--repeats: invalid int value: '1.5'"),
        ("simulate bicycle -p phi=1 -p phi=2", "phi is given twice"),
        ("simulate bicycle -p phi=1 --start-values phi 2", "phi is given twice"),
        ("simulate bicycle --start-values phi", "'phi' has no value; give NAME VALUE pairs"),
        ("simulate bicycle --interface-type CoSimulation", "--interface-type is for FMU files"),
        ("simulate bicycle --step-size 0.1", "cvodes chooses its own steps"),
        ("simulate bicycle --solver rk4 --relative-tolerance 1e-3", "rk4 has no error control"),
        ("simulate bicycle --solver ode8 --absolute-tolerance 1", "ode8 has no error control"),
        ("simulate bicycle/multipliers --solver erk", "erk cannot integrate; use idas"),
        ("simulate bicycle --outputs phi,phi", "output 'phi' is named twice"),
        ("simulate bicycle --units book --json", "JSON is in SI units; use CSV"),
        ("simulate swing.py", "name the function that builds it, too, as PATH.py:FUNCTION"),
        ("export bicycle.fmu", "an FMU is taken by simulate, crosscheck and plot"),
        ("plot bicycle", "there is no screen for a window; name a file with --output-file"),
        ("plot bicycle.fmu --output-file a.png --compare fmu", "an FMU has one backend only"),
        ("simulate bicycle.fmu --solver idas", "--solver is for models"),
        ("fit bicycle.fmu record.csv --free g --solver idas", "--solver is for models"),
        ("simulate bicycle.fmu --backend native-interpreted", "--backend is for models"),
        ("simulate bicycle --timeout 0", "--timeout: 0 is not a positive time"),
        (
            "sweep bicycle -p g=1,2 -o -",
            "- names no file; give a name with .csv, or leave the option",
        ),
        (
            "export bicycle -o -",
            "- names no file; give a name with .fmu or .ssp, or leave the option",
        ),
        ("simulate bicycle.fmu -p phi=3deg", "phi = 3deg: give a number in the FMU's own unit"),
    ],
)
def test_wrong_usage_is_reported_with_the_remedy(line, expected, refused):
    refused(line, 2, expected)


# -- numbers that make no sense: 2 ----------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("--stop-time nan", "--stop-time = nan is not finite"),
        ("--stop-time inf", "--stop-time = inf is not finite"),
        ("--stop-time -1", "--stop-time = -1 s lies before start_time = 0 s; give a later stop"),
        ("--start-time 5 --stop-time 4", "--stop-time = 4 s lies before --start-time = 5 s"),
        ("--start-time nan", "--start-time = nan is not finite"),
        ("--at -1", "time 1 .-1 s. is not after the one .*; give times that increase from 0 s on"),
        ("--output-interval 0", "--output-interval = 0.0 is not positive"),
        ("--output-interval -1", "--output-interval = -1.0 is not positive"),
        ("--output-interval nan", "--output-interval = nan is not finite"),
        ("--output-interval 1e-300", "output times of .* GB; give a larger one"),
        ("--relative-tolerance nan", "--relative-tolerance = nan is not finite"),
        ("--relative-tolerance -1", "--relative-tolerance = -1 is not within"),
        ("--relative-tolerance 1e-20", "--relative-tolerance = 1e-20 is not within"),
        ("--relative-tolerance 2", "--relative-tolerance = 2 is not within"),
        ("--relative-tolerance 0", "both tolerances are 0"),
        ("--absolute-tolerance -1", "--absolute-tolerance = -1 is negative"),
        ("--absolute-tolerance 1e300", r"--absolute-tolerance = 1e\+300 is above 0.1"),
        ("--accuracy 1mm", "accuracy of phi = 1mm: 'mm' cannot be converted to 'rad'"),
        ("--absolute-tolerance 1e400", "--absolute-tolerance = inf is not finite"),
        ("--solver rk4 --step-size 0", "--step-size = 0.0 is not positive"),
        ("--solver rk4 --step-size nan", "--step-size = nan is not finite"),
        ("--solver rk4 --step-size 1e-300", "makes more than .* steps; give a larger one"),
        ("--accuracy -1", "accuracy = -1.0 is not positive"),
        ("--budget nan", "budget = nan is not finite"),
        ("-p mA=nan", r"mA \[kg\] = nan is not finite"),
        ("-p mA=inf", r"mA \[kg\] = inf is not finite"),
        ("-p mA=-1", "mA = -1 kg is out of its range 2e-12 ... 2e.12 kg; give a value within"),
        ("-p mA=1e308", "mA = 1e.308 kg is out of its range"),
        ("-p mA=5e-324", "mA = 4.94066e-324 kg is out of its range"),
        ("-p mA=", "mA: '' is not a number with a unit; write e.g. 1.5kg"),
        ("-p mA=True", "mA: 'True' is not a number with a unit"),
        ("-p mA=1,5", "mA = 1,5: write a decimal point"),
        ("-p mA=1m", "mA = 1m: 'm' cannot be converted to 'kg'"),
        ("-p mA=1stone", "mA = 1stone: unit 'stone' is unknown; fitting: kg, g, slug"),
        ("-p IBxz=100", "inertia of rear frame has principal moments .*, which no body has"),
        ("-p steer_torque=nan", "steer_torque .* = nan is not finite"),
        ("--start-values phi soon", "phi: 'soon' is not a number with a unit"),
    ],
)
def test_invalid_number_is_rejected_with_its_name_value_and_rule(words, expected, refused):
    refused(f"simulate bicycle {words}", 2, expected)


@pytest.mark.parametrize(
    "line",
    [
        "crosscheck crank_shaft --bound -1",
        "crosscheck crank_shaft --bound nan",
        "crosscheck crank_shaft --stop-time -1",
        "crosscheck crank_shaft --stop-time inf",
        "crosscheck crank_shaft --output-interval 0",
        "crosscheck crank_shaft --relative-tolerance 7",
        "extremes crank_shaft --timeout 0",
        "extremes crank_shaft --timeout nan",
        "tradeoff crank_shaft --stop-time nan",
        "plot crank_shaft --stop-time nan --output-file a.png",
    ],
)
def test_other_verbs_reject_invalid_numbers(line, refused):
    refused(line, 2, "^ParameterError: ")


# -- names that do not exist: 3 -------------------------------------------------------------------


@pytest.mark.slow_rows(
    "simulate bicycle --outputs Phi-no output 'Phi'; did you mean phi",
    "simulate bicycle --outputs phi,-no output ''",
    "export bicycle --outputs speeed-no output 'speeed'; did you mean speed",
)
@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("simulate Bicycle", "no model 'Bicycle'; did you mean bicycle. .all: cosim info"),
        ("info bycicle", "no model 'bycicle'; did you mean bicycle"),
        ("export bike", "no model 'bike'; "),
        ("simulate ..", "no model '..'; it has crank_shaft, bar_on_frame, bicycle"),
        ("simulate %n%s", "no model '%n%s'; it has crank_shaft"),
        ("simulate bicycle/book/x", "no formulation 'book/x'; did you mean book"),
        ("simulate bicycle/", "no formulation ''; it has independent, book, multipliers"),
        ("simulate bicycle --backend=", "no backend ''; it has native, native-interpreted"),
        ("sensitivity bicycle --by=", "has no .* ''"),
        ("plot crank_sahft --output-file a.png", "no model 'crank_sahft'; did you mean crank"),
        ("crosscheck bicicle", "no model 'bicicle'; did you mean bicycle"),
        ("tradeoff bicicle", "no model 'bicicle'; did you mean bicycle"),
        ("extremes bicicle", "no model 'bicicle'; did you mean bicycle"),
        ("simulate bicycle.tml", "no model 'bicycle.tml'; did you mean bicycle"),
        ("simulate bar_teta.toml", "no scene 'bar_teta.toml'; did you mean bar_theta.toml"),
        ("simulate bicycle --outputs Phi", "no output 'Phi'; did you mean phi"),
        ("simulate bicycle --outputs phi,", "no output ''"),
        ("simulate bicycle --outputs=", "no output ''"),
        ("simulate bar_on_frame --outputs frame_shift_1", "; bar_on_frame/two_body does"),
        ("export bicycle --outputs speeed", "no output 'speeed'; did you mean speed"),
        ("simulate bicycle -p ma=1", "no state, parameter or input 'ma'; did you mean mA"),
        ("simulate bicycle -p =1", "no state, parameter or input ''"),
        ("simulate bicycle -p fz_P=1", "'fz_P' is a result of the model and cannot be set"),
        ("simulate bicycle --start-values phi_dott 1", "did you mean phi_dot"),
        ("simulate bicycle --solver CVODES", "no solver 'CVODES'; did you mean cvodes"),
        ("export crank_shaft --solver cvodes", "FMU has no solver 'cvodes'; choose one of dop853"),
        ("simulate bicycle --solver=", "no solver ''; it has cvodes"),
        ("simulate bicycle --on-invalid explode", "'explode'; it has warn, stop, ignore"),
        ("simulate bicycle --drift-control projektion", "did you mean projection"),
        ("simulate bicycle --backend fmu-mee", "no backend 'fmu-mee'; did you mean fmu-me"),
        ("export bicycle --fmi 4", "no FMI version '4'; it has 2, 3"),
        ("export bicycle --platform win32", "no platform 'win32'; did you mean win64"),
        ("export bicycle --platform=", "no platform ''; it has native, all"),
        ("plot bicycle --output-file a.jpg", "no picture format 'jpg'; did you mean png"),
        ("plot bicycle --output-file a.png --compare multiplier", "did you mean multipliers"),
        ("tradeoff bicycle --figure a.bmp", "no picture format 'bmp'"),
        ("extremes crank_shaft --figure a.bmp", "no picture format 'bmp'"),
    ],
)
def test_unknown_name_is_reported_with_the_nearest_name(line, expected, refused):
    refused(line, 3, expected)


@pytest.mark.parametrize(
    "line",
    [
        "sweep crank_shaft -p omega=100,200,300rpm",
        "sweep crank_shaft -p omega=100:300rpm:3",
        "sweep crank_shaft --design lhs:4 -p omega=10:200rpm",
        "sweep crank_shaft --design lhs:4 -p omega=loguniform(1,100rpm)",
        "plot bar_on_frame -p theta=10,20,30deg -o a.png",
        "simulate crank_shaft --at 100,200,300ms",
        "tradeoff crank_shaft --steps 1,2,5ms",
        "linearize bicycle --along speed=10:20km/h:5",
    ],
)
def test_list_whose_last_number_alone_has_a_unit_is_rejected(line, refused):
    refused(line, 2, "has no unit and .* has one; write the unit at each")


@pytest.mark.parametrize("other", ["--input", "-p"])
def test_formula_that_is_given_twice_is_rejected(other, refused):
    line = f"simulate bicycle --input roll_torque=1 {other} roll_torque=2"
    refused(line, 2, "UsageError: roll_torque is given twice; give it once")


@pytest.mark.parametrize("other", ["--input", "-p"])
def test_column_of_what_has_a_value_too_is_rejected(other, tmp_path, capsys):
    (tmp_path / "a.csv").write_text("time,roll_torque\n0,1\n1,2\n")
    file = str(tmp_path / "a.csv")
    assert main(["simulate", "bicycle", "--input-file", file, other, "roll_torque=2"]) == 2
    told = capsys.readouterr()
    assert (told.out, told.err) == ("", "UsageError: roll_torque is given twice; give it once\n")


def test_calculated_start_is_rejected_with_the_names_that_can_be_set(refused):
    expected = "the start of theta is calculated.*set some of phi, delta, w"
    refused("simulate bicycle -p theta=1", 1, expected)


# -- files that cannot be written: 1 --------------------------------------------------------------


@pytest.mark.parametrize(
    "line",
    [
        "simulate bicycle --output-file none/a.csv",
        "simulate bicycle --output-file=",
        "export bicycle -o none/a.fmu",
        "plot bicycle --output-file none/a.png",
        "tradeoff bicycle --output-file none/a.csv",
        "tradeoff bicycle --figure none/a.png",
        "extremes --output-file none/a.csv",
        "extremes --figure none/a.png",
    ],
)
def test_impossible_output_file_is_reported_before_any_computation(line, refused):
    refused(line, 1, "^ExportError: cannot write ")


# -- files whose ending stands for another format: 2 ----------------------------------------------


@pytest.mark.parametrize(
    ("line", "endings"),
    [
        ("simulate crank_shaft -o x.xlsx", r"\.csv or \.mat or \.json"),
        ("simulate crank_shaft --json -o x.mat", r"\.json is for --json"),
        ("simulate crank_shaft -o x.json", r"\.json is for --json"),
        ("simulate crank_shaft --json -o x.csv", r"\.json is for --json"),
        ("export crank_shaft -o x.zip", r"\.fmu"),
        ("linearize crank_shaft -o eig.png", r"\.csv"),
        ("sensitivity crank_shaft -o x.txt", r"\.csv"),
        ("extremes crank_shaft -o x.txt", r"\.csv"),
        ("sweep crank_shaft -p omega=1:2:2 -o x.parquet", r"\.csv"),
    ],
)
def test_ending_that_a_verb_does_not_write_is_rejected(line, endings, refused):
    refused(line, 2, endings)


# -- messages that say what to write: 2 -----------------------------------------------------------


@pytest.mark.parametrize(
    ("line", "remedy"),
    [
        (["simulate", "crank_shaft", "--at", "1,2", "--output-interval", "0.1"],
         "--at sets all output times; leave out --output-interval"),
        (["simulate", "crank_shaft", "--at", "1,2", "--stop-time", "3"],
         "--at sets all output times; leave out --stop-time"),
        (["simulate", "crank_shaft", "--stop-when", "phi > 1 & omega > 1"], "write `and` for &"),
        (["simulate", "crank_shaft", "--stop-when", "phi > 1 && omega > 1"], "write `and` for &"),
        (["simulate", "crank_shaft", "--stop-when", "step(phi) > 1"], "write where(t > 1, 2, 0)"),
        (["simulate", "crank_shaft", "--stop-when", "if(phi>1,2,0) > 1"], "write where(t > 1"),
        (["simulate", "crank_shaft", "--stop-when", "phi.^2 > 1"], "write *, / and ^ without a p"),
        (["simulate", "crank_shaft", "--step-size", "0.1"], "leave --step-size out or use rk4"),
        (["animate", "crank_shaft", "--at", "1", "-o", "x.gif"], "name a .png, not a .gif"),
        (["animate", "crank_shaft", "--stop-time", "0", "--live", "-o", "x.html"],
         "--stop-time = 0 s is the start of the run; give a later one"),
        (["tradeoff", "crank_shaft", "--start-time", "2", "--stop-time", "2"],
         "--stop-time = 2 s is the start of the run; give a later one"),
        (["linearize", "bicycle", "--sweep", "thetaR_dot=-3:-30:3"], "write --along"),
        (["sweep", "bicycle", "--vary", "phi_dot=0:1:3"], "write -p;"),
        (["linearize", "bicycle", "--vary", "phi"], "write --along or -p;"),
        (["simulate", "bicycle", "p"], "did you mean -p?"),
        (["simulate", "bicycle", "--outputs", "phi", "p"], "write a list with commas: phi,p;"),
        (["simulate", "bicycle", "--dt", "0.1"], "write --output-interval;"),
        (["simulate", "bicycle", "--t-end", "5"], "write --stop-time;"),
        (["simulate", "bicycle", "--tol=1e-6"], "write --relative-tolerance;"),
        (["simulate", "bicycle", "--rtol", "1e-6"], "write --relative-tolerance;"),
        (["simulate", "bicycle", "--atol", "1e-6"], "write --absolute-tolerance;"),
        (["simulate", "bicycle", "--x0", "phi=1"], "write --start-values;"),
        (["simulate", "crank_shaft", "--outputs", "phi,", "omega"],
         "write a list without blanks: phi,omega"),
        (["simulate", "crank_shaft", "-p", "alpha=1", "omega=2"], "repeat the option: -p omega=2"),
        (["-q", "simulate", "crank_shaft"], "cannot take '-q'; write it after the verb;"),
        (["--json", "info"], "cannot take '--json'; write it after the verb;"),
    ],
)  # fmt: skip
def test_message_says_what_to_write_instead(line, remedy, capsys):
    try:
        code = main(line)
    except SystemExit as ended:
        code = ended.code
    assert code in (2, 3)
    assert remedy in capsys.readouterr().err
