"""Inputs read in a process of their own, bounded in time and memory; what dies or hangs is counted, and it goes on."""

from __future__ import annotations

import ctypes
import logging
import os
import resource
import shutil
import tempfile
import time
import traceback
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from reliability_inputs import SETTINGS, Input, make_input, whole_files

from deepir.config import load
from deepir.config.schema import Data, Raw
from deepir.errors import DeepIRError
from deepir.io import describe, read_frames, stream_data
from deepir.io.readers import samples_file

OUTCOMES = ("read", "refused", "other error", "crash", "over 5 s", "over 1 GB")
READ, REFUSED, ERROR, CRASH, SLOW, LARGE = range(len(OUTCOMES))
KINDS = (*whole_files(), "bomb, cycle")
MAX_SECONDS = 5.0  # of the processor for an input
LOOK_SECONDS = 0.2  # between looks at a worker
HANGING_LOOKS = 100  # at the same input, after which it is ended; not a clock: both processes may be paused
MAX_BYTES = 2**30  # of memory for an input
#: Where inputs are written: in memory, where there is such a folder.
SCRATCH = Path("/dev/shm") if Path("/dev/shm").is_dir() else None
FOUND = Path(__file__).parent.parent / "runs" / "reliability"  # what was not read or refused as it should


def count_inputs(start: int, stop: int) -> dict[str, np.ndarray]:
    """Counts (kinds, outcomes) of the inputs from `start` to before `stop`."""
    load("nuc")  # imports what is shared by all workers
    fork = get_context("fork")
    counts = fork.Array(ctypes.c_int64, len(KINDS) * len(OUTCOMES), lock=False)
    now = fork.Value(ctypes.c_int64, start, lock=False)
    while now.value < stop:
        with tempfile.TemporaryDirectory(dir=SCRATCH) as scratch:
            worker = fork.Process(target=_work, args=(now, stop, counts, Path(scratch)))
            worker.start()
            looks, last = 0, now.value
            while worker.is_alive() and looks < HANGING_LOOKS:
                worker.join(LOOK_SECONDS)
                looks, last = (looks + 1, last) if now.value == last else (0, now.value)
            if slow := worker.is_alive():
                worker.kill()
                worker.join()
        if now.value < stop:
            _count(counts, make_input(now.value), SLOW if slow else CRASH, now.value, f"exit {worker.exitcode}")
            now.value += 1
    return {"counts": np.array(counts[:]).reshape(len(KINDS), len(OUTCOMES))}


def _work(now: Any, stop: int, counts: Any, folder: Path) -> None:
    """Read the inputs from `now` on, which says how far it is."""
    logging.disable(logging.CRITICAL)
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 2)
    held = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (held + MAX_BYTES, held + MAX_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    while now.value < stop:
        made = make_input(now.value)
        paths = [_write(folder, name, content) for name, content in made.files.items()]
        for name, target in made.links.items():
            (folder / name).symlink_to(target)
        before = time.process_time()
        outcome, why = _outcome(made, folder, also_stream=now.value % 2 == 0)
        if time.process_time() - before > MAX_SECONDS:
            outcome = SLOW
        _count(counts, made, outcome, now.value, why)
        for path in paths:
            path.unlink()
        if made.links:
            shutil.rmtree(folder / "folder")
        now.value += 1


def _write(folder: Path, name: str, content: bytes) -> Path:
    path = folder / name
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(content)
    return path


def _outcome(made: Input, folder: Path, *, also_stream: bool) -> tuple[int, str]:
    try:
        _read(made, folder, also_stream=also_stream)
    except DeepIRError as error:
        return (LARGE if "machine's memory" in str(error) else REFUSED), str(error)
    except MemoryError:
        return LARGE, traceback.format_exc()
    except BaseException:
        return ERROR, traceback.format_exc()
    return READ, ""


def _read(made: Input, folder: Path, *, also_stream: bool) -> None:
    """Read an input as a command would."""
    name = next(iter(made.files))
    if name == SETTINGS:
        load("nuc", [line for line in made.files[name].decode(errors="replace").split("\n") if line])
    elif name.endswith(".yaml"):
        load(folder / name)
    else:
        path = folder / name.partition("/")[0]
        options = {"raw": _raw(made.options["raw"])} if made.options else {}
        describe(read_frames(path, **options))
        if also_stream:
            for _ in stream_data(Data(path=str(path), **options)):
                pass
            samples_file(path)


def _raw(layout: dict[str, Any]) -> Raw | None:
    """The layout as a configuration has it."""
    settings = [f"data.raw.{key}={value}" for key, value in layout.items() if value is not None]
    return load("nuc", settings).data.raw


def _count(counts: Any, made: Input, outcome: int, number: int, why: str) -> None:
    """Count an outcome; keep the input where it is none that may be."""
    counts[KINDS.index(made.kind) * len(OUTCOMES) + outcome] += 1
    if outcome in (READ, REFUSED):
        return
    folder = FOUND / f"{number}"
    for name, content in made.files.items():
        folder.mkdir(parents=True, exist_ok=True)
        _write(folder, name, content)
    (folder / "why.txt").write_text(f"{OUTCOMES[outcome]}: {made.kind}, {made.damage}\n{made.options}\n{why}\n")
