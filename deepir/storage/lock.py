"""Outputs that one process writes at a time."""

from __future__ import annotations

import os
import platform
import re
import time
from collections.abc import Collection, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from filelock import FileLock, Timeout

from deepir.errors import ConfigError

LOCK_NAME = ".lock"  # file within a folder that is held
LOCK_WAIT = 0.3  # s; a process that comes too late has the first one's name by then
#: Files that `deepir.io.output.write.atomic_files` leaves behind when it is killed.
TEMPORARY_PATTERN = re.compile(r"\.(.+)\.[0-9a-f]{8}(\.\w+)")


@dataclass(frozen=True)
class Lock:
    """A lock file that this process holds."""

    path: Path
    identity: tuple[int, int]  # device and number of the file

    def is_in_place(self) -> bool:
        """False once the file, or a folder above it, was moved or deleted."""
        try:
            return _identity(self.path) == self.identity
        except OSError:
            return False


@contextmanager
def locked_folder(path: Path) -> Iterator[Lock]:
    """Hold a folder, which is made if there is none, and removed at the end if nothing is in it.

    Raises:
        ConfigError: It is a file, cannot be written, or another process holds it.
    """
    demand_folder(path)
    made = [each for each in (path, *path.parents) if not each.exists()]
    try:
        try:
            path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ConfigError(f"output.dir: {path} cannot be written: {error.strerror or error}") from None
        with _locked(path / LOCK_NAME, path) as lock:
            yield lock
    finally:
        for each in made:
            with suppress(OSError):
                each.rmdir()


@contextmanager
def locked_files(*paths: Path) -> Iterator[None]:
    """Hold output files, by a lock beside each; what a killed process left of them is removed.

    Raises:
        ConfigError: A folder cannot be written, or another process holds a file.
    """
    with ExitStack() as held:
        for path in sorted(set(paths)):
            held.enter_context(_locked(path.with_name(f".{path.name}{LOCK_NAME}"), path))
            remove_temporaries(path.parent, [path.name])
        yield


def demand_folder(path: Path) -> None:
    """Raise `ConfigError` if an output folder is a file."""
    if path.exists() and not path.is_dir():
        raise ConfigError(f"output.dir: {path} is a file; give a folder, for example output.dir=runs/mine")


def remove_temporaries(folder: Path, names: Collection[str]) -> None:
    """Remove what killed processes left of files of these names; the caller holds the folder or the files."""
    for path in folder.glob(".*"):
        found = TEMPORARY_PATTERN.fullmatch(path.name)
        if found and found[1] + found[2] in names:
            with suppress(OSError):
                path.unlink()


@contextmanager
def _locked(path: Path, output: Path) -> Iterator[Lock]:
    """Hold a lock file; the system releases it when the process ends, however that is.

    The lock file is not moved while it is held, and is deleted before it is released. A process that opened it earlier
    notices that it is gone, and creates a new one.
    """
    holder = path.with_name(f"{path.name}.holder")
    lock = FileLock(path, timeout=LOCK_WAIT)
    try:
        lock.acquire()
    except Timeout:
        raise ConfigError(
            f"{output}: another process is at work here ({_read(holder)}); wait until it ends, or give another output"
        ) from None
    except OSError as error:
        raise ConfigError(f"{output}: cannot be written: {error.strerror or error}") from None
    held = Lock(path, _identity(path))
    try:
        since = time.strftime("%Y-%m-%d %H:%M:%S")
        with suppress(OSError):  # a full disk: whatever is written next says so
            holder.write_text(f"process {os.getpid()} on {platform.node()} since {since}", encoding="utf-8")
        yield held
    finally:
        if held.is_in_place():
            for each in (holder, path):
                with suppress(OSError):
                    each.unlink()
        lock.release()


def _identity(path: Path) -> tuple[int, int]:
    status = path.stat()
    return status.st_dev, status.st_ino


def _read(holder: Path) -> str:
    with suppress(OSError, UnicodeDecodeError):
        return holder.read_text(encoding="utf-8")
    return "its name is not known"
