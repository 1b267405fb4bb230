"""Texts as values of an FMU: parameters and inputs of type String."""

import pytest
from helpers.stubbed import stubbed

import cosim
from cosim.cli.main import main
from cosim.errors import CosimError, FmuError, ParameterError, UsageError

SOURCE = """#include <stdlib.h>
#include <string.h>
#define API __attribute__((visibility("default")))
static int length = 2;
API void *fmi2Instantiate(const char *name, int type, const char *token, const char *place,
                          const void *functions, int visible, int logging) {
    length = 2;
    return malloc(1);
}
API void fmi2FreeInstance(void *c) { free(c); }
API int fmi2SetString(void *c, const unsigned *vr, size_t n, const char *const *values) {
    length = (int)strlen(values[0]);
    return 0;
}
API int fmi2GetInteger(void *c, const unsigned *vr, size_t n, int *values) {
    values[0] = length;
    return 0;
}
"""
DESCRIPTION = """<fmiModelDescription fmiVersion="2.0" modelName="texts" guid="t">
<CoSimulation modelIdentifier="texts" canHandleVariableCommunicationStepSize="true"/>
<DefaultExperiment startTime="0" stopTime="0.2" stepSize="0.1"/><ModelVariables>
<ScalarVariable name="label" valueReference="0" causality="parameter" variability="tunable">
<String start="hi"/></ScalarVariable>
<ScalarVariable name="level" valueReference="2" causality="parameter" variability="tunable">
<Real start="1" min="0" max="2"/></ScalarVariable>
<ScalarVariable name="length" valueReference="1" causality="output" variability="discrete">
<Integer/></ScalarVariable>
</ModelVariables><ModelStructure><Outputs><Unknown index="3"/></Outputs></ModelStructure>
</fmiModelDescription>"""


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    folder = tmp_path_factory.mktemp("texts")
    source = folder / "texts.c"
    source.write_text(SOURCE)
    return stubbed(source, folder, 2, DESCRIPTION)


@pytest.mark.parametrize("master", ["fmpy", "c"])
def test_text_is_set_as_it_is(master, path):
    run = cosim.simulate_fmu(path, start_values={"label": "grüße"}, master=master)
    assert run.final == {"length": 7.0}  # bytes of UTF-8; before: only numbers can be set
    assert cosim.simulate_fmu(path, master=master).final == {"length": 2.0}


def test_text_is_set_on_the_command_line_and_in_a_session(path, capsys):
    assert main(["simulate", str(path), "--trust", "-p", "label=abcd", "-q"]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == "0.2,4"
    with cosim.open(path, start_values={"label": "abc"}) as session:
        assert session["length"] == 3.0
        session.reset(start_values={"label": "abcdef"})
        assert session["length"] == 6.0


def test_part_of_a_system_keeps_its_text_in_an_ssp_file(path, tmp_path):
    system = cosim.couple({"a": path}, {}, start_values={"a.label": "123"})
    again = cosim.read_ssp(system.write_ssp(tmp_path / "texts.ssp"))
    for one in (system, again):
        assert one.simulate(macro_step=0.1, stop_time=0.2).final == {"a.length": 3.0}


@pytest.mark.parametrize("wrong", [3, 1.5, True, None, "a\0b", ["x"]], ids=repr)
def test_what_is_no_text_is_rejected(wrong, path):
    with pytest.raises(ParameterError, match=r"label = .* is no String; give a text"):
        cosim.simulate_fmu(path, start_values={"label": wrong})


def test_text_is_not_recorded(path):
    with pytest.raises(UsageError, match="label is not a single number and cannot be recorded"):
        cosim.simulate_fmu(path, outputs=["label"])


@pytest.mark.parametrize("master", ["fmpy", "c"])
def test_number_beyond_its_bounds_is_rejected_where_the_fmu_takes_it(master, path):
    for level in (-0.5, 2.5):
        with pytest.raises(FmuError, match=f"level = {level} is out of its range 0"):
            cosim.simulate_fmu(path, start_values={"level": level}, master=master)
    cosim.simulate_fmu(path, start_values={"level": 2.0}, master=master)
    with pytest.raises(FmuError, match="level = 3 is out of its range 0"):
        cosim.open(path, start_values={"level": 3.0})
    system = cosim.couple({"a": path}, {}, start_values={"a.level": 3.0}, stop_time=0.2)
    with pytest.raises(CosimError, match="level = 3 is out of its range 0"):
        system.simulate(macro_step=0.1)
