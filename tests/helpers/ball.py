"""The FMU of ball.c, and the exact motion of its ball (free fall)."""

import math
from pathlib import Path

import numpy as np
from helpers.stubbed import stubbed

_XML_2 = """<?xml version="1.0"?>
<fmiModelDescription fmiVersion="2.0" modelName="ball" guid="b" numberOfEventIndicators="1">
<ModelExchange modelIdentifier="ball"/>
<DefaultExperiment startTime="0" stopTime="1.5" stepSize="0.01" tolerance="1e-10"/>
<ModelVariables>
<ScalarVariable name="h" valueReference="1" causality="output" initial="exact">
<Real start="1"/></ScalarVariable>
<ScalarVariable name="v" valueReference="2" causality="output" initial="exact">
<Real start="0"/></ScalarVariable>
<ScalarVariable name="der(h)" valueReference="3"><Real derivative="1"/></ScalarVariable>
<ScalarVariable name="der(v)" valueReference="4"><Real derivative="2"/></ScalarVariable>
<ScalarVariable name="bounces" valueReference="5" causality="output" variability="discrete">
<Integer/></ScalarVariable>
<ScalarVariable name="pushed" valueReference="6" causality="output" variability="discrete">
<Boolean/></ScalarVariable>
<ScalarVariable name="limit" valueReference="7" causality="parameter" variability="fixed"
initial="exact"><Real start="1e9"/></ScalarVariable>
</ModelVariables>
<ModelStructure><Outputs><Unknown index="1"/><Unknown index="2"/><Unknown index="5"/>
<Unknown index="6"/></Outputs>
<Derivatives><Unknown index="3"/><Unknown index="4"/></Derivatives></ModelStructure>
</fmiModelDescription>
"""
_XML_3 = """<?xml version="1.0"?>
<fmiModelDescription fmiVersion="3.0" modelName="ball" instantiationToken="b">
<ModelExchange modelIdentifier="ball"/>
<DefaultExperiment startTime="0" stopTime="1.5" stepSize="0.01" tolerance="1e-10"/>
<ModelVariables>
<Float64 name="h" valueReference="1" causality="output" start="1" initial="exact"/>
<Float64 name="v" valueReference="2" causality="output" start="0" initial="exact"/>
<Float64 name="der(h)" valueReference="3" derivative="1"/>
<Float64 name="der(v)" valueReference="4" derivative="2"/>
<Int32 name="bounces" valueReference="5" causality="output" variability="discrete"/>
<Boolean name="pushed" valueReference="6" causality="output" variability="discrete"/>
<Float64 name="limit" valueReference="7" causality="parameter" variability="fixed" start="1e9"/>
<Float64 name="z" valueReference="8"/>
</ModelVariables>
<ModelStructure><Output valueReference="1"/><Output valueReference="2"/>
<Output valueReference="5"/><Output valueReference="6"/>
<ContinuousStateDerivative valueReference="3"/><ContinuousStateDerivative valueReference="4"/>
<EventIndicator valueReference="8"/></ModelStructure>
</fmiModelDescription>
"""


def ball_fmu(folder: Path, fmi: int) -> Path:
    """Build the FMU."""
    source = Path(__file__).with_name("ball.c")
    return stubbed(source, folder, fmi, _XML_2 if fmi == 2 else _XML_3)


def free_fall(times: np.ndarray) -> dict[str, np.ndarray]:
    """Return height, speed and number of bounces, solved exactly from event to event."""
    t, h, v, bounces, pushed = 0.0, 1.0, 0.0, 0, False
    rows = []
    for time in times:
        while True:
            landing = t + (v + math.sqrt(v * v + 2 * 9.81 * h)) / 9.81
            event = landing if pushed else min(landing, 0.25)
            if event > time:
                break
            s = event - t
            t, h, v = event, h + v * s - 9.81 * s * s / 2, v - 9.81 * s
            if pushed or landing < 0.25:
                h, v, bounces = 0.0, -0.7 * v, bounces + 1
            else:
                v, pushed = v + 2, True
        s = time - t
        rows.append((h + v * s - 9.81 * s * s / 2, v - 9.81 * s, bounces, float(pushed)))
    return dict(zip(("h", "v", "bounces", "pushed"), np.array(rows).T, strict=True))
