"""What a command line asks to run, and its run: complete, failed or interrupted."""

import argparse
import sys

from cosim.api import run_scene
from cosim.cli.arguments import inputs_in, names_in, scene_from, start_numbers, times_in
from cosim.cli.supervised import names_own_code
from cosim.errors import Interrupted, SolverError, UsageError
from cosim.scene.goals import GOALS
from cosim.scene.scene import Scene
from cosim.trajectory import Trajectory


def scene_or_none(args: argparse.Namespace) -> Scene | None:
    """Return the scene that a command line asks for; None for an FMU."""
    if args.model.endswith(".fmu"):
        return None
    refuse_timeout(args)
    return scene_from(args)


def refuse_timeout(args: argparse.Namespace) -> None:
    """Refuse a time limit where no FMU file is run.

    Raises:
        UsageError: One is given.
    """
    models = args.models if hasattr(args, "models") else [args.model]
    if args.timeout is not None and not any(map(names_own_code, models)):
        raise UsageError(
            "--timeout is for FMU files, PATH.py and scenes that name it; "
            "a model's run ends at its step limit"
        )


def run_or_partial(args: argparse.Namespace, scene: Scene | None) -> tuple[Trajectory, int]:
    """Return a run and its exit code; of a failed run, what was computed."""
    try:
        run = _road_run(args, scene)
        for text in run.stats.get("invalid", ()):
            print(f"warning: {run.model}: {text}", file=sys.stderr)
        if "error_estimate" in run.stats and not args.quiet:
            from cosim.study.accuracy.solver_selection import promise_kept

            print(promise_kept(run), file=sys.stderr)
        return run, 0
    except SolverError as error:
        if not isinstance(error.partial, Trajectory) or not len(error.partial):
            raise
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return error.partial, error.exit_code
    except Interrupted as error:
        if not isinstance(error.partial, Trajectory) or not len(error.partial):
            raise
        print(error, file=sys.stderr)
        return error.partial, 130


def _road_run(args: argparse.Namespace, scene: Scene | None) -> Trajectory:
    if scene is not None:
        if args.interface_type is not None:
            raise UsageError("--interface-type is for FMUs; a model takes --solver")
        if getattr(args, "master", None) is not None:
            raise UsageError("--master is for FMUs; a model takes --solver")
        return run_scene(
            scene,
            compiled=False if args.interpreted else None,
            on_invalid=args.on_invalid or "warn",
            drift_control=args.drift_control,
            stop_when=args.stop_when,
            output_times=times_in("--at", args.at) if getattr(args, "at", None) else None,
        )
    from cosim.fmi.run.isolated import simulate_apart
    from cosim.fmi.trust import require_trust

    own = (
        "solver",
        "absolute_tolerance",
        "step_size",
        "on_invalid",
        "drift_control",
        "interpreted",
        "stop_when",
    )
    for option in (*own, *GOALS):
        if getattr(args, option) not in (None, False):
            raise UsageError(f"--{option.replace('_', '-')} is for models; an FMU has its own")
    start = start_numbers(args, None)
    require_trust(args.model, trusted=args.trust)
    master = getattr(args, "master", None)
    return simulate_apart(
        args.model,
        **({} if master is None else {"master": master}),
        timeout=args.timeout,
        interface=args.interface_type,
        start_time=args.start_time,
        stop_time=args.stop_time,
        output_interval=args.output_interval,
        relative_tolerance=args.relative_tolerance,
        start=start,
        inputs=inputs_in(args),
        outputs=None if args.outputs is None else names_in(args.outputs),
    )
