"""Measurements of a command line: `--column`, `--time`, `--time-offset`."""

import argparse

from cosim.cli.arguments import assigned
from cosim.trajectory import Trajectory


def read_measured(args: argparse.Namespace, path: str, like: Trajectory | None) -> Trajectory:
    """Read a CSV file of measurements with the options of a command line.

    Args:
        args: The command line.
        path: The file.
        like: A run whose units and meanings apply to variables of the same names.
    """
    columns = dict(assigned("--column", args.columns, "HEADER"))
    return Trajectory.read_csv(
        path,
        columns=columns or None,
        time=args.time_column,
        time_offset=args.time_offset,
        like=like,
    )
