"""What a model looks like: declared by name, checked at freeze, free of charge."""

import pickle

import casadi as ca
import pytest
from casadi import SX

import casadi_models
from casadi_models.dae import Model
from casadi_models.mechanics.rotations import about
from cosim.model.catalogue import loaded
from cosim.model.reduction import reduce


def swing() -> Model:
    """Return a pendulum in a plane, its equations complete, without a drawing."""
    model = Model("swing", description="swing", source="a test", stop_time=1.0)
    angle = model.state("angle", "rad", 0.5, "angle from the vertical")
    rate = model.state("rate", "rad/s", 0.0, "its rate")
    length = model.parameter("length", "m", 2.0, "length", positive=True)
    model.derivative(ca.vertcat(angle, rate), ca.vertcat(rate, -9.81 / length * ca.sin(angle)))
    model.output("pull", "N", 9.81 * ca.cos(angle), "force in the rod")
    return model


def drawn(model: Model) -> Model:
    angle, length = model.named("angle"), model.named("length")
    turn = about(2, angle)
    model.body("rod", SX.zeros(3), turn)
    model.rod("bar", (SX.zeros(3), ca.vertcat(0, 0, -length)), 0.1, body="rod")
    model.arrow("pull", SX.zeros(3), turn @ ca.vertcat(0, 0, model.named("pull")), "on the hook")
    model.trace("tip", turn @ ca.vertcat(0, 0, -length))
    return model


@pytest.mark.parametrize("name", casadi_models.CATALOG)
def test_every_formulation_shows_the_scene_of_its_system(name):
    drawing = loaded(name).drawing
    first = loaded(name.partition("/")[0]).drawing
    for group in ("bodies", "shapes", "arrows", "traces"):
        items = [(item.name, *map(str, _expressions(item))) for item in getattr(drawing, group)]
        assert items
        assert items == [
            (item.name, *map(str, _expressions(item))) for item in getattr(first, group)
        ]
    assert drawing.world == first.world


def test_drawing_adds_no_operation_and_no_variable():
    plain, shown = swing().freeze(), drawn(swing()).freeze()
    assert shown.drawing
    assert not plain.drawing
    assert shown.operations(with_outputs=True) == plain.operations(with_outputs=True)
    assert shown.variables == plain.variables


def test_reduced_model_keeps_its_drawing_and_the_values_of_frozen_parameters():
    small = reduce(drawn(swing()).freeze(), ["angle"], freeze=["length"])
    assert small.drawing.numbers["length"] == 2.0
    assert [body.name for body in small.drawing.bodies] == ["world", "rod"]


def test_drawing_survives_a_pickle():
    drawing = drawn(swing()).freeze().drawing.with_numbers({"length": 3.0})
    again = pickle.loads(pickle.dumps(drawing))
    assert again.numbers == drawing.numbers
    assert again.world == drawing.world
    for group in ("bodies", "shapes", "arrows", "traces"):
        for one, other in zip(getattr(drawing, group), getattr(again, group), strict=True):
            assert one.name == other.name
            for a, b in zip(_expressions(one), _expressions(other), strict=True):
                symbols = sorted({s.name() for s in ca.symvar(a)})
                values = {name: 0.1 + 0.3 * i for i, name in enumerate(symbols)}
                assert _value(a, values) == _value(b, values)


@pytest.mark.parametrize(
    ("declare", "told"),
    [
        (lambda m: m.body("a", (0, 0)), "place of 'a' has shape (2, 1); give shape (3, 1)"),
        (lambda m: m.body("a", m), "give an SX expression"),
        (lambda m: m.body("a/b!", (0, 0, 0)), "cannot name a body"),
        (lambda m: [m.body("a", (0, 0, 0)) for _ in "12"], "body 'a' is declared twice"),
        (lambda m: m.shape("s", "cube", 1.0), "no kind 'cube'; there are box, cylinder"),
        (lambda m: m.shape("s", "box", (1, 2)), "2 numbers; a box has length along 1"),
        (lambda m: m.shape("s", "line", (1, 2, 3)), "a line has two or more points (3, n)"),
        (lambda m: m.shape("s", "sphere", 1.0, body="x"), "there is no body 'x'"),
        (lambda m: m.shape("s", "sphere", 1.0, color="red"), "write it as '#rrggbb'"),
        (lambda m: m.arrow("f", (0, 0, 0), (0, 0, 1), "a force", unit="lightyear"), "lightyear"),
        (lambda m: m.world(up=(0, 0, 0)), "up is (0, 0, 0); give a direction"),
        (lambda m: m.world(axes=("x", "y")), "give three names"),
    ],
)
def test_declaration_that_cannot_be_drawn_is_refused(declare, told):
    with pytest.raises(ValueError, match=r"^swing: ") as refusal:
        declare(swing())
    assert told in str(refusal.value)


@pytest.mark.parametrize(
    ("declare", "told"),
    [
        (
            lambda m: m.trace("t", ca.vertcat(m.named("angel"), 0, 0)),
            "needs 'angel', which the model",
        ),
        (lambda m: m.trace("t", ca.vertcat(SX.sym("far"), 0, 0)), "trace 't' uses 'far'"),
        (lambda m: m.shape("s", "sphere", m.named("angle")), "shape 's' uses 'angle'"),
        (lambda m: m.world(follow="cart"), "no body 'cart' to follow"),
    ],
)
def test_freeze_refuses_a_drawing_of_what_the_model_does_not_have(declare, told):
    model = swing()
    declare(model)
    with pytest.raises(ValueError, match=r"^swing: ") as refusal:
        model.freeze()
    assert told in str(refusal.value)


def _expressions(item: object) -> list[SX]:
    return [value for value in vars(item).values() if isinstance(value, SX)]


def _value(expression: SX, values: dict[str, float]) -> list[float]:
    symbols = ca.symvar(expression)
    function = ca.Function("f", symbols, [expression])
    return function.call([values[s.name()] for s in symbols])[0].full().ravel().tolist()
