"""The folder of a run: its files, when they may be written, and the state after an interruption."""

from __future__ import annotations

import fcntl
import json
import logging
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from deepir.errors import ConfigError
from deepir.io.output.write import atomic_file, write_json

#: All files that a run writes and --overwrite removes; the configuration is written first and removed last.
RUN_FILES = (
    "config.yaml",
    "run.json",
    "deepir.log",
    "checkpoint.safetensors",
    "checkpoint.part",
    "result.npz",
    "result.mat",
    "uncertainty.npz",
    "scene.tiff",
    "scene_kelvin.tiff",
    "scene_preview.png",
    "summary.png",
    "report.html",
    "metrics.json",
)
#: Files that `deepir.io.output.write.atomic_file` leaves behind when it is killed.
TEMPORARY_PATTERN = re.compile(r"\.(\w+)\.[0-9a-f]{8}(\.\w+)")
#: First line of config.yaml, by which a run's folder is recognised.
CONFIG_HEADER = "# deepir: the configuration of this run in full, as `deepir resume` reads it\n"

log = logging.getLogger("deepir")


@dataclass(frozen=True)
class RunFolder:
    """The folder of a run; other files may lie in it and are never overwritten."""

    path: Path

    @property
    def config(self) -> Path:
        """Path of the resolved configuration."""
        return self.path / "config.yaml"

    @property
    def checkpoint(self) -> Path:
        """Path of the solver's state."""
        return self.path / "checkpoint.safetensors"

    def state(self) -> str:
        """`new`, `interrupted` or `finished`.

        Raises:
            ConfigError: It is a file, or holds files of the same names that no run wrote.
        """
        if self.path.exists() and not self.path.is_dir():
            raise ConfigError(
                f"output.dir: {self.path} is a file; give a folder, for example output.dir=runs/mine"
            )
        try:
            held = [name for name in RUN_FILES if (self.path / name).exists()]
            ours = self.config.exists() and self.config.read_text(encoding="utf-8").startswith("# deepir")
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

    def begin(self, config: str, record: dict[str, Any]) -> list[Path]:
        """Create the folder, back up a former run, and write configuration and record of the new one.

        Args:
            config: The configuration as YAML.
            record: Contents of run.json.

        Returns:
            The folders that were created, innermost first.

        Raises:
            ConfigError: The folder cannot be written.
        """
        made = [each for each in (self.path, *self.path.parents) if not each.exists()]
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            former = [name for name in RUN_FILES if (self.path / name).exists()]
            if former:
                self._remove(self._backup)
                self._backup.mkdir()
                for name in reversed(former):
                    (self.path / name).rename(self._backup / name)
            with atomic_file(self.config) as part:
                part.write_text(CONFIG_HEADER + config, encoding="utf-8")
        except OSError as error:
            raise ConfigError(
                f"output.dir: {self.path} cannot be written: {error.strerror or error}"
            ) from None
        self.write_record(record)
        return made

    def commit(self) -> None:
        """The run works: remove the backup, and temporary files of a killed run."""
        self._remove(self._backup)
        (self.path / "checkpoint.part").unlink(missing_ok=True)
        for path in self.path.iterdir():
            found = TEMPORARY_PATTERN.fullmatch(path.name)
            if found and found[1] + found[2] in RUN_FILES:
                path.unlink()

    def roll_back(self, made: list[Path]) -> None:
        """The run cannot work with these data: remove the files of `begin` and restore the backup.

        Args:
            made: Folders that `begin` created.
        """
        for name in reversed(RUN_FILES):
            with suppress(FileNotFoundError):
                (self.path / name).unlink()
        if self._backup.is_dir():
            for name in RUN_FILES:
                with suppress(FileNotFoundError):
                    (self._backup / name).rename(self.path / name)
        self._remove(self._backup)
        for folder in made:
            with suppress(OSError):
                folder.rmdir()

    def record(self) -> dict[str, Any]:
        """Versions, plugins, input digests and times of the run; empty if it was killed before they were written."""
        try:
            found = json.loads((self.path / "run.json").read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return {}
        return found if isinstance(found, dict) else {}

    def write_record(self, record: dict[str, Any]) -> None:
        """Replace run.json."""
        write_json(self.path / "run.json", record)

    @contextmanager
    def logging(self) -> Iterator[None]:
        """Write the package's log into the folder; only one process may do so at a time.

        Raises:
            ConfigError: Another process works on this run.
        """
        with (self.path / "deepir.log").open("a", encoding="utf-8") as stream:
            try:
                fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                raise ConfigError(f"{self.path}: another process is at work on this run") from None
            handler, level = logging.StreamHandler(stream), log.level
            handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
            log.addHandler(handler)
            log.setLevel(logging.INFO)
            try:
                yield
            finally:
                log.setLevel(level)
                log.removeHandler(handler)

    @property
    def _backup(self) -> Path:
        return self.path / ".former"

    @staticmethod
    def _remove(folder: Path) -> None:
        """Remove a folder's run files, and the folder if it is then empty."""
        for name in RUN_FILES:
            with suppress(FileNotFoundError, NotADirectoryError):
                (folder / name).unlink()
        with suppress(OSError):
            folder.rmdir()
