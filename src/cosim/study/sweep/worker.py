"""A dask worker of this machine, which ends with the sweep that started it."""

from cosim.host.child import die_with_parent

if __name__ == "__main__":
    die_with_parent()
    from distributed.cli.dask_worker import main

    main()
