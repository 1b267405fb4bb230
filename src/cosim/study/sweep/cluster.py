"""The blocks of a sweep over the workers of a `dask.distributed` cluster."""

import logging
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from threading import Event, Thread
from typing import Any
from uuid import uuid4

from cosim.arrays import Vector
from cosim.errors import CosimError, UsageError
from cosim.host.child import Child
from cosim.host.optional_packages import optional_module
from cosim.host.temporary import temporary_folder
from cosim.study.sweep.block import Block, Job, joined
from cosim.study.sweep.samples import Samples

dask: Any = optional_module("dask", "sweep")
distributed: Any = optional_module("distributed", "sweep")

_PATIENCE = 120  # s, for the first worker
_WORKER = "cosim.study.sweep.worker"
_MOST_PROCESSES = 10_000  # of a worker, one after the other


class SweepPlugin(distributed.WorkerPlugin):  # type: ignore[misc] # dask is an extra
    """The job of a sweep; dask sends it once to every worker, also to one that replaces another."""

    def __init__(self, job: Job) -> None:
        self.name = f"cosim-sweep-{uuid4().hex}"
        self.job = job
        self._path = list(sys.path)

    def setup(self, worker: object) -> None:
        """Let users' functions find their modules."""
        sys.path.extend(folder for folder in self._path if folder not in sys.path)

    def teardown(self, worker: object) -> None:
        """Free what the subject holds."""
        self.job.subject.close()


@contextmanager
def connected(scheduler: str, workers: int) -> Iterator[Any]:
    """Yield a client of the scheduler at an address, or of a new cluster of local processes.

    Raises:
        UsageError: No scheduler answers at an address such as "tcp://HOST:8786".
    """
    if scheduler != "local":
        try:
            client = distributed.Client(scheduler, set_as_default=False)
        except (OSError, ValueError) as error:
            raise UsageError(
                f"no dask scheduler answers at {scheduler} ({error}); start one: dask scheduler"
            ) from error
        with client:
            yield client
        return
    with ExitStack() as stack:
        # a block is tried on two workers, then each of its runs alone on two
        stack.enter_context(dask.config.set({"distributed.scheduler.allowed-failures": 1}))
        folder = str(stack.enter_context(temporary_folder()))  # dask leaves what it writes
        stack.enter_context(dask.config.set({"temporary-directory": folder}))
        for name in ("distributed", "distributed.client"):  # which dask gives levels of their own
            logging.getLogger(name).setLevel(logging.CRITICAL)  # also after the end
        ports: Any = {"dashboard_address": None, "scheduler_kwargs": {"dashboard_address": ":0"}}
        local = distributed.LocalCluster(n_workers=0, silence_logs=False, **ports)
        cluster = stack.enter_context(local)
        client = stack.enter_context(distributed.Client(cluster, set_as_default=False))
        stack.enter_context(_working(client, cluster.scheduler_address, workers, folder))
        yield client


@contextmanager
def _working(client: Any, scheduler: str, workers: int, folder: str) -> Iterator[None]:
    """Run a process for each worker, and another one in its place when a run ends it."""
    # dask's own processes would run the user's script again, which needs a guard in it
    words = [scheduler, "--no-nanny", "--nthreads", "1", "--no-dashboard", "--death-timeout", "60"]
    settings = {"DISTRIBUTED__LOGGING__DISTRIBUTED": "critical", "TEMPORARY_DIRECTORY": folder}
    environment = {f"DASK_{name}": value for name, value in settings.items()}
    done = Event()

    def work() -> None:
        for _ in range(_MOST_PROCESSES):
            with Child(_WORKER, words, environment=environment) as child:
                while child.wait(0.1) is None:
                    if done.wait(0.1):
                        return
        client.close()  # ends the sweep

    threads = [Thread(target=work, daemon=True) for _ in range(workers)]
    for thread in threads:
        thread.start()
    try:
        yield
    finally:
        done.set()
        for thread in threads:
            thread.join()


def over_cluster(
    job: Job, samples: Samples, blocks: Iterable[tuple[int, int]], client: Any
) -> Iterator[Block]:
    """Yield blocks in the order in which the workers of a cluster finish them.

    If a block ends the workers that compute it, its runs are computed alone, one after the other,
    after all other blocks. A run that still ends its workers is lost.
    """
    plugin = SweepPlugin(job)
    client.register_plugin(plugin, name=plugin.name)
    try:
        client.wait_for_workers(1, timeout=_PATIENCE)
    except TimeoutError as error:
        raise CosimError(
            f"no worker of the sweep has started within {_PATIENCE} s; see above, or run in this "
            "process with workers=0 (--workers 0)"
        ) from error

    def submit(first: int, count: int, alone: bool = False) -> Any:
        columns = samples.part(first, count)
        return client.submit(_compute, plugin.name, first, columns, alone, pure=False, retries=0)

    futures = {submit(*block): block for block in blocks}
    deadly: list[tuple[int, int]] = []
    try:
        for future in distributed.as_completed(list(futures), loop=client.loop):
            block = futures.pop(future)
            computed = _result(future)
            if computed is None:
                deadly.append(block)
            else:
                yield computed
        for first, count in deadly:
            runs: list[Block] = []
            for run in range(first, first + count):
                alone = _result(submit(run, 1, alone=True))
                runs.append(alone or job.lost(run, "every process that computes it ends"))
            yield job.reduced(joined(runs))
    finally:
        client.cancel(list(futures))
        client.unregister_worker_plugin(plugin.name)


def _result(future: Any) -> Block | None:
    """A computed block; None if its workers ended, also one that held it before it was fetched."""
    try:
        block: Block = future.result()
    except distributed.KilledWorker:
        return None
    return block


def _compute(plugin: str, first: int, columns: Mapping[str, Vector], alone: bool) -> Block:
    """Compute a block on a worker; with all trajectories for one of the runs that go alone."""
    job: Job = distributed.get_worker().plugins[plugin].job
    block = job.compute(first, columns)
    return block if alone else job.reduced(block)
