"""`cosim new FILE.py`: a model of one's own to start from, a damped pendulum."""

from __future__ import annotations

import argparse
import sys

from cosim.cli.options import Parser

TEXT = '''"""A damped pendulum: replace it by your system.

Run it with: cosim simulate {file}:build
"""

from casadi import cos, sin

from cosim import Model


def build():
    """Return the model; every number has a unit, every variable a meaning."""
    model = Model("{name}", description="damped pendulum", stop_time=10.0)
    length = model.parameter("length", "m", 1.0, "from the pivot to the mass", positive=True)
    mass = model.parameter("mass", "kg", 1.0, "of the bob", positive=True)
    damping = model.parameter("damping", "N.m.s/rad", 0.1, "of the pivot")
    g = model.parameter("g", "m/s2", 9.81, "gravity")
    torque = model.input("torque", "N.m", 0.0, "of a motor at the pivot")

    phi = model.state("phi", "rad", 0.5, "angle from hanging", display_unit="deg")
    phi_dot = model.state("phi_dot", "rad/s", 0.0, "its rate")

    inertia = mass * length**2
    moment = torque - damping * phi_dot - mass * g * length * sin(phi)
    model.derivative(phi, phi_dot)
    model.derivative(phi_dot, moment / inertia)

    energy = inertia * phi_dot**2 / 2 - mass * g * length * cos(phi)
    model.output("energy", "J", energy, "kinetic and potential")
    return model.freeze()  # refuses a state without derivative, an undeclared symbol
'''


def add_options(parser: Parser) -> None:
    """Declare the verb."""
    parser.add_argument("file", metavar="FILE.py|-", help="- for standard output")


def run(args: argparse.Namespace) -> int:
    """Write a model file; an existing one is left alone."""
    from pathlib import Path

    from cosim.cli.tables import write_text
    from cosim.errors import UsageError

    path = Path("pendulum.py" if args.file == "-" else args.file)
    if path.suffix != ".py" or not path.stem.isidentifier():
        raise UsageError(f"cosim new: {path} cannot hold a model; give a name like pendulum.py")
    if args.file != "-" and path.exists():
        raise UsageError(f"cosim new: {path} exists; give another name")
    write_text(None if args.file == "-" else str(path), TEXT.format(file=path, name=path.stem))
    if args.file != "-" and not args.quiet:
        print(f"{path}; run it with: cosim simulate {path}:build", file=sys.stderr)
    return 0
