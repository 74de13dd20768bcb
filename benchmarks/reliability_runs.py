"""`deepir run` killed, on a full disk, from a damaged state, and twice at once: results are whole, and the same."""

from __future__ import annotations

import functools
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from reliability_fuzz import FOUND

from deepir import registry
from deepir.cli import main
from deepir.optim import solve
from deepir.simulate import Settings, simulate
from deepir.storage import stored  # noqa: F401 - imported before the forks
from deepir.storage.folder import RunFolder

RUN = ("run", "nuc", "data.path=burst.npz", "threads=1", "solver.max_iterations=6")
#: Events of Python's audit in the folder of a run, at which it is killed.
EVENTS = ("open", "os.mkdir", "os.rename", "os.remove", "os.rmdir")
DISK_BYTES = 2**22  # size of a disk
PAGE_BYTES = 4096  # steps of the room that is left on it
NEEDED_BYTES = 400_000  # that a run writes, roughly


def count_runs(part: str, start: int, stop: int) -> dict[str, np.ndarray]:
    """Tries of a part, of the numbers from `start` to before `stop`, and those that were not as they should be."""
    for kind in registry.COMPONENT_MODULES:
        registry.components(kind)
    before, every = Path.cwd(), solve.solve.__kwdefaults__["every"]
    solve.solve.__kwdefaults__["every"] = 0.0  # a state after each iteration
    failed = 0
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            np.savez("burst.npz", frames=simulate(None, Settings(shape=(24, 32), n_frames=3), seed=1).frames)
            for seed in (0, 1):
                _demand(_status(_fork(*RUN, f"seed={seed}", f"output.dir=alone{seed}")) == 0, "a run alone fails")
            for number in range(start, stop):
                try:
                    RUNS[part](np.random.default_rng(number), number)
                except AssertionError as error:
                    failed += 1
                    FOUND.mkdir(parents=True, exist_ok=True)
                    (FOUND / f"{part} {number}.txt").write_text(f"{error}\n")
                shutil.rmtree("tried", ignore_errors=True)
        finally:
            os.chdir(before)
            solve.solve.__kwdefaults__["every"] = every
    return {"tries": np.array(stop - start), "failed": np.array(failed)}


def kill(rng: np.random.Generator, number: int) -> None:
    """resumed: the bits of a run that was left alone"""
    whole = _seconds()
    process = _fork(*RUN, "seed=0", "output.dir=tried")
    time.sleep(rng.uniform(0, whole))
    os.kill(process, signal.SIGKILL)
    os.waitpid(process, 0)
    _finish(0)


def kill_at_event(rng: np.random.Generator, number: int) -> None:
    """the former result is whole until the new one is; resumed: the bits of a run that was left alone"""
    at = 1 + number % _events()
    shutil.copytree("alone1", "tried")
    _status(_fork(*RUN, "seed=0", "output.dir=tried", "--overwrite", events=at))
    moved = Path("tried/.unfinished/metrics.json").exists()  # the new result is whole, and takes its place next
    _demand(moved or any(map(_is_result_of, (0, 1))), f"event {at}: neither the former result nor the new one")
    _finish(0)


def full_disk(rng: np.random.Generator, number: int) -> None:
    """status 2, no half file, the former result; with room again, resumed: the bits of a run that was left alone"""
    former = number % 2
    with _disk() as mounted:
        if former:
            shutil.copytree("alone1", "tried", dirs_exist_ok=True)
        room = int(rng.integers(NEEDED_BYTES // PAGE_BYTES)) * PAGE_BYTES
        before = _contents()
        if mounted:
            used = shutil.disk_usage("tried").free - room
            Path("tried/ballast").write_bytes(bytes(max(0, used)))
        status = _status(_fork(*RUN, "seed=0", "output.dir=tried", *["--overwrite"] * former, most=room))
        if mounted:
            Path("tried/ballast").unlink()
        _demand(status in (0, 2), f"{room} bytes left: status {status}")
        if status:
            _demand(_contents() == before or not former, f"{room} bytes left: the former result has changed")
            left = [path.name for path in Path("tried").rglob(".*.*")] + [*Path("tried").rglob("*.part")]
            _demand(not [name for name in left if name != ".lock"], f"{room} bytes left: half files {left}")
        _finish(0)


def flip(rng: np.random.Generator, number: int) -> None:
    """the same bits, or a new start that says so: the same bits too"""
    _status(_fork(*RUN, "seed=0", "output.dir=tried", checkpoints=1 + number % 4))
    path = Path("tried/checkpoint.safetensors")
    content = bytearray(path.read_bytes())
    bit = int(rng.integers(8 * len(content)))
    content[bit // 8] ^= 1 << bit % 8
    path.write_bytes(content)
    _demand(_status(_fork("resume", "tried")) == 0, f"bit {bit}: not resumed")
    _demand(_is_result_of(0), f"bit {bit}: another result")
    samples = 8 + int.from_bytes(content[:8], "little")  # first byte after the header
    said = "the run starts again" in Path("tried/deepir.log").read_text()
    _demand(said or bit // 8 < samples, f"bit {bit}: a new start that does not say so")


def race(rng: np.random.Generator, number: int) -> None:
    """one finishes with status 0, the other is refused with status 2"""
    start, lag = time.time() + 0.02, rng.choice([0.0, rng.uniform(0, 0.1)])
    both = [_fork(*RUN, f"seed={seed}", "output.dir=tried", start=start + lag * seed) for seed in (0, 1)]
    statuses = [_status(each) for each in both]
    _demand(sorted(statuses) == [0, 2], f"statuses {statuses}")
    _demand(_is_result_of(statuses.index(0)), "the result is not the winner's")


RUNS: dict[str, Callable[[np.random.Generator, int], None]] = {
    "kills": kill,
    "kills at events": kill_at_event,
    "full disks": full_disk,
    "flipped bits": flip,
    "races": race,
}


@functools.cache
def _seconds() -> float:
    """How long a run takes."""
    begun = time.monotonic()
    _demand(_status(_fork(*RUN, "seed=0", "output.dir=tried")) == 0, "a run alone fails")
    shutil.rmtree("tried")
    return time.monotonic() - begun


@functools.cache
def _events() -> int:
    """Number of events of a run that replaces a former one."""
    shutil.copytree("alone1", "tried")
    events = _status(_fork(*RUN, "seed=0", "output.dir=tried", "--overwrite", events=0))
    shutil.rmtree("tried")
    return events


def _demand(condition: bool, what: str) -> None:
    if not condition:
        raise AssertionError(what)


def _finish(seed: int) -> None:
    """Go on with the run in `tried`, or start it; its result is that of the run alone."""
    folder = RunFolder(Path("tried"))
    go_on = folder.state() == "interrupted"
    again = ("resume", "tried") if go_on else (*RUN, f"seed={seed}", "output.dir=tried", "--overwrite")
    _demand(_status(_fork(*again)) == 0, f"{again[0]} fails: {Path('errors').read_text()}")
    _demand(_is_result_of(seed), f"another result after {again[0]}")
    left = {path.name for path in Path("tried").iterdir()} - {path.name for path in Path("alone0").iterdir()}
    _demand(not left, f"files are left: {left}")


def _is_result_of(seed: int) -> bool:
    """Whether the result in `tried` is that of the run of this seed, to the bit."""
    with np.load(f"alone{seed}/result.npz") as wanted, np.load("tried/result.npz") as found:
        same = all(np.array_equal(wanted[name], found[name], equal_nan=True) for name in wanted)
        return same and wanted.files == found.files and f"seed: {seed}" in Path("tried/config.yaml").read_text()


def _contents() -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in Path("tried").iterdir() if path.is_file()}


@contextmanager
def _disk() -> Iterator[bool]:
    """A small disk at `tried`; False where none can be mounted: then files are bounded in size instead."""
    Path("tried").mkdir()
    command = ["mount", "-t", "tmpfs", "-o", f"size={DISK_BYTES}", "tmpfs", "tried"]
    mounted = (
        shutil.which("mount") is not None and subprocess.run(command, capture_output=True, check=False).returncode == 0
    )
    try:
        yield mounted
    finally:
        if mounted:
            subprocess.run(["umount", "tried"], check=True)


def _fork(*arguments: str, start: float = 0.0, prepare: Callable[[], Any] | None = None, **how: Any) -> int:
    process = os.fork()
    if process == 0:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        os.dup2(os.open("errors", os.O_WRONLY | os.O_CREAT | os.O_TRUNC), 2)
        time.sleep(max(0.0, start - time.time()))
        os._exit(_child(arguments, **how))
    return process


def _child(arguments: tuple[str, ...], events: int | None = None, checkpoints: int = 0, most: int | None = None) -> int:
    """Run a command; with `events=0` the exit status is their number, else it is killed at the one of this number."""
    seen = {"events": 0, "checkpoints": 0}
    folder = str(Path("tried").absolute())

    def watch(event: str, found: tuple[Any, ...]) -> None:
        if event in EVENTS and str(found[0]).startswith(folder):
            seen["events"] += event != "open" or "r" not in str(found[1] or "w")
            seen["checkpoints"] += event == "os.rename" and str(found[1]).endswith("checkpoint.safetensors")
            if (events and seen["events"] == events) or (checkpoints and seen["checkpoints"] > checkpoints):
                os.kill(os.getpid(), signal.SIGKILL)

    if events is not None or checkpoints:
        sys.addaudithook(watch)
    if most is not None and not os.path.ismount("tried"):
        resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    status = main(arguments)
    return min(seen["events"], 255) if events == 0 else status


def _status(process: int) -> int:
    return os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
