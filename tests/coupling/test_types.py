"""Connections of Boolean, integer and enumeration variables, and of elements of arrays."""

import zipfile

import numpy as np
import pytest
from helpers.mutated_ssp import packed
from helpers.ssp_files import component, connection, description, mapping
from helpers.ssp_files import system as ssp_system
from helpers.ssp_files import values as bound_values
from helpers.typed_part import typed_part

import cosim
from cosim.errors import ParameterError, SolverError, UsageError
from cosim.model.inputs import InputSeries

METHODS = ["jacobi", "gauss_seidel", "extrapolated", "iterated"]


@pytest.fixture(scope="module", params=[2, 3])
def part(request, tmp_path_factory):
    return typed_part(tmp_path_factory.mktemp("typed"), request.param)


@pytest.fixture(scope="module")
def part_3(tmp_path_factory):
    return typed_part(tmp_path_factory.mktemp("typed"))


def changed(path, target, old, new):
    """Write an archive with another text for one in it."""
    with zipfile.ZipFile(path) as archive, zipfile.ZipFile(target, "w") as other:
        for entry in archive.namelist():
            other.writestr(entry, archive.read(entry).replace(old.encode(), new.encode()))
    return target


def chain(path, **options):
    wires = {"b.on_in": "a.on", "b.count_in": "a.count", "b.mode_in": "a.mode"}
    values = {"a.on_in": True, "a.count_in": -2147483648, "a.mode_in": "fast"}
    return cosim.couple({"a": path, "b": path}, wires, start_values=values, **options)


def listener(path, wires):
    drive = "a.u" if path.stem == "typed_part_2" else "a.u[1]"
    return cosim.couple({"a": path, "b": path}, wires, start_values={drive: 1.0})


@pytest.mark.parametrize("method", METHODS)
def test_values_of_every_type_pass_without_change(method, part):
    final = chain(part).simulate(method=method, macro_step=0.1).final
    assert [final[f"b.{name}"] for name in ("on", "count", "mode")] == [1, -2147483648, 3]
    assert [final[f"b.{name}_in"] for name in ("on", "count", "mode")] == [1, -2147483648, 3]


def test_texts_of_a_command_line_are_values_of_their_type(part):
    texts = {"a.on_in": "false", "a.count_in": "2147483647", "a.mode_in": "slow"}
    final = chain(part).simulate(macro_step=0.5, start_values=texts).final
    assert [final[f"b.{name}"] for name in ("on", "count", "mode")] == [0, 2147483647, 1]


@pytest.mark.parametrize("method", METHODS)
def test_texts_pass_from_part_to_part(method, part):
    """x' = 1: `label` becomes "above" at 0.5 s; parts that step in turn see it at once."""
    system = listener(part, {"b.label_in": "a.label", "b.on_in": "b.heard"})
    run = system.simulate(method=method, macro_step=0.1, stop_time=0.9, output_interval=0.3)
    assert run["b.heard"].tolist() == run["b.on"].tolist() == [0, 0, 1, 1]
    assert not any("label" in name for name in run.names)


def test_switch_of_a_text_is_located(part):
    system = listener(part, {"b.label_in": "a.label"})
    run = system.simulate(accuracy=1e-6, stop_time=0.9, output_interval=0.3)
    assert run["a.above"].tolist() == run["b.heard"].tolist() == [0, 0, 1, 1]
    assert 10 < run.stats["rejected_steps"] < 30  # to 1e-9 of the span; measured 13


def test_ssp_file_keeps_connections_and_values_of_texts(part, tmp_path):
    wires, values = {"b.label_in": "a.label"}, {"a.label_in": "above"}
    system = cosim.couple({"a": part, "b": part}, wires, start_values=values)
    found = cosim.read_ssp(system.write_ssp(tmp_path / "texts.ssp"))
    assert [wire[:2] for wire in found.connections] == [(("b", "label_in"), ("a", "label"))]
    final = found.simulate(macro_step=0.5, stop_time=0.5).final
    assert (final["a.heard"], final["b.heard"]) == (1, 0)


@pytest.mark.parametrize("method", ["extrapolated", "iterated"])
def test_switch_of_a_boolean_is_located(method, part):
    """x' = 1 switches `above` at 0.5 s, which the next part passes on."""
    system = listener(part, {"b.on_in": "a.above"})
    run = system.simulate(method=method, accuracy=1e-6, stop_time=0.9, output_interval=0.3)
    assert run["a.above"].tolist() == run["b.on"].tolist() == [0, 0, 1, 1]
    assert 10 < run.stats["rejected_steps"] < 30  # to 1e-9 of the span; measured 13


def test_integers_and_enumerations_drive_each_other(part):
    wires = {"b.mode_in": "a.count", "b.count_in": "a.mode"}
    values = {"a.count_in": 3, "a.mode_in": "slow"}
    system = cosim.couple({"a": part, "b": part}, wires, start_values=values)
    final = system.simulate(macro_step=0.5, stop_time=1.0).final
    assert (final["b.mode"], final["b.count"]) == (3, 1)


def test_an_integer_that_an_enumeration_of_fmi_2_does_not_hold_is_an_error(part_3, tmp_path):
    old = '<Enumeration name="{}" valueReference="{}" causality="{}" variability="discrete"'
    wide = part_3
    for name, reference, causality, start in [
        ("mode_in", 11, "input", ' start="1"'),
        ("mode", 12, "output", ""),
    ]:
        found = old.format(name, reference, causality) + f'{start} declaredType="Speed"'
        new = found.replace("Enumeration", "Int64").removesuffix(' declaredType="Speed"')
        wide = changed(wide, tmp_path / f"{name}.fmu", found, new)
    parts = {"a": wide, "b": typed_part(tmp_path, 2)}
    values = {"a.mode_in": 5 * 10**9}
    system = cosim.couple(parts, {"b.mode_in": "a.mode"}, start_values=values)
    with pytest.raises(SolverError, match="an integer that its type does not hold"):
        system.simulate(macro_step=0.5)
    assert system.simulate(macro_step=0.5, start_values={"a.mode_in": 3}).final["b.mode"] == 3


def test_integer_drives_a_real_input_as_it_is(part):
    model = cosim.Model("integral")
    rate = model.input("rate", "1", 0.0, "rate")
    model.derivative(model.state("x", "1", 0.0, "integral"), rate)
    parts = {"a": part, "b": model.freeze()}
    system = cosim.couple(parts, {"b.rate": "a.count"}, start_values={"a.count_in": 3})
    assert system.simulate(accuracy=1e-8, stop_time=1.0).final["b.x"] == pytest.approx(
        3.0, abs=1e-8
    )


@pytest.mark.parametrize("method", METHODS)
def test_elements_of_arrays_are_connected_and_the_others_stay(method, part_3):
    """a: x1' = 1; b: x1' = 5, x2' = x1 of a."""
    values = {"a.u[1]": 1.0, "b.u[1]": 5.0}
    system = cosim.couple({"a": part_3, "b": part_3}, {"b.u[2]": "a.y[1]"}, start_values=values)
    step = 0.001 if method in METHODS[:2] else 0.1
    final = system.simulate(method=method, macro_step=step, stop_time=1.0).final
    assert final["b.y[1]"] == pytest.approx(5.0, rel=1e-9)
    assert final["b.y[2]"] == pytest.approx(0.5, rel=2e-3 if step < 0.1 else 1e-9)


def test_float32_drives_float32_and_float64(part_3):
    wires = {"b.level_in": "a.level", "b.u[1]": "a.level"}
    system = cosim.couple({"a": part_3, "b": part_3}, wires, start_values={"a.level_in": 0.1})
    final = system.simulate(accuracy=1e-8, stop_time=1.0).final
    assert final["b.level"] == pytest.approx(0.1, rel=1e-7)
    assert final["b.y[1]"] == pytest.approx(0.1, rel=1e-7)


@pytest.mark.parametrize(
    ("sink", "source", "reason"),
    [
        ("b.count_in", "a.y[1]", r"a.y\[1\] \(Float64\) cannot drive b.count_in \(Int32\)"),
        ("b.count_in", "a.level", r"a.level \(Float32\) cannot drive b.count_in \(Int32\)"),
        ("b.count_in", "a.on", r"a.on \(Boolean\) cannot drive b.count_in \(Int32\)"),
        ("b.on_in", "a.count", r"a.count \(Int32\) cannot drive b.on_in \(Boolean\)"),
        ("b.u[1]", "a.on", r"a.on \(Boolean\) cannot drive b.u\[1\] \(Float64\)"),
        ("b.mode_in", "a.on", r"cannot drive b.mode_in \(Enumeration\)"),
        ("b.label_in", "a.on", r"a.on \(Boolean\) cannot drive b.label_in \(String\)"),
        ("b.on_in", "a.label", r"a.label \(String\) cannot drive b.on_in \(Boolean\)"),
        ("b.u", "a.y", r"b.u is an array; connect its elements, such as b.u\[1\]"),
        ("b.u[1]", "a.y", r"a.y is an array"),
    ],
)
def test_connection_that_would_change_values_is_rejected(sink, source, reason, part_3):
    with pytest.raises(UsageError, match=reason):
        cosim.couple({"a": part_3, "b": part_3}, {sink: source})


def test_enumerations_with_other_items_are_not_connected(part_3, tmp_path):
    other = changed(part_3, tmp_path / "other.fmu", '"fast" value="3"', '"fast" value="2"')
    with pytest.raises(UsageError, match="with other items"):
        cosim.couple({"a": part_3, "b": other}, {"b.mode_in": "a.mode"})


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("a.count_in", 3.7, "count_in = 3.7 is no Int"),
        ("a.count_in", "3000000000", "count_in = 3000000000 is no Int"),
        ("a.on_in", 2, "on_in = 2 is no Boolean"),
        ("a.mode_in", 2, r"mode_in = 2 is no item of it; give one of slow \(1\), fast \(3\)"),
    ],
)
def test_value_that_a_type_does_not_have_is_rejected(name, value, reason, part):
    with pytest.raises(ParameterError, match=reason):
        cosim.couple({"a": part}, {}, start_values={name: value})


@pytest.mark.parametrize("law", ["3.7*t", 3.7])
@pytest.mark.parametrize("name", ["count", "on", "mode"])
def test_law_for_an_input_that_does_not_have_its_values_is_rejected(name, law, part):
    with pytest.raises(UsageError, match=f"{name}_in = .* is (no|not a real) "):
        cosim.couple({"a": part}, {}).simulate(macro_step=0.5, inputs={f"a.{name}_in": law})


@pytest.mark.parametrize("name", ["count", "on", "mode"])
def test_function_for_an_input_that_changes_at_events_is_rejected(name, part):
    with pytest.raises(UsageError, match=f"a.{name}_in changes at events only and follows no"):
        cosim.couple({"a": part}, {}).simulate(inputs={f"a.{name}_in": lambda t: 1.0})


@pytest.mark.parametrize("method", ["jacobi", "iterated"])
def test_samples_drive_inputs_of_every_type_from_their_times_on(method, part):
    samples = {"on": [0, 1, 0], "count": [5, -7, 5], "mode": [1, 3, 3]}
    inputs = {
        f"a.{name}_in": InputSeries(("u",), [0.0, 0.37, 1.0], np.array([values]).T)
        for name, values in samples.items()
    }
    run = cosim.couple({"a": part}, {}).simulate(
        inputs=inputs, method=method, macro_step=0.1, output_interval=0.25, stop_time=1.0
    )
    for name, values in samples.items():
        assert run[f"a.{name}"].tolist() == [values[i] for i in (0, 0, 1, 1, 2)]


def test_integers_that_results_cannot_hold_are_named(part_3, tmp_path):
    large = changed(part_3, tmp_path / "large.fmu", "<Enumeration ", "<Int64 ")
    path = changed(large, tmp_path / "own.fmu", ' declaredType="Speed"', "")
    for value, noted in ((2**53 - 1, False), (2**53 + 1, True)):
        alone = cosim.simulate_fmu(path, start_values={"mode_in": value}, outputs=["mode", "y"])
        parts = cosim.couple({"a": path}, {}, start_values={"a.mode_in": value})
        coupled = parts.simulate(macro_step=0.5, stop_time=0.5)
        for run, name in ((alone, "mode"), (coupled, "a.mode")):
            words = f"{name}: integers from 2^53 on may be rounded in results"
            assert (words in run.stats.get("note", "")) is noted


def test_name_of_an_array_records_its_elements(part_3):
    run = cosim.couple({"a": part_3}, {}, start_values={"a.u[2]": 1.0}).simulate(
        macro_step=0.5, stop_time=1.0, outputs=["a.y", "a.on"]
    )
    assert run.final == pytest.approx({"a.y[1]": 0.0, "a.y[2]": 1.0, "a.on": 0.0})


def test_structural_parameter_of_a_part_stays(part_3):
    with pytest.raises(UsageError, match=r"a\.n cannot be given"):
        cosim.couple({"a": part_3}, {}, start_values={"a.n": 3})


def test_ssp_file_keeps_values_of_every_type(part, tmp_path):
    path = chain(part, stop_time=0.5).write_ssp(tmp_path / "typed.ssp")
    with zipfile.ZipFile(path) as archive:
        text = archive.read("SystemStructure.ssd").decode()
    assert all(one in text for one in ('Boolean value="true"', 'Enumeration value="fast"'))
    assert 'Integer value="-2147483648"' in text
    final = cosim.read_ssp(path).simulate(macro_step=0.1).final
    assert [final[f"b.{name}"] for name in ("on", "count", "mode")] == [1, -2147483648, 3]


def test_ssp_file_keeps_integers_that_no_float_has(part_3, tmp_path):
    path = changed(part_3, tmp_path / "wide.fmu", "<Int32 ", "<Int64 ")
    values = {"a.count_in": 2**53 + 1}
    system = cosim.couple({"a": path}, {}, start_values=values)
    found = cosim.read_ssp(system.write_ssp(tmp_path / "wide.ssp"))
    assert found.start_values == {("a", "count_in"): 2**53 + 1}


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ('Integer value="-2147483648"', 'Real value="3.7"', "count_in = 3.7 is no Int"),
        ('value="fast"', 'value="quick"', "mode_in = quick is no item of it"),
        (
            'startConnector="on"',
            'startConnector="count"',
            r"a.count \(.*\) cannot drive b.on",
        ),
    ],
)
def test_ssp_file_with_another_type_is_rejected(old, new, reason, part, tmp_path):
    path = chain(part).write_ssp(tmp_path / "typed.ssp")
    other = changed(path, tmp_path / "changed.ssp", old, new)
    with pytest.raises(cosim.CosimError, match=rf"changed.ssp: SystemStructure.ssd: .*{reason}"):
        cosim.read_ssp(other)


@pytest.mark.parametrize(
    ("kind", "given", "value", "name"),
    [
        ("Boolean", "false", 1, "on"),
        ("Integer", "7", -2147483648, "count"),
        ("Enumeration", "quick", 3, "mode"),
    ],
)
def test_table_of_a_parameter_mapping_changes_the_value(kind, given, value, name, part, tmp_path):
    target = {1: "true", 3: "fast"}.get(value, value)
    row = f'<ssc:MapEntry source="{given}" target="{target}"/>'
    table = f"<ssc:{kind}MappingTransformation>{row}</ssc:{kind}MappingTransformation>"
    mapped = f"<ssd:ParameterMapping>{mapping(('t', f'a.{name}_in', table))}</ssd:ParameterMapping>"
    bound = bound_values(mapping=mapped, t=0).replace('Real value="0"', f'{kind} value="{given}"')
    kinds = {f"{name}_in": "input"}
    whole = component("a", "", kinds=kinds, source="resources/typed.fmu")
    text = description(ssp_system("S", whole, bindings=bound))
    entries = {"SystemStructure.ssd": text, "resources/typed.fmu": part.read_bytes()}
    (tmp_path / "mapped.ssp").write_bytes(packed(entries))
    found = cosim.read_ssp(tmp_path / "mapped.ssp")
    assert found.start_values == {("a", f"{name}_in"): value}


HALF = '<ssc:LinearTransformation factor="0.5"/>'


def through_connector(folder, path, first, second, change=""):
    """A system whose input `in` sets an input of each of two parts."""
    kinds = dict.fromkeys((first, second), "input")
    parts = "".join(component(n, "", kinds=kinds, source="resources/typed.fmu") for n in "ab")
    wires = connection("in", f"a.{first}", change) + connection("in", f"b.{second}")
    text = description(ssp_system("S", parts, wires, kinds={"in": "input"}))
    entries = {"SystemStructure.ssd": text, "resources/typed.fmu": path.read_bytes()}
    (folder / "typed.ssp").write_bytes(packed(entries))
    return cosim.read_ssp(folder / "typed.ssp")


@pytest.mark.parametrize(
    ("first", "second", "change", "words"),
    [
        ("on_in", "count_in", "", "on_in = 3.0 is no Boolean"),
        ("count_in", "on_in", "", "on_in = 3.0 is no Boolean"),
        ("count_in", "count_in", HALF, "count_in = 1.5 is no Int"),
        ("mode_in", "count_in", HALF, "mode_in = 1.5 is no item of it"),
    ],
)
def test_samples_suit_every_input_that_a_connector_sets(
    first, second, change, words, part, tmp_path
):
    system = through_connector(tmp_path, part, first, second, change)
    values = np.array([[2.0 if change else 1.0], [3.0]])
    samples = InputSeries(["in"], np.array([0.0, 0.5]), values)
    with pytest.raises(ParameterError, match=words):
        system.simulate(inputs=samples, macro_step=0.1)


def test_value_of_a_connector_is_a_number_for_every_type(part, tmp_path):
    system = through_connector(tmp_path, part, "on_in", "count_in")
    run = system.simulate(start_values={"in": 1}, macro_step=0.1, outputs=["a.on", "b.count"])
    np.testing.assert_array_equal(run.values, 1.0)


@pytest.mark.parametrize(
    ("first", "value", "own", "second"),
    [
        ("mode_in", 6, 3, 6),  # 6 is no item of it, and its half is one
        ("mode_in", "2", 1, 2),
        ("count_in", 1e1, 5, 10),
        ("on_in", 2.0, 1, 2),
    ],
)
def test_value_of_a_connector_is_transformed_before_its_type_is_checked(
    first, value, own, second, part, tmp_path
):
    system = through_connector(tmp_path, part, first, "count_in", HALF)
    names = [f"a.{first}", "b.count_in"]
    given = {"start_values": {"in": value}}, {"inputs": {"in": value}}
    for keywords in given:
        run = system.simulate(macro_step=0.1, outputs=names, **keywords)
        np.testing.assert_array_equal(run.values, [[own, second]] * len(run))


@pytest.mark.parametrize(
    ("first", "value", "words"),
    [
        ("mode_in", 3, "mode_in = 1.5 is no item of it"),
        ("mode_in", 4, "mode_in = 2.0 is no item of it"),
        ("mode_in", "fast", "fast"),
        ("count_in", 3, "count_in = 1.5 is no Int"),
        ("on_in", 1, "on_in = 0.5 is no Boolean"),
    ],
)
def test_value_whose_transformation_has_not_the_type_is_rejected(
    first, value, words, part, tmp_path
):
    system = through_connector(tmp_path, part, first, "count_in", HALF)
    with pytest.raises(ParameterError, match=words):
        system.simulate(start_values={"in": value}, macro_step=0.1)
