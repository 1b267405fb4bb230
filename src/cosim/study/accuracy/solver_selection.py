"""`promised_run`: solver and tolerance follow from an accuracy, or from a time."""

from collections.abc import Sequence

import numpy as np

from casadi_models.dae import Dae
from cosim.study.accuracy.accurate_runs import accurate_run
from cosim.study.accuracy.budgeted_runs import affordable_run
from cosim.study.accuracy.checked_runs import Solve, labelled
from cosim.study.accuracy.front import measured_front
from cosim.trajectory import Trajectory


def promised_run(
    dae: Dae,
    solve: Solve,
    names: Sequence[str],
    length: float,
    compiled: bool,
    accuracy: float | None,
    budget: float | None,
) -> Trajectory:
    """Return a run whose estimated error is not above what is asked for, or the best within a time.

    Args:
        dae: The model, with the values at which its front is measured.
        solve: Runs it by a solver at a tolerance, with the values and times that are wanted.
        names: Outputs whose error counts.
        length: From the first to the last time of the run, s.
        compiled: Whether the equations are compiled.
        accuracy: Largest global error of these outputs, in nominal values; or None.
        budget: Time that the solver may take, s; what checks the run has its own; or None.

    Returns:
        With an `accuracy`, the most accurate run that it took, since it is there. `stats` tell the
        cheapest `configuration` that will do, its `promised_error`, what it was `checked_by`, the
        `error_estimate`, and the variable that has it. With a `budget`, the run of that
        configuration itself.

    Raises:
        ParameterError: Double precision does not carry that accuracy; or the front promises no
            configuration that is so fast.
        SolverError: The solvers fail, or no two of them agree so well (`partial` is the better run
            of the best two); or none was so fast on this run (`partial` is the cheapest one).
    """
    if not dae.states:
        run = solve()
        return labelled(run, {"accuracy": accuracy, "budget": budget} | _exact(run))
    front = measured_front(dae, compiled=compiled)
    if accuracy is not None:
        return accurate_run(dae, front, solve, names, accuracy)
    assert budget is not None
    return affordable_run(dae, front, solve, names, budget, length / dae.experiment.stop_time)


def promise_kept(run: Trajectory) -> str:
    """Say in a line what was promised of a run, and what its check found."""
    facts = run.stats
    if facts.get("budget") is not None:
        asked = f"budget {1e3 * facts['budget']:g} ms: {facts['configuration']}"
        asked += f" took {1e3 * facts.get('solve_time', 0.0):.2g} ms"
    else:
        asked = f"accuracy {facts['accuracy']:g}: {facts['configuration']}"
    return (
        f"{asked}; error promised {facts['promised_error']:.1e}, on this run "
        f"{facts['error_estimate']:.1e} ({facts['error_estimate_of']}), "
        f"checked by {facts['checked_by']}"
    )


def _exact(run: Trajectory) -> dict[str, object]:
    """Return what is known of a run without states, which no solver touches."""
    scaled = np.spacing(np.abs(run.values).max(axis=0)) / [c.nominal for c in run.columns]
    worst = int(np.argmax(scaled))
    return {
        "configuration": "no integration",
        "promised_error": float(scaled[worst]),
        "checked_by": "double precision",
        "error_estimate": float(scaled[worst]),
        "error_estimate_of": run.names[worst],
    }
