"""FMUs whose functions are wrapped by C code that makes them wrong in one way."""

import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

from helpers.small_models import decay

from casadi_models.dae import Dae
from cosim.fmi.export.build import binaries
from cosim.fmi.export.options import FmuOptions
from cosim.fmi.export.package import source_files, zipped
from cosim.fmi.platforms import targets

SIGNATURES = {
    "fmi2GetReal": "fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[]",
    "fmi2SetReal": "fmi2Component c, const fmi2ValueReference vr[], size_t n, "
    "const fmi2Real value[]",
    "fmi2DoStep": "fmi2Component c, fmi2Real point, fmi2Real size, fmi2Boolean keep",
    "fmi2SetFMUstate": "fmi2Component c, fmi2FMUstate state",
    "fmi2GetFMUstate": "fmi2Component c, fmi2FMUstate *state",
    "fmi2FreeFMUstate": "fmi2Component c, fmi2FMUstate *state",
    "fmi2SetupExperiment": "fmi2Component c, fmi2Boolean hasTol, fmi2Real tolerance, "
    "fmi2Real start, fmi2Boolean hasStop, fmi2Real end",
    "fmi2EnterInitializationMode": "fmi2Component c",
    "fmi2ExitInitializationMode": "fmi2Component c",
    "fmi2Instantiate": "fmi2String name, fmi2Type kind, fmi2String guid, fmi2String place, "
    "const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean log",
    "fmi2SetTime": "fmi2Component c, fmi2Real time",
    "fmi2SetRealInputDerivatives": "fmi2Component c, const fmi2ValueReference vr[], size_t n, "
    "const fmi2Integer order[], const fmi2Real value[]",
    "fmi2GetRealOutputDerivatives": "fmi2Component c, const fmi2ValueReference vr[], size_t n, "
    "const fmi2Integer order[], fmi2Real value[]",
    "fmi2GetDerivatives": "fmi2Component c, fmi2Real x[], size_t n",
    "fmi2GetContinuousStates": "fmi2Component c, fmi2Real x[], size_t n",
    "fmi2SetContinuousStates": "fmi2Component c, const fmi2Real x[], size_t n",
    "fmi2GetNominalsOfContinuousStates": "fmi2Component c, fmi2Real x[], size_t n",
    "fmi2CompletedIntegratorStep": "fmi2Component c, fmi2Boolean keep, fmi2Boolean *enter, "
    "fmi2Boolean *terminate",
    "fmi2NewDiscreteStates": "fmi2Component c, fmi2EventInfo *info",
    "fmi2GetEventIndicators": "fmi2Component c, fmi2Real z[], size_t n",
    "fmi2EnterEventMode": "fmi2Component c",
    "fmi2EnterContinuousTimeMode": "fmi2Component c",
    "fmi2Terminate": "fmi2Component c",
    "fmi2Reset": "fmi2Component c",
    "fmi2SerializeFMUstate": "fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size",
    "fmi2SerializedFMUstateSize": "fmi2Component c, fmi2FMUstate state, size_t *size",
    "fmi2GetDirectionalDerivative": "fmi2Component c, const fmi2ValueReference unknowns[], "
    "size_t m, const fmi2ValueReference knowns[], size_t n, const fmi2Real seed[], "
    "fmi2Real value[]",
    "fmi2GetVersion": "void",
    "fmi2GetTypesPlatform": "void",
    "fmi2SetDebugLogging": "fmi2Component c, fmi2Boolean on, size_t n, const fmi2String names[]",
    "fmi3DoStep": "fmi3Instance c, fmi3Float64 point, fmi3Float64 size, fmi3Boolean keep, "
    "fmi3Boolean *event, fmi3Boolean *ends, fmi3Boolean *early, fmi3Float64 *last",
    "fmi2GetBoolean": "fmi2Component c, const fmi2ValueReference vr[], size_t n, "
    "fmi2Boolean value[]",
    "fmi3GetDirectionalDerivative": "fmi3Instance c, const fmi3ValueReference unknowns[], "
    "size_t m, const fmi3ValueReference knowns[], size_t n, const fmi3Float64 seed[], size_t o, "
    "fmi3Float64 value[], size_t p",
    "fmi3GetNumberOfEventIndicators": "fmi3Instance c, size_t *n",
    "fmi3GetAdjointDerivative": "fmi3Instance c, const fmi3ValueReference unknowns[], size_t m, "
    "const fmi3ValueReference knowns[], size_t n, const fmi3Float64 seed[], size_t o, "
    "fmi3Float64 value[], size_t p",
}
_RESULTS = {
    "fmi2Instantiate": "fmi2Component",
    "fmi2GetVersion": "const char *",
    "fmi2GetTypesPlatform": "const char *",
}


def wrapped(
    folder: Path, options: dict[str, Any] | None = None, dae: Dae | None = None, **bodies: str
) -> Path:
    """Build an FMU whose functions are wrapped.

    Args:
        options: Of `FmuOptions`.
        dae: The model; `decay()` if it is None.
        bodies: C code by function. `CALL` is the call of the sound one, `REF(name)` the value
            reference of a variable.
    """
    chosen = FmuOptions(identifier="wrapped", **(options or {}))
    files = source_files(dae or decay(), chosen)
    references = {
        variable.get("name"): variable.get("valueReference")
        for variable in ET.fromstring(files["modelDescription.xml"]).iter()
        if variable.get("valueReference")
    }
    for function, body in bodies.items():
        kind = _RESULTS.get(function, f"{function[:4]}Status")
        parameters = SIGNATURES[function]
        definition = re.compile(rf"^{re.escape(kind)} ?{function}\(", re.MULTILINE)
        (name,) = [
            n for n, c in files.items() if n.endswith(".c") and definition.search(c.decode())
        ]
        names = ", ".join(re.findall(r"(\w+)(?:\[\])?(?:,|$)", parameters.replace("void", "")))
        inner = definition.sub(f"static {kind} inner_{function}(", files[name].decode())
        own = body.replace("CALL", f"inner_{function}({names})")
        own = re.sub(r"REF\((.*?)\)", lambda match: references[match[1]], own)
        heads = ("math", "stdio", "stdlib", "string")
        head = "".join(f"#include <{h}.h>\n" for h in heads) + "extern double limit;\n"
        files[name] = f"{head}{inner}\n{kind} {function}({parameters}) {{{own}}}\n".encode()
    files["sources/equations.c"] += b"\ndouble limit;\n"
    sources = {Path(n).name: c for n, c in files.items() if n.startswith("sources/")}
    path = folder / "wrapped.fmu"
    made = binaries(sources, "wrapped", targets(["native"], chosen.fmi))
    path.write_bytes(zipped(files | made))
    return path
