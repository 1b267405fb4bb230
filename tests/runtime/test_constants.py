"""Constants of the parameters of an instance follow from whatever sets parameters."""

import math

import fmpy
import pytest
from casadi import atan2, sin

import cosim
from casadi_models.dae import Model

DEFAULTS = {"k": 1.5, "a": 0.8}
LATER = {"k": 2.5, "a": 0.3}


def damped():
    """Return x' = -k^2 sin(a) z with 2 z = (k + 1) x: all coefficients are constants."""
    model = Model("damped", stop_time=1.0)
    x = model.state("x", "1", 1.0, "state")
    z = model.algebraic("z", "1", 1.0, "unknown")
    k, a = (model.parameter(name, "1", value, name) for name, value in DEFAULTS.items())
    model.derivative(x, -(k**2) * sin(a) * z)
    model.equation(2 * z - (k + 1) * x)
    model.output("y", "1", k**3 / sin(a) * x, "output")
    return model.freeze()


def expected(x, k, a):
    """Return x', z and y at a state."""
    z = (k + 1) * x / 2
    return [-(k**2) * math.sin(a) * z, z, k**3 / math.sin(a) * x]


def decayed(x, length, k, a):
    """Return x after a time, s."""
    return x * math.exp(length * expected(1.0, k, a)[0])


RESULTS = ("der(x)", "z", "y")


class Instance:
    """An FMU through FMPy's objects."""

    def __init__(self, path, kind):
        self.description = fmpy.read_model_description(str(path))
        self.second = self.description.fmiVersion.startswith("2")
        self.references = {v.name: v.valueReference for v in self.description.modelVariables}
        self.fmu = fmpy.instantiate_fmu(fmpy.extract(str(path)), self.description, kind)

    def begin(self, **values):
        if self.second:
            self.fmu.setupExperiment(startTime=0.0)
        self.fmu.enterInitializationMode(**({} if self.second else {"startTime": 0.0}))
        self.set(**values)
        self.fmu.exitInitializationMode()

    def set(self, **values):
        call = self.fmu.setReal if self.second else self.fmu.setFloat64
        if values:
            call([self.references[name] for name in values], [*values.values()])

    def get(self, *names):
        call = self.fmu.getReal if self.second else self.fmu.getFloat64
        return call([self.references[name] for name in names])

    def state(self):
        return self.fmu.getFMUstate() if self.second else self.fmu.getFMUState()

    def go_back(self, state):
        (self.fmu.setFMUstate if self.second else self.fmu.setFMUState)(state)

    def close(self):
        self.fmu.freeInstance()


@pytest.fixture(
    scope="module", params=[(2, "dop853"), (3, "dop853"), (3, "rosenbrock"), (3, "rk4")]
)
def path(request, tmp_path_factory):
    fmi, solver = request.param
    file = tmp_path_factory.mktemp("constants") / "damped.fmu"
    return cosim.export_fmu(damped(), file, fmi=fmi, solver=solver, tunable=[*DEFAULTS])


@pytest.fixture(params=["CoSimulation", "ModelExchange"])
def kind(request):
    return request.param


@pytest.fixture
def fmu(path, kind):
    opened = Instance(path, kind)
    yield opened
    opened.close()


@pytest.mark.quick_share(0.3)
def test_parameters_set_before_and_in_initialization_count(fmu):
    fmu.set(k=LATER["k"])
    fmu.begin(a=LATER["a"])
    assert fmu.get(*RESULTS) == pytest.approx(expected(1.0, **LATER), rel=1e-14)


def test_parameters_set_after_initialization_count_at_once(fmu):
    """In event mode, where model exchange begins, or between communication steps."""
    fmu.begin()
    assert fmu.get(*RESULTS) == pytest.approx(expected(1.0, **DEFAULTS), rel=1e-14)
    for name, value in LATER.items():
        fmu.set(**{name: value})
    assert fmu.get(*RESULTS) == pytest.approx(expected(1.0, **LATER), rel=1e-14)


def test_a_reset_brings_the_parameters_of_the_start_back(fmu):
    fmu.begin(**LATER)
    fmu.fmu.reset()
    fmu.begin()
    assert fmu.get(*RESULTS) == pytest.approx(expected(1.0, **DEFAULTS), rel=1e-14)


def test_a_restored_state_brings_its_parameters_back(fmu):
    fmu.begin()
    before = fmu.state()
    fmu.set(**LATER)
    after = fmu.state()
    for state, values in ((before, DEFAULTS), (after, LATER), (before, DEFAULTS)):
        fmu.go_back(state)
        assert fmu.get(*RESULTS) == pytest.approx(expected(1.0, **values), rel=1e-14)


def test_a_derivative_with_respect_to_a_parameter_counts_all_that_follows_from_it(fmu):
    fmu.begin()
    fmu.set(**LATER)
    references = [fmu.references[name] for name in RESULTS]
    given = [references, [fmu.references["k"]], [1.0]]
    k, a = LATER["k"], LATER["a"]
    exact = [-(3 * k**2 + 2 * k) * math.sin(a) / 2, 0.5, 3 * k**2 / math.sin(a)]
    assert list(fmu.fmu.getDirectionalDerivative(*given)) == pytest.approx(exact, rel=1e-13)


def test_a_parameter_of_minus_0_renews_what_follows_from_it(tmp_path):
    model = Model("side", stop_time=1.0)
    a = model.parameter("a", "1", 0.0, "a")
    x = model.state("x", "1", 1.0, "state")
    model.derivative(x, atan2(a, -1) * x)
    file = cosim.export_fmu(model.freeze(), tmp_path / "side.fmu", fmi=2, tunable=["a"])
    fmu = Instance(file, "ModelExchange")
    fmu.begin()
    for value, angle in ((0.0, math.pi), (-0.0, -math.pi), (0.0, math.pi)):
        fmu.set(a=value)
        assert fmu.get("der(x)") == pytest.approx([angle], rel=1e-15)
    fmu.close()


@pytest.mark.parametrize("kind", ["CoSimulation"], indirect=True)
def test_steps_go_on_with_tuned_parameters_as_a_native_run_does(fmu):
    fmu.begin()
    fmu.fmu.doStep(0.0, 0.25)
    half = decayed(1.0, 0.25, **DEFAULTS)
    assert fmu.get("x") == pytest.approx([half], rel=1e-7)
    state = fmu.state()
    fmu.set(**LATER)
    fmu.fmu.doStep(0.25, 0.5)
    tuned = fmu.get("x", "y")
    run = cosim.simulate(damped(), start_values={"x": half, **LATER}, output_times=[0.0, 0.5])
    assert tuned == pytest.approx([run["x"][-1], run["y"][-1]], rel=1e-6)
    fmu.go_back(state)
    fmu.fmu.doStep(0.25, 0.5)
    assert fmu.get("x") == pytest.approx([decayed(half, 0.5, **DEFAULTS)], rel=1e-6)


def test_instances_with_different_parameters_do_not_share_constants(path, kind):
    one, other = Instance(path, kind), Instance(path, kind)
    one.begin()
    other.begin(**LATER)
    assert one.get(*RESULTS) == pytest.approx(expected(1.0, **DEFAULTS), rel=1e-14)
    assert other.get(*RESULTS) == pytest.approx(expected(1.0, **LATER), rel=1e-14)
    one.close()
    other.close()
