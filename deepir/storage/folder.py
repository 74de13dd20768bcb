"""The folder of a run, and its lock."""

from __future__ import annotations

import json
import logging
import os
import platform
import re
import time
from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from filelock import FileLock, Timeout
from pydantic import BaseModel, ConfigDict, ValidationError

from deepir.errors import ConfigError, DataError, DeepIRError
from deepir.io.output import write_json, write_text
from deepir.paths import printable

LOCK_NAME = ".lock"  # file within a folder that is held
LOCK_WAIT = 0.3  # s; a process that comes too late has the first one's name by then
#: Files that `deepir.io.output.atomic_files` leaves behind when it is killed.
TEMPORARY_PATTERN = re.compile(r"\.(.+)\.[0-9a-f]{8}(\.\w+)")
#: All files that a run writes and --overwrite replaces; the configuration is written first, the metrics last.
RUN_FILES = (
    "config.yaml", "run.json", "deepir.log", "checkpoint.safetensors", "checkpoint.part", "result.npz", "result.mat",
    "uncertainty.npz", "scene.tiff", "scene_kelvin.tiff", "scene_preview.png", "summary.png", "flow.png",
    "report.html", "metrics.json",
)  # fmt: skip
#: First line of config.yaml, by which a run's folder is recognised.
CONFIG_HEADER = "# deepir: the configuration of this run in full, as `deepir resume` reads it\n"


Lock = Callable[[], bool]  # whether a lock is in place: not once its file, or a folder above it, was moved or deleted


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
    status = path.stat()

    def in_place() -> bool:
        with suppress(OSError):
            return os.path.samestat(path.stat(), status)
        return False

    try:
        since = time.strftime("%Y-%m-%d %H:%M:%S")
        with suppress(OSError):  # a full disk: whatever is written next says so
            holder.write_text(f"process {os.getpid()} on {platform.node()} since {since}", encoding="utf-8")
        yield in_place
    finally:
        if in_place():
            for each in (holder, path):
                with suppress(OSError):
                    each.unlink()
        lock.release()


def _read(holder: Path) -> str:
    with suppress(OSError, UnicodeDecodeError):
        return holder.read_text(encoding="utf-8")
    return "its name is not known"


log = logging.getLogger("deepir")


class Record(BaseModel):
    """Contents of run.json."""

    model_config = ConfigDict(allow_inf_nan=False)
    versions: dict[str, str] = {}
    machine: str = ""
    plugins: list[str] = []
    inputs: dict[str, str] = {}  # digests of the input files
    started: float | None = None  # s since 1970
    seconds: float = 0.0  # of work before that


@dataclass(frozen=True)
class RunFolder:
    """The folder of a run; other files may lie in it and are never overwritten.

    A run that replaces a former one works in `unfinished` within it, and takes its place once it is finished.
    """

    path: Path

    @property
    def config(self) -> Path:
        """Path of the resolved configuration."""
        return self.path / "config.yaml"

    @property
    def checkpoint(self) -> Path:
        """Path of the solver's state."""
        return self.path / "checkpoint.safetensors"

    @property
    def unfinished(self) -> RunFolder:
        """Folder of a run that is to replace the one in this folder."""
        return RunFolder(self.path / ".unfinished")

    @property
    def active(self) -> RunFolder:
        """Folder of the run that would be resumed."""
        return self.unfinished if self.unfinished.config.exists() else self

    def state(self) -> str:
        """`new`, `interrupted` or `finished`.

        Raises:
            ConfigError: It is a file, or holds files of the same names that no run wrote.
        """
        demand_folder(self.path)
        try:
            held = self._held()
            ours = self.config.exists() and self.config.read_text(encoding="utf-8").startswith("# deepir")
            if self.unfinished._held():
                return "interrupted"
        except (OSError, UnicodeDecodeError) as error:
            raise ConfigError(f"output.dir: {self.path} cannot be read: {error}") from None
        if not held:
            return "new"
        if not ours:
            raise ConfigError(
                f"output.dir: {self.path} holds {held[0]}, which no run of deepir wrote; "
                "give another folder, for example output.dir=runs/mine"
            )
        return "finished" if "metrics.json" in held else "interrupted"

    def check_free(self, *, overwrite: bool) -> None:
        """Check that a new run may be written here.

        Raises:
            ConfigError: There is a former run, and `overwrite` is false.
        """
        state = self.state()
        if state == "new" or overwrite:
            return
        go_on = f"continue it with `deepir resume {self.path}`, " if state == "interrupted" else ""
        raise ConfigError(
            f"output.dir: {self.path} already contains a run ({state}); {go_on}"
            "replace it with --overwrite, or give another folder with output.dir=DIR"
        )

    @contextmanager
    def lock(self) -> Iterator[Lock]:
        """Hold the folder; what a killed process left half done is finished or removed first.

        Raises:
            ConfigError: Another process holds it, or it cannot be written.
        """
        with locked_folder(self.path) as held:
            for each in (self.path, self.unfinished.path):
                remove_temporaries(each, RUN_FILES)
                (each / "checkpoint.part").unlink(missing_ok=True)
            self.replace_former()
            yield held

    def begin(self, config: str, record: Record) -> RunFolder:
        """Write configuration and record of a new run.

        Args:
            config: The configuration as YAML.
            record: Contents of run.json.

        Returns:
            Folder of the new run: this one, or `unfinished` if a former run is here.

        Raises:
            DeepIRError: They cannot be written.
        """
        self.unfinished.clear()
        folder = self if self.state() == "new" else self.unfinished
        try:
            folder.path.mkdir(exist_ok=True)
            write_text(folder.config, CONFIG_HEADER + config)
            folder.write_record(record)
        except OSError as error:
            raise ConfigError(f"output.dir: {folder.path} cannot be written: {error.strerror or error}") from None
        except DeepIRError:
            folder.clear()
            raise
        return folder

    def replace_former(self) -> None:
        """Move a finished run from `unfinished` to its place; goes on with a move that was interrupted.

        Raises:
            DataError: A file cannot be moved.
        """
        new = self.unfinished
        if (new.path / "metrics.json").exists():
            self._take_files(new)
        with suppress(OSError):
            new.path.rmdir()

    def clear(self) -> None:
        """Remove the files of a run, and the folder if it is then empty."""
        for name in reversed(RUN_FILES):
            with suppress(FileNotFoundError, NotADirectoryError):
                (self.path / name).unlink()
        with suppress(OSError):
            self.path.rmdir()

    def record(self) -> Record:
        """Versions, plugins, input digests and times of the run; empty if it was killed before they were written.

        Raises:
            ConfigError: The file is damaged.
        """
        path = self.path / "run.json"
        try:
            return Record.model_validate(json.loads(path.read_text(encoding="utf-8")))
        except FileNotFoundError:
            return Record()
        except ValidationError as error:
            first = error.errors()[0]
            where = ".".join(map(str, first["loc"])) or "its contents"
            why = f"{where} = {str(first['input'])[:40]!r}"
        except (OSError, ValueError, RecursionError) as error:
            why = str(error)
        raise ConfigError(f"{path}: not what a run wrote ({why}); delete it to go on without it")

    def write_record(self, record: Record) -> None:
        """Replace run.json."""
        write_json(self.path / "run.json", record.model_dump())

    @contextmanager
    def logging(self) -> Iterator[None]:
        """Write the package's log into the folder.

        Raises:
            ConfigError: It cannot be written.
        """
        path = self.path / "deepir.log"
        try:
            handler = _LogFile(path, encoding="utf-8")
        except OSError as error:
            raise ConfigError(f"{path}: cannot be written: {error.strerror or error}") from None
        handler.setFormatter(_Lines("%(asctime)s %(levelname)s %(message)s"))
        level = log.level
        log.addHandler(handler)
        log.setLevel(logging.INFO)
        try:
            yield
        finally:
            log.setLevel(level)
            log.removeHandler(handler)
            with suppress(OSError):
                handler.close()

    def _take_files(self, new: RunFolder) -> None:
        try:
            new.checkpoint.unlink(missing_ok=True)
            if new.config.exists():  # nothing has been moved yet
                old = [name for name in self._held() if not (new.path / name).exists()]
                for name in ("metrics.json", *old):
                    (self.path / name).unlink(missing_ok=True)
            for name in new._held():
                (new.path / name).replace(self.path / name)
        except OSError as error:
            raise DataError(
                f"{self.path}: the results in {new.path} cannot be moved here: {error.strerror or error}; "
                f"then go on with: deepir resume {self.path}"
            ) from None

    def _held(self) -> list[str]:
        return [name for name in RUN_FILES if (self.path / name).exists()]


class _Lines(logging.Formatter):
    """A line for each message, whatever names it holds; tracebacks follow in theirs."""

    def formatMessage(self, record: logging.LogRecord) -> str:  # noqa: N802 - logging's own name
        """The message in one line."""
        return printable(super().formatMessage(record))


class _LogFile(logging.FileHandler):
    """The log, which ends where the disk is full; the results' own error reports that."""

    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802 - logging's own name
        """Drop the line."""
