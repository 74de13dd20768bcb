"""Cells on Dask's workers: processes of this machine, or a running cluster."""

from __future__ import annotations

import importlib.util
import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

from deepir.errors import ConfigError
from deepir.sweep.cells import Cell
from deepir.sweep.work import finish_cell

if TYPE_CHECKING:
    from distributed import Client

LOOPBACK = "127.0.0.1"  # a scheduler runs whatever it is sent: nobody else may reach it
SCHEDULER_TIMEOUT = "10s"  # time for a scheduler to answer
#: Without Dask's MALLOC_TRIM_THRESHOLD_: returning memory after each operation costs most of the time.
WORKER_ENVIRONMENT = {"OMP_NUM_THREADS": 1, "MKL_NUM_THREADS": 1, "OPENBLAS_NUM_THREADS": 1}


def demand_dask() -> None:
    """Check that Dask is installed.

    Raises:
        ConfigError: It is not.
    """
    if importlib.util.find_spec("distributed") is None:
        raise ConfigError("compare and batch run on Dask, which is missing: pip install 'deepir[compare]'")


def core_count() -> int:
    """Number of cores that this process may use."""
    from dask.system import CPU_COUNT

    return int(CPU_COUNT)


def run_cells(
    cells: Sequence[Cell], *, workers: int, scheduler: str | None = None, plugins: Sequence[str] = ()
) -> Iterator[tuple[Cell, str | None]]:
    """Finish the cells; yields each as it ends, with its error or None.

    If a worker is lost, its cell continues on another worker.

    Args:
        cells: Their folders are visible to all workers.
        workers: Processes to start, each with one run at a time.
        scheduler: Address of a running Dask scheduler (`tcp://host:8786`) to use instead.
        plugins: Modules to import on the workers.

    Raises:
        ConfigError: The scheduler does not answer.
    """
    from distributed import as_completed

    with _client(workers, scheduler) as client:
        tasks = {
            client.submit(finish_cell, cell, plugins, pure=False, priority=-i): cell
            for i, cell in enumerate(cells)  # in order
        }
        for task in as_completed(list(tasks)):
            yield tasks[task], _failure(task.exception()) if task.status == "error" else task.result()


def _failure(error: BaseException) -> str:
    from distributed import KilledWorker

    if isinstance(error, KilledWorker):
        return "its workers died, one after another; if for want of memory, use fewer --workers, or data.crop"
    return " ".join(f"{type(error).__name__}: {error}".split())


@contextmanager
def _client(workers: int, scheduler: str | None) -> Iterator[Client]:
    import dask
    from distributed import Client, LocalCluster

    from deepir.sweep.work import IgnoreInterrupts

    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what matters, cells report
    settings = {
        "distributed.comm.timeouts.connect": SCHEDULER_TIMEOUT,
        "distributed.nanny.pre-spawn-environ": WORKER_ENVIRONMENT,
    }
    with dask.config.set(settings):
        if scheduler is not None:
            try:
                client = Client(scheduler, timeout=SCHEDULER_TIMEOUT)
            except (OSError, ValueError) as error:
                raise ConfigError(
                    f"--scheduler {scheduler}: no Dask scheduler answers there ({error})"
                ) from None
            with client:
                yield client
            return
        with (
            LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                host=LOOPBACK,
                memory_limit=0,  # a limit would halt for good a worker that keeps its memory
                dashboard_address=f"{LOOPBACK}:0",
                silence_logs=logging.CRITICAL,
            ) as cluster,
            Client(cluster) as client,
        ):
            client.register_plugin(IgnoreInterrupts())
            yield client
