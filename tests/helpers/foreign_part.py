"""Small FMUs of FMI 2.0 as other tools write them, with chosen faults."""

import subprocess
from itertools import count
from pathlib import Path

from cosim.codegen.compiler import find_compiler
from cosim.fmi.export.package import zipped

DESCRIPTION = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="{name}" guid="{{{name}}}"
    generationTool="other" numberOfEventIndicators="0">
  <{interface} modelIdentifier="{name}" {abilities}/>
  <DefaultExperiment startTime="0" stopTime="1"{step_size}/>
  <ModelVariables>
    <ScalarVariable name="u" valueReference="0" causality="input" variability="continuous">
      <Real start="0"/>
    </ScalarVariable>
    <ScalarVariable name="y" valueReference="1" causality="output" variability="{varies}"
        initial="calculated"><Real/></ScalarVariable>
    <ScalarVariable name="x" valueReference="2" causality="local" variability="continuous"
        initial="exact"><Real start="0"/></ScalarVariable>
    <ScalarVariable name="der(x)" valueReference="3" causality="local" variability="continuous"
        initial="calculated"><Real derivative="3"/></ScalarVariable>
  </ModelVariables>
  <ModelStructure>
    <Outputs><Unknown index="2"/></Outputs>
    <Derivatives><Unknown index="4"/></Derivatives>
    <InitialUnknowns><Unknown index="2"/><Unknown index="4"/></InitialUnknowns>
  </ModelStructure>
</fmiModelDescription>"""
ABILITIES = {
    "canHandleVariableCommunicationStepSize": "true",
    "canInterpolateInputs": "true",
    "maxOutputDerivativeOrder": "1",
    "canGetAndSetFMUstate": "true",
    "canSerializeFMUstate": "true",
    "providesDirectionalDerivative": "true",
}
SAVES = ("canGetAndSetFMUstate", "canSerializeFMUstate", "providesDirectionalDerivative")
EXCHANGE = dict.fromkeys(SAVES, "true")
KINDS = ("plant", "controller", "lag", "holder")
_number = count()


def foreign_part(
    folder: Path,
    kind: str,
    *,
    fault: str | dict[str, str] = "",
    grid: float = 0.0,
    divides: bool = False,
    step_size: float | None = None,
    interface: str = "CoSimulation",
    varies: str = "continuous",
    resets: bool = True,
    **abilities: str,
) -> Path:
    """Write an FMU.

    Args:
        folder: Where to write it.
        kind: plant, v' = (u + 10)/3, y = v; controller with integral part and limited output;
            lag, x' = u - x, y = x; holder, x' = 0, y = x.
        fault: C statements at the begin of each step, or in model exchange of each evaluation of
            the derivative; `self`, `time` and `size` are known there. A step that returns 2 ends
            the run where `self->ended` is set.
            A dictionary has those of MADE, where it is instantiated, and of READY, where its
            initialization ends, with `self`.
        grid: The state after a step is rounded to a multiple of this number.
        divides: The derivative of the output is y/0 until the first step.
        step_size: The file declares steps of this size, s.
        interface: That the file declares.
        varies: The variability of the output.
        resets: Whether its reset does anything.
        abilities: Attributes of the interface that differ from those of a file that can do all.
    """
    name = f"{kind}_{next(_number)}"
    source, library = folder / f"{name}.c", folder / f"{name}.so"
    defines = {"KIND": KINDS.index(kind), "DIVIDES": int(divides), "GRID": float(grid)}
    defines["RESETS"] = int(resets)
    faults = fault if isinstance(fault, dict) else {"FAULT": fault}
    defines |= dict.fromkeys(("FAULT", "MADE", "READY"), "") | faults
    lines = [f"#define {key} {value}\n" for key, value in defines.items()]
    source.write_text("".join(lines) + Path(__file__).with_name("foreign_part.c").read_text())
    flags = ["-shared", "-fPIC", "-O1", "-o", str(library), str(source), "-lm"]
    subprocess.run([*find_compiler(), *flags], check=True)
    usual = ABILITIES if interface == "CoSimulation" else EXCHANGE
    attributes = " ".join(f'{key}="{value}"' for key, value in (usual | abilities).items())
    text = DESCRIPTION.format(
        name=name,
        interface=interface,
        varies=varies,
        abilities=attributes,
        step_size="" if step_size is None else f' stepSize="{step_size}"',
    )
    files = {"modelDescription.xml": text.encode()}
    files[f"binaries/linux64/{name}.so"] = library.read_bytes()
    target = folder / f"{name}.fmu"
    target.write_bytes(zipped(files))
    return target
