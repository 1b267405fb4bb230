"""The two fallbacks of a native run after a failure; the run reports which one was used.

1. If IDAS fails with the algebraic unknowns in its error test, it runs without them.
2. If the compiler does not end, the equations are interpreted.

Everything else is decided before a run, or rejected with a remedy.
"""

from dataclasses import replace

from cosim.errors import CompilerTimeout, CosimError, SolverError
from cosim.integrate.families.sundials import Idas
from cosim.integrate.preparation import Prepared
from cosim.model.request import RunRequest
from cosim.text import EndKind


def next_request(
    request: RunRequest, prepared: Prepared, failure: CosimError
) -> tuple[RunRequest, str] | None:
    """Return the request to run after a failed one, with the reason for the report.

    Args:
        request: The request that failed.
        prepared: Its plan.
        failure: The error that it raised.

    Returns:
        None if there is no fallback.
    """
    solver = prepared.inner
    if isinstance(failure, CompilerTimeout):
        optional = request.policy.compiled is None and not request.policy.projects
        if not optional or prepared.solver.compiled_only:
            return None
        policy = replace(request.policy, compiled=False)
        return replace(request, policy=policy), f"interpreted: {failure}"
    if not isinstance(failure, SolverError) or not isinstance(solver, Idas):
        return None
    # beyond a singularity, a retried run could follow another branch of the solution
    singular = failure.ending.kind is EndKind.SINGULAR
    if solver.suppress_algebraic or singular or not request.dae.algebraics:
        return None
    lenient = replace(solver, suppress_algebraic=True)
    note = f"IDAS ran without the algebraic unknowns in its error test; with them: {failure.ending}"
    return replace(request, solver=lenient), note
