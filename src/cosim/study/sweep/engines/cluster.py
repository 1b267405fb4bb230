"""The same chunks over the workers of a `dask.distributed` cluster."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from cosim.host.optional_packages import optional_module
from cosim.study.sweep.chunk import Job, Summary, compute_chunk
from cosim.study.sweep.engines.processes import after_death
from cosim.study.sweep.engines.schedule import Schedule
from cosim.study.sweep.samples import Samples


@contextmanager
def connected(scheduler: str, workers: int) -> Iterator[Any]:
    """Yield a client of a scheduler's address, or of a cluster of this machine for "local".

    Raises:
        MissingTool: dask.distributed is not there.
        OSError: Nobody answers at the address.
    """
    distributed = optional_module("distributed", "sweep")
    if scheduler != "local":
        with distributed.Client(scheduler, set_as_default=False) as client:
            yield client
        return
    options = {"distributed.scheduler.allowed-failures": 0}  # a chunk that kills is ours to handle
    with (
        optional_module("dask", "sweep").config.set(options),
        distributed.LocalCluster(
            n_workers=workers, threads_per_worker=1, dashboard_address=None, processes=True
        ) as cluster,
        distributed.Client(cluster, set_as_default=False) as client,
    ):
        yield client


def run_cluster(
    job: Job, samples: Samples, schedule: Schedule, tell: Callable[[Summary], None], client: Any
) -> None:
    """Compute all chunks on a cluster whose workers see the store's folder.

    Args:
        job, samples, schedule, tell: As in `run_processes`.
        client: Of the cluster.

    Raises:
        CosimError: A chunk cannot be computed at all.
    """
    distributed = optional_module("distributed", "sweep")
    under_way: dict[Any, tuple[int, int]] = {}
    arriving = distributed.as_completed(loop=client.loop)

    def submit() -> None:
        most = 2 * max(1, sum(client.nthreads().values()))
        while len(under_way) < most and (chunk := schedule.take(wait=False)) is not None:
            columns = samples.part(*chunk)
            future = client.submit(compute_chunk, job, chunk[0], columns, pure=False, retries=0)
            under_way[future] = chunk
            arriving.add(future)

    try:
        submit()
        while under_way:
            future = next(arriving)
            chunk = under_way.pop(future)
            error = future.exception()
            if isinstance(error, distributed.KilledWorker):
                told = after_death(job, schedule, chunk, "KilledWorker")
                if told is not None:
                    tell(told)
            elif error is not None:
                raise error
            else:
                summary = future.result()
                schedule.done(chunk, summary.numbers, summary.seconds)
                tell(summary)
            submit()
    finally:
        schedule.stop()
        client.cancel(list(under_way))
