"""What a reduction says of itself."""

from collections.abc import Collection, Iterator

import casadi as ca

from casadi_models.dae import Dae


def reduction_report(full: Dae, small: Dae, freeze: Collection[str]) -> Iterator[str]:
    """Yield in words what went and why, pass by pass."""
    if freeze:
        yield f"freeze: {', '.join(freeze)} became numbers"
    passes = (
        ("outputs", full.output_variables, small.output_variables, "not asked for"),
        ("states", full.states, small.states, "no output asked for depends on them"),
        ("algebraics", full.algebraics, small.algebraics, "nothing kept needs them"),
        ("inputs", full.inputs, small.inputs, "they act on nothing kept"),
        ("parameters", full.parameters, small.parameters, "they act on nothing kept"),
    )
    for what, before, after, why in passes:
        names = {v.name for v in after}
        gone = [v.name for v in before if v.name not in names and v.name not in freeze]
        if gone:
            yield f"{what}: {len(before)} -> {len(after)}; {', '.join(gone)}: {why}"
    watched = {meaning for _, meaning in small.limits}
    if gone := [meaning for _, meaning in full.limits if meaning not in watched]:
        yield f"limits: {len(full.limits)} -> {len(watched)}; not watched: {'; '.join(gone)}"
    everything = ca.vertcat(small.ode, small.alg, small.outputs)
    if not ca.depends_on(everything, small.t):
        yield "time: the equations do not depend on it"
    counts = [str(dae.operations(with_outputs=True)) for dae in (full, small)]
    yield f"operations: {' -> '.join(counts)}"
