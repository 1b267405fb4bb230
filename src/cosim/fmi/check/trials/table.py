"""The trials of an FMU, in the order in which they are made."""

from cosim.fmi.check.trials.bench import Trial
from cosim.fmi.check.trials.compiling import sources
from cosim.fmi.check.trials.influence import dependencies
from cosim.fmi.check.trials.repeating import instances, reset, rollback
from cosim.fmi.check.trials.slopes import derivatives
from cosim.fmi.check.trials.starting import callbacks, fixed, initialization, logger, start
from cosim.fmi.check.trials.stepping import steps, stop

TRIALS: tuple[Trial, ...] = (
    *(start, initialization, reset, instances, rollback, derivatives, dependencies, fixed),
    *(callbacks, logger, stop, steps, sources),
)
"""The first must pass before any other is made."""
OPTIONAL = frozenset({"logger"})
"""Those that ask for more than the FMI does: whatever happens there is advice."""
