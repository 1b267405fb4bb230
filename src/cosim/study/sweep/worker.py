"""A dask worker of this machine, which ends with the sweep that started it."""

from cosim.host.child import die_with_parent
from cosim.host.optional_packages import optional_module

if __name__ == "__main__":
    die_with_parent()
    optional_module("distributed.cli.dask_worker", "sweep").main()
