"""How an FMU begins: initialization, its outputs there, callbacks, what may still be set."""

from collections.abc import Iterator
from contextlib import suppress

import numpy as np

from cosim.fmi.check.finding import ADVICE, WRONG, Finding, Rule
from cosim.fmi.check.trials.bench import MOST_NAMES, Bench, Skipped, some
from cosim.fmi.check.trials.repeating import few_numbers

NO_START = Rule("start", WRONG, "show it, and compute on with it", "mend its equations")
READ_EARLY = Rule(
    "initialization",
    WRONG,
    "stop where they solve loops between FMUs before the first step",
    "let outputs be read in initialization mode",
)
OTHER_EARLY = Rule(
    "initialization",
    ADVICE,
    "solve loops between FMUs with values that do not hold afterwards",
    "compute the outputs when they are read in initialization mode",
)
FIXED = Rule(
    "fixed",
    ADVICE,
    "let their users change it in a run, with what effect nobody knows",
    "refuse it with an error, or make it tunable",
)
CALLBACKS = Rule(
    "callbacks",
    WRONG,
    "crash or stop, those in C that pass no more than the FMI asks for",
    "do not call what was passed as NULL",
)
LOGGER = Rule(
    "logger", ADVICE, "crash if they pass no logger", "do not call a logger that was passed as NULL"
)
_NOISE = 1e-9  # of an output in nominal values


def start(bench: Bench, kind: str) -> Iterator[Finding]:
    """It instantiates, initializes, and its outputs are finite then."""
    with bench.session(kind) as session:
        session.start()
        outputs = bench.outputs()
        bad = ~np.isfinite(session.values(outputs))
        if bad.any():
            names = some([v.name for v, b in zip(outputs, bad, strict=True) if b])
            yield NO_START.at(kind, f"not finite at the start: {names}")


def initialization(bench: Bench, kind: str) -> Iterator[Finding]:
    """Its outputs can be read in initialization mode and keep their values when it ends."""
    outputs = bench.outputs()
    if not outputs:
        raise Skipped("it has no real outputs")
    with bench.session(kind) as session:
        session.enter()
        try:
            before = session.values(outputs)
        except Exception as error:
            yield READ_EARLY.at(kind, f"its outputs cannot be read in initialization mode: {error}")
            return
        session.instance.exitInitializationMode()
        after = session.values(outputs)
    for output, early, late in zip(outputs, before, after, strict=True):
        scale = max(abs(late), output.nominal)
        if not abs(early - late) <= _NOISE * scale and not (np.isnan(early) and np.isnan(late)):
            told = f"it is {early:.6g} in initialization mode, {late:.6g} right after it"
            yield OTHER_EARLY.at(output.name, told)


def fixed(bench: Bench, kind: str) -> Iterator[Finding]:
    """A fixed parameter is refused in a run."""
    every = bench.described.variables
    found = (v for v in every if v.causality == "parameter" and v.variability == "fixed")
    parameters = [v for v in found if bench.single(v)]
    if not parameters:
        raise Skipped("it has no fixed real parameter")
    for parameter in parameters[:MOST_NAMES]:  # a refusal may end the instance
        with bench.session(kind) as session:
            session.start()
            (value,) = session.values([parameter])
            with suppress(Exception):
                session.put(parameter, value)
                yield FIXED.at(parameter.name, "a fixed parameter is accepted in a run")


def callbacks(bench: Bench, kind: str) -> Iterator[Finding]:
    """It runs the same without the callbacks that importers need not pass."""
    yield from _without(bench, kind, CALLBACKS, logger=bench.second)


def logger(bench: Bench, kind: str) -> Iterator[Finding]:
    """It runs the same without a logger."""
    if not bench.second:
        raise Skipped("it is among the callbacks of FMI 3.0 that may be missing")
    yield from _without(bench, kind, LOGGER, logger=False)


def _without(bench: Bench, kind: str, rule: Rule, *, logger: bool) -> Iterator[Finding]:
    missing = "missing callbacks" if logger or rule is CALLBACKS else "a missing logger"
    with bench.session(kind) as session:
        wanted = few_numbers(session)
    with bench.session(kind) as session:
        try:
            session.instantiate_bare(logger=logger)
            got = few_numbers(session)
        except Exception as error:
            yield rule.at(kind, f"with {missing} it fails: {error}")
            return
    if got.tobytes() != wanted.tobytes():
        yield rule.at(kind, f"with {missing} it gives other numbers")
