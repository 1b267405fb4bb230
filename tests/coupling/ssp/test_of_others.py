"""SSP files as other tools write them: connections, values, names, files within files."""

import zipfile

import pytest
from helpers.ssp_files import (
    NAMESPACES,
    bindings,
    component,
    connection,
    connectors,
    description,
    ends,
    experiment,
    mapping,
    package,
    parameter_set,
    system,
    values,
)

import cosim
from cosim.cli.main import main
from cosim.coupling.files import read_system
from cosim.errors import CosimError, UnknownName, UsageError

SOURCE = component("s", "source")
DICTIONARY = (
    '<ssb:SignalDictionary version="1.0"><ssb:DictionaryEntry name="a"><ssc:Real {}/>'
    "</ssb:DictionaryEntry></ssb:SignalDictionary>"
)


# Connections


@pytest.mark.slow
def test_connection_written_in_reverse_leads_from_the_output_to_the_input(read):
    linear = '<ssc:LinearTransformation factor="2" offset="1"/>'
    two = connection("g.u", "s.y", linear)
    found = read(system("S", SOURCE + component("g", "gain"), two))
    assert ends(found) == {"g.u": ("s.y", 2, 1)}  # along the signal, not from start to end


def test_one_connector_drives_several(read):
    parts = SOURCE + component("g", "gain") + component("h", "gain")
    found = read(system("S", parts, connection("s.y", "g.u") + connection("s.y", "h.u")))
    assert ends(found) == {"g.u": ("s.y", 1, 0), "h.u": ("s.y", 1, 0)}


@pytest.mark.parametrize(
    ("wires", "words"),
    [
        (connection("S.y", "g.u"), "has no element 'S'; did you mean s"),
        (connection("s.z", "g.u"), "'s' has no variable 'z'"),
        (connection("z", "g.u"), "the system has no connector 'z'"),
        (connection("in.z", "g.u"), "'in' has no connector 'z'"),
        (connection("odd.z", "g.u"), "'odd' has no variable 'z'"),
        (connection("s.y", "g.y"), "both ends cannot be driven"),
        (connection("g.u", "g.k"), "both ends can only be driven"),
        (connection("s.y", "g.u") * 2, "g.u is connected twice, to s.y and to s.y"),
        (connection("s.y", "g.k"), "g.k is no input"),
        (connection("q.y", "q.u"), r"in a ring: q.y <- q.u <- q.y"),
        (connection("s.y", "g.u", suppressUnitConversion="maybe"), "neither true nor false"),
        (connection("s.y", "g.u", '<ssc:LinearTransformation factor="1_0"/>'), "is no number"),
        (connection("s.y", "g.u", '<ssc:LinearTransformation factor="two"/>'), "is no number"),
    ],
)
def test_wrong_connection_is_rejected_with_file_and_entry(write, wires, words):
    through = system("q", "", connection("u", "y"), kinds={"u": "input", "y": "output"})
    inner = system("in", "", kinds={"y": "output"})
    odd = component("odd", "source", kinds={"y": "output", "z": "output"})  # its FMU has no z
    path = write(system("S", SOURCE + odd + component("g", "gain") + through + inner, wires))
    with pytest.raises(CosimError, match=words) as caught:
        cosim.read_ssp(path)
    assert str(caught.value).startswith(f"{path}: SystemStructure.ssd: ")


def test_ring_of_a_connector_with_itself_ends_in_one_sentence(write, capsys):
    kinds = {"y": "unspecified"}
    path = write(system("S", system("q", "", kinds=kinds), connection("q.y", "q.y")))
    assert main(["info", str(path)]) == 2
    assert "drive q.y in a ring: q.y <- q.y; remove one" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        (SOURCE + SOURCE, "the whole system has two elements 's'"),
        (system("q", SOURCE + SOURCE), "'q' has two elements 's'"),
        (component("", "source"), "has no name"),
        (component("s", "source", connectors(y="output") * 2, kinds={}), "two connectors 'y'"),
        (component("s", "source", kinds={"y": "ouput"}), "of kind 'ouput'; give one of input"),
    ],
)
def test_name_that_is_not_unique_is_rejected(read, parts, words):
    with pytest.raises(UsageError, match=words):
        read(system("S", parts))


@pytest.mark.parametrize("own_file", [False, True])
def test_signal_dictionary_connects_what_refers_to_it(read, own_file):
    bus = '<ssd:SignalDictionaryReference name="bus" dictionary="D"/>'
    if own_file:
        declared = '<ssd:SignalDictionary name="D" source="resources/d.ssb"/>'
        content = DICTIONARY.format("").replace(">", f" {NAMESPACES}>", 1)
        entries = {"resources__d_ssb": content}
    else:
        declared = f'<ssd:SignalDictionary name="D">{DICTIONARY.format("")}</ssd:SignalDictionary>'
        entries = {}
    more = f"<ssd:SignalDictionaries>{declared}</ssd:SignalDictionaries>"
    inner = system("q", bus + component("g", "gain"), connection("g.u", "bus.a"))
    whole = system("S", SOURCE + bus + inner, connection("s.y", "bus.a"), more=more)
    assert ends(read(whole, **entries)) == {"q_g.u": ("s.y", 1, 0)}
    with pytest.raises(UnknownName, match="dictionary 'D' has no signal 'b'"):
        read(whole.replace('Connector="a"', 'Connector="b"'), **entries)
    with pytest.raises(UsageError, match="'bus' refers to no signal dictionary: 'E'"):
        read(whole.replace('dictionary="D"', 'dictionary="E"'), **entries)


def test_dictionaries_of_one_folder_have_their_own_signals_and_units(read):
    names = ("d", "e")
    declared = "".join(
        f'<ssd:SignalDictionary name="{n}" source="resources/{n}.ssb"/>' for n in names
    )
    entries = {
        f"resources__{n}_ssb": DICTIONARY.format("").replace(">", f" {NAMESPACES}>", 1)
        for n in names
    }
    buses = "".join(
        f'<ssd:SignalDictionaryReference name="bus_{n}" dictionary="{n}"/>' for n in names
    )
    wires = (("s.y", "bus_d.a"), ("bus_d.a", "g.u"), ("g.y", "bus_e.a"), ("bus_e.a", "h.u"))
    whole = system(
        "S",
        SOURCE + component("g", "gain") + component("h", "gain") + buses,
        "".join(connection(*wire) for wire in wires),
        more=f"<ssd:SignalDictionaries>{declared}</ssd:SignalDictionaries>",
    )
    assert ends(read(whole, **entries)) == {"g.u": ("s.y", 1, 0), "h.u": ("g.y", 1, 0)}


# Values


def test_value_of_a_connector_reaches_all_that_it_drives(read):
    whole = system(
        "S",
        SOURCE + component("g", "gain") + system("q", component("h", "gain")),
        connection("K", "g.k") + connection("s.y", "g.u"),
        kinds={"K": "parameter"},
        bindings=values(K=4, q__h__u=3),
    )
    found = read(whole)
    assert found.start_values == {("g", "k"): 4, ("q_h", "u"): 3}
    run = found.simulate(stop_time=1)
    assert run.final["g.y"] == pytest.approx(12, abs=1e-9)  # measured 0
    run = found.simulate(stop_time=1, start_values={"K": 5})
    assert run.final["g.y"] == pytest.approx(15, abs=1e-9)  # measured 0


def test_value_of_a_system_replaces_that_of_its_part(read):
    inner = system("q", component("g", "gain", values(k=2)), bindings=values(g__k=3))
    assert read(system("S", inner)).start_values == {("q_g", "k"): 3}
    found = read(system("S", inner, bindings=values(q__g__k=4)))
    assert found.start_values == {("q_g", "k"): 4}
    twice = bindings("") + values(k=5) + values(k=6)
    assert read(system("S", component("g", "gain", twice))).start_values == {("g", "k"): 6}


MAPPED = mapping(
    ("a", "g.k", '<ssc:LinearTransformation factor="4" offset="5"/>'),
    ("a", "h.k", ""),
    ("", "z", ""),
)


@pytest.mark.parametrize("own_file", [False, True])
def test_mapping_renames_and_transforms_values(read, own_file):
    if own_file:
        chosen = bindings(
            '<ssd:ParameterBinding source="resources/a.ssv">'
            '<ssd:ParameterMapping source="resources/a.ssm"/></ssd:ParameterBinding>'
        )
        entries = {"resources__a_ssv": parameter_set(a=2, b=9), "resources__a_ssm": MAPPED}
    else:
        inner = f"<ssd:ParameterMapping>{MAPPED}</ssd:ParameterMapping>"
        chosen, entries = values(a=2, b=9, mapping=inner), {}
    parts = component("g", "gain") + component("h", "gain")
    found = read(system("S", parts, bindings=chosen), **entries)
    assert found.start_values == {("g", "k"): 13, ("h", "k"): 2}  # 4 2 + 5; b is not mapped


def test_mapping_of_a_parameter_that_no_set_has_is_rejected(read):
    rows = mapping(("a", "g.k", ""), ("b", "h.k", ""))
    parts = component("g", "gain") + component("h", "gain")
    one = '<ssd:ParameterBinding source="{}.ssv"><ssd:ParameterMapping source="m.ssm"/>{}'.format
    sets = {"a_ssv": parameter_set(a=2), "b_ssv": parameter_set(b=3)}
    first, second = (one(name, "</ssd:ParameterBinding>") for name in "ab")
    shared = read(system("S", parts, bindings=bindings(first + second)), m_ssm=rows, **sets)
    assert shared.start_values == {("g", "k"): 2, ("h", "k"): 3}  # each set has one of them
    with pytest.raises(UnknownName, match=r"m\.ssm: the mapping to h\.k: .* no parameter 'b'"):
        read(system("S", parts, bindings=bindings(first)), m_ssm=rows, **sets)


def test_two_parameters_mapped_to_one_name_are_rejected(read):
    rows = mapping(("a", "g.k", ""), ("b", "g.k", ""))
    inner = f"<ssd:ParameterMapping>{rows}</ssd:ParameterMapping>"
    with pytest.raises(UsageError, match=r"two parameters are mapped to g\.k"):
        read(system("S", component("g", "gain"), bindings=values(a=1, b=2, mapping=inner)))


def test_prefix_of_a_binding_names_the_part(read):
    chosen = values(k=3).replace("<ssd:ParameterBinding>", '<ssd:ParameterBinding prefix="g.">')
    assert read(system("S", component("g", "gain"), bindings=chosen)).start_values == {
        ("g", "k"): 3
    }


@pytest.mark.parametrize("text", ["1_0", "", "nan", "INF", "0x1p3", "\u0661", "1 2", "9" * 400])
def test_text_that_is_no_number_is_rejected(read, text):
    with pytest.raises(UsageError, match=r"SystemStructure\.ssd: .*k = .* is no number"):
        read(system("S", component("g", "gain", values(k=text))))


@pytest.mark.parametrize(
    ("start", "stop", "words"),
    [("abc", 1, "startTime = 'abc' is no number"), (0, "", "stopTime = '' is no number"),
     (1, 1, "stopTime = 1 is not after startTime = 1"), (0, "1_0", "is no number")],
)  # fmt: skip
def test_wrong_time_is_rejected(read, start, stop, words):
    with pytest.raises(UsageError, match=words):
        read(system("S", SOURCE), experiment(start, stop))


@pytest.mark.parametrize("start", [2.0, -1.0])
def test_start_time_of_the_file_begins_the_run_and_is_written(read, tmp_path, start):
    whole = system("S", SOURCE + component("g", "gain"), connection("s.y", "g.u"))
    found = read(whole, experiment(start, start + 1))
    for one in (found, cosim.read_ssp(found.write_ssp(tmp_path / "again.ssp"))):
        run = one.simulate()
        assert (run.time[0], run.time[-1]) == (start, start + 1)
        assert run.final["g.y"] == pytest.approx(3 + start, abs=1e-9)  # measured 0
        assert run.final["g.x"] == pytest.approx(2.5 + start, abs=1e-6)  # measured 1e-12


# Connectors of the whole system


def test_connectors_of_the_whole_system_set_inputs_and_show_outputs(read, capsys):
    whole = system(
        "S",
        component("g", "gain"),
        connection("in", "g.u")
        + connection("g.y", "out", '<ssc:LinearTransformation factor="-2"/>'),
        kinds={"in": "input", "out": "output"},
    )
    found = read(whole)
    assert found.undriven_inputs == []
    assert "in -> g.u" in repr(found)
    run = found.simulate(stop_time=1, start_values={"in": "500 mm"} | {"g.k": 3.0})
    assert run.final["out"] == pytest.approx(-3, abs=1e-9)  # measured 0
    run = found.simulate(stop_time=1, start_values={"in": 2}, outputs=["out"])
    assert run.names == ("out",)
    assert run.final["out"] == pytest.approx(-4, abs=1e-9)  # measured 0


def test_output_of_the_whole_system_may_show_a_state(write, capsys):
    whole = system("S", SOURCE, connection("s.s", "out"), kinds={"out": "output"})
    path = write(whole, experiment(2, 3))
    run = cosim.read_ssp(path).simulate()
    assert run.final["out"] == pytest.approx(1, abs=1e-9)  # measured 2e-16
    assert main(["simulate", str(path), "--outputs", "out,s.y", "--output-interval", "1"]) == 0
    head, first, *_ = capsys.readouterr().out.splitlines()
    assert head == "time,s.y,out"
    assert first == "2,4,0"


def test_system_without_parts_is_read_but_not_simulated(read):
    found = read(system("S", "", kinds={"K": "parameter"}, bindings=values(K=1)))
    assert (dict(found.parts), list(found.connectors)) == ({}, ["K"])
    with pytest.raises(UsageError, match="S has no parts"):
        found.simulate()
    with pytest.raises(UsageError, match="S has no parts"):
        found.dae  # noqa: B018 # it is computed on demand


# Names


def test_parts_whose_names_differ_in_replaced_characters_are_read(read):
    names = ["g_1", "g-1", "ä", "ö", "sub_g"]
    parts = "".join(component(name, "gain") for name in names) + system(
        "sub", component("g", "gain")
    )
    found = read(system("S", parts))
    assert (
        list(found.parts) == ["g_1", "g_1_2", "_", "__2", "sub_g", "sub_g_2"]
        or len(found.parts) == 6
    )
    assert found.parts["g_1"].origin == ""
    assert found.parts["g_1_2"].origin == "g-1"
    assert found.parts["sub_g_2"].origin == "sub.g"
    assert "g_1_2: gain.fmu (g-1)" in repr(found)


def test_undeclared_prefix_in_an_annotation_is_no_error(read):
    note = '<ssd:Annotations><oms:Info oms:a="1" a="2"/></ssd:Annotations>'
    assert list(read(system("S", SOURCE, more=note)).parts) == ["s"]


# Files within files


def test_ssp_within_an_ssp_is_read(read, fmus, tmp_path):
    inner = description(
        system("T", component("g", "gain", values(k=2)), connection("in", "g.u"),
               kinds={"in": "input"}, bindings=values(g__k=3))
    )  # fmt: skip
    nested = package(tmp_path / "inner.ssp", fmus, inner, other_ssd=inner.replace('"3"', '"7"'))
    kind = 'type="application/x-ssp-package"'
    part = f'<ssd:Component name="q" {kind} source="resources/inner.ssp{{}}">{{}}</ssd:Component>'
    wires = connection("s.y", "q.in")
    content = {"resources__inner_ssp": nested.read_bytes()}
    found = read(system("S", SOURCE + part.format("", ""), wires), **content)
    assert ends(found) == {"q_g.u": ("s.y", 1, 0)}
    assert found.start_values == {("q_g", "k"): 3}
    bound = part.format("#other.ssd", "")
    assert read(system("S", SOURCE + bound, wires), **content).start_values == {("q_g", "k"): 7}
    bound = part.format("", values(g__k=5))  # of the component: after those of the inner system
    assert read(system("S", SOURCE + bound, wires), **content).start_values == {("q_g", "k"): 5}


def test_fault_within_an_inner_file_names_both_files(read, fmus, tmp_path):
    inner = description(system("T", component("g", "gain", values(k="x"))))
    nested = package(tmp_path / "inner.ssp", fmus, inner)
    part = '<ssd:Component name="q" type="application/x-ssp-package" source="inner.ssp"/>'
    with pytest.raises(UsageError, match=r"case\.ssp: inner\.ssp: SystemStructure\.ssd: k = 'x'"):
        read(system("S", part), inner_ssp=nested.read_bytes())


@pytest.mark.slow_rows("12")
@pytest.mark.parametrize("levels", [5, 12])
def test_descriptions_that_refer_to_others_many_times_are_rejected(read, levels):
    part = '<ssd:Component name="{}" type="application/x-ssp-definition" source="{}"/>'
    entries = {
        f"d{n}_ssd": description(
            system("T", "".join(part.format(name, f"d{n + 1}.ssd") for name in "abcdefghij"))
        )
        for n in range(levels)
    }
    entries[f"d{levels}_ssd"] = description(system("T", ""))
    with pytest.raises(CosimError, match="more than 10000 elements"):
        read(system("S", part.format("a", "d0.ssd")), **entries)


def test_description_that_refers_to_itself_is_rejected(read):
    part = '<ssd:Component name="a" type="application/x-ssp-definition" source="a.ssd"/>'
    with pytest.raises(CosimError, match="more than 64 systems within each other"):
        read(system("S", part), a_ssd=description(system("T", part)))


def test_variants_are_chosen_by_file_or_by_name(write, capsys):
    other = description(system("T", component("g", "gain")), name="Second")
    path = write(system("S", SOURCE), B_ssd=other)
    assert list(cosim.read_ssp(path).parts) == ["s"]
    for variant in ("B.ssd", "Second"):
        assert list(cosim.read_ssp(path, variant=variant).parts) == ["g"]
        assert list(read_system(f"{path}#{variant}").parts) == ["g"]
    assert main(["info", f"{path}#Second"]) == 0
    assert "g: gain.fmu" in capsys.readouterr().out
    with pytest.raises(UsageError, match=r"no variant 'C'; it has SystemStructure\.ssd, B\.ssd"):
        cosim.read_ssp(path, variant="C")


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        (
            component("s", "source", source="resources/gone.fmu"),
            "it has no file resources/gone.fmu",
        ),
        (component("s", "source", source="../a.fmu"), r"it has no file \.\./a\.fmu"),
        (component("s", "source", source="http://a/b.fmu"), "lies outside the file"),
        (component("s", "source", source="resources/bad.fmu"), "resources/bad.fmu: "),
        (component("s", "source", source="SystemStructure.ssd"), "SystemStructure.ssd: "),
        (SOURCE.replace("source=", 'implementation="Scheduled" source='), "asks for Scheduled"),
    ],
)
def test_part_that_cannot_be_read_is_named_without_the_temporary_folder(write, parts, words):
    path = write(system("S", parts), resources__bad_fmu=b"no archive")
    with pytest.raises(CosimError, match=words) as caught:
        cosim.read_ssp(path)
    assert str(path) in str(caught.value)
    assert "unpacked" not in str(caught.value)
    assert str(caught.value).count("/tmp/") == str(caught.value).count(str(path))


def test_failure_of_a_run_names_the_entry(write, fmus, tmp_path):
    with zipfile.ZipFile(fmus[1]) as archive:
        content = archive.read("modelDescription.xml")
    with zipfile.ZipFile(tmp_path / "bare.fmu", "w") as archive:
        archive.writestr("modelDescription.xml", content)
    bare = (tmp_path / "bare.fmu").read_bytes()
    path = write(system("S", component("s", "source", source="bare.fmu")), bare_fmu=bare)
    with pytest.raises(CosimError, match=r"case\.ssp: bare\.fmu has a binary for no platform"):
        cosim.read_ssp(path).simulate()


def test_transformations_are_written(read, tmp_path):
    linear = '<ssc:LinearTransformation factor="2" offset="1"/>'
    whole = system("S", SOURCE + component("g", "gain"), connection("s.y", "g.u", linear))
    again = cosim.read_ssp(read(whole).write_ssp(tmp_path / "again.ssp"))
    assert ends(again) == {"g.u": ("s.y", 2, 1)}


def test_component_is_simulated_by_the_interface_that_it_asks_for(read, tmp_path):
    asked = SOURCE.replace("source=", 'implementation="ModelExchange" source=')
    system_file = read(system("S", asked + component("g", "gain"), connection("s.y", "g.u")))
    written = cosim.read_ssp(system_file.write_ssp(tmp_path / "again.ssp"))
    for one in (system_file, written):
        assert one.unused == {"s": ("co-simulation",)}
        run = one.simulate(macro_step=0.25, stop_time=0.5)
        assert run.stats["order"]["s"] == "cubic inputs, events end macro steps"
        assert "events" not in run.stats["order"]["g"]
