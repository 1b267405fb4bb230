"""What a user may ask for instead of a solver and its tolerance: an accuracy, or a time."""

from cosim.errors import UsageError
from cosim.model.values import number

GOALS = ("accuracy", "budget")
OVERRULED = ("solver", "relative_tolerance", "absolute_tolerance", "step_size")


def refuse_contradiction(accuracy: object, budget: object, **settings: object) -> None:
    """Refuse a goal that is no positive number, a second one, or what it would overrule.

    Args:
        accuracy: Global error in nominal values, or None.
        budget: Time of the solver, s, or None.
        settings: What a goal chooses itself (`OVERRULED`), None where it is not given.

    Raises:
        ParameterError: A goal is not finite or not positive.
        UsageError: Two things are given of which one decides on the other.
    """
    if accuracy is None and budget is None:
        return
    goals = dict(zip(GOALS, (accuracy, budget), strict=True))
    given = [name for name, value in goals.items() if value is not None]
    for name in given:
        number("run", name, goals[name], positive=True)
    if len(given) == 2:
        raise UsageError("accuracy and budget are both given; one follows from the other: give one")
    fixed = [name for name, value in settings.items() if value is not None]
    if given and fixed:
        raise UsageError(
            f"{given[0]} chooses solver and tolerance itself, but {fixed[0]} is given, too; "
            "leave one of them out"
        )
