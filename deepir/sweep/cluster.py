"""Cells on Dask's workers: processes of this machine, or a running cluster."""

from __future__ import annotations

import logging
import signal
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import dask
from dask.system import CPU_COUNT
from distributed import Client, KilledWorker, LocalCluster, Worker, WorkerPlugin, as_completed

from deepir.config import Config, Data
from deepir.config.schema import Output, Solver
from deepir.errors import ConfigError, DeepIRError
from deepir.registry import load_plugin
from deepir.runner import execute, prepare
from deepir.simulate import Settings, simulate
from deepir.storage.stored import resume, run_into
from deepir.sweep.cells import Cell

CORES: int = CPU_COUNT  # that this process may use
LOOPBACK = "127.0.0.1"  # a scheduler runs whatever it is sent: nobody else may reach it
SCHEDULER_TIMEOUT = "10s"  # time for a scheduler to answer
#: Without Dask's MALLOC_TRIM_THRESHOLD_: returning memory after each operation costs most of the time.
WORKER_ENVIRONMENT = {"OMP_NUM_THREADS": 1, "MKL_NUM_THREADS": 1, "OPENBLAS_NUM_THREADS": 1}
PROCESS_LOCK = threading.Lock()  # one run at a time: torch's seed and the package's log belong to the process
WARM_UP_SHAPE = (40, 48)  # size of the frames by which a process is warmed up, px


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
    with _client(workers, scheduler) as client:
        tasks = {
            client.submit(finish_cell, cell, plugins, pure=False, priority=-i): cell
            for i, cell in enumerate(cells)  # in order
        }
        for task in as_completed(list(tasks)):
            yield tasks[task], _failure(task.exception()) if task.status == "error" else task.result()


def _failure(error: BaseException) -> str:
    if isinstance(error, KilledWorker):
        return "its workers died, one after another; if for want of memory, use fewer --workers, or data.crop"
    return " ".join(f"{type(error).__name__}: {error}".split())


@contextmanager
def _client(workers: int, scheduler: str | None) -> Iterator[Client]:
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
                raise ConfigError(f"--scheduler {scheduler}: no Dask scheduler answers there ({error})") from None
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


class IgnoreInterrupts(WorkerPlugin):
    """Ignore Ctrl-C, which a terminal sends to the workers too; each would end with a traceback."""

    name = "deepir-uninterrupted"

    def setup(self, worker: Worker) -> None:
        """Called in the main thread of each worker as it starts, replacements included."""
        signal.signal(signal.SIGINT, signal.SIG_IGN)


_warm: set[str] = set()  # what this process has run


def finish_cell(cell: Cell, plugins: Sequence[str] = ()) -> str | None:
    """Run a cell, or continue it where a lost worker left it; its error in one line, or None."""
    with PROCESS_LOCK:
        try:
            for each in plugins:
                load_plugin(each)
            _warm_up(cell.config)
            with suppress(OSError):  # on Linux; elsewhere the peak is that of all cells so far
                Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
            state = cell.folder.state()
            if state == "interrupted":
                resume(cell.folder.path, plugins=plugins)
            elif state == "new":
                run_into(cell.config, cell.folder.path, plugins=plugins)
        except DeepIRError as error:
            return " ".join(str(error).split())
        except Exception as error:  # whatever it is, it ends this cell only
            return _failure(error)
    return None


def _warm_up(config: Config) -> None:
    """Run small frames first, once for each method in a process: loading and compiling is no part of its seconds."""
    kind = config.model_dump_json(include={"problem", "method", "prior", "physics", "device"})
    if kind in _warm:
        return
    _warm.add(kind)
    small = config.model_copy(
        update={"data": Data(fps=config.data.fps), "output": Output(), "solver": Solver(max_iterations=1)}
    )
    with suppress(Exception):  # the run itself says what is wrong
        frames = simulate(settings=Settings(shape=WARM_UP_SHAPE, n_frames=4)).frames
        execute(small, prepare(small, frames))
