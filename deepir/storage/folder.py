"""The folder of a run: what it holds, when it may be written, and how it is left."""

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
    """Where a run writes. It may lie beside other files, but never over them."""

    path: Path

    @property
    def config(self) -> Path:
        """The resolved configuration."""
        return self.path / "config.yaml"

    @property
    def checkpoint(self) -> Path:
        """The solver's state."""
        return self.path / "checkpoint.safetensors"

    def state(self) -> str:
        """`new`, `interrupted` or `finished`.

        Raises:
            ConfigError: It cannot be a run's folder: a file, or files of the same names that no run wrote.
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
        """Raise `ConfigError` if a new run may not be written here; `overwrite`: a former run may go."""
        state = self.state()
        if state == "new" or overwrite:
            return
        go_on = f"continue it with `deepir resume {self.path}`, " if state == "interrupted" else ""
        raise ConfigError(
            f"output.dir: {self.path} holds another run ({state}); {go_on}"
            "replace it with --overwrite, or give another folder with output.dir=DIR"
        )

    def begin(self, config: str, record: dict[str, Any]) -> list[Path]:
        """Make the folder, put a former run aside, and write the new one's configuration and record.

        Returns the folders that were made, innermost first. Raises `ConfigError` where that is not possible.
        """
        made = [each for each in (self.path, *self.path.parents) if not each.exists()]
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            former = [name for name in RUN_FILES if (self.path / name).exists()]
            if former:
                self._remove(self._aside)
                self._aside.mkdir()
                for name in reversed(former):
                    (self.path / name).rename(self._aside / name)
            with atomic_file(self.config) as part:
                part.write_text(CONFIG_HEADER + config, encoding="utf-8")
        except OSError as error:
            raise ConfigError(
                f"output.dir: {self.path} cannot be written: {error.strerror or error}"
            ) from None
        self.write_record(record)
        return made

    def keep(self) -> None:
        """The run works: drop the former one, and what a killed run left half-written."""
        self._remove(self._aside)
        (self.path / "checkpoint.part").unlink(missing_ok=True)
        for path in self.path.iterdir():
            found = TEMPORARY_PATTERN.fullmatch(path.name)
            if found and found[1] + found[2] in RUN_FILES:
                path.unlink()

    def discard(self, made: list[Path]) -> None:
        """The run cannot work with these data: take away what `begin` wrote, and put a former run back."""
        for name in reversed(RUN_FILES):
            with suppress(FileNotFoundError):
                (self.path / name).unlink()
        if self._aside.is_dir():
            for name in RUN_FILES:
                with suppress(FileNotFoundError):
                    (self._aside / name).rename(self.path / name)
        self._remove(self._aside)
        for folder in made:
            with suppress(OSError):
                folder.rmdir()

    def record(self) -> dict[str, Any]:
        """Versions, plugins, input hashes and time of the run; empty if it was killed before."""
        try:
            found = json.loads((self.path / "run.json").read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return {}
        return found if isinstance(found, dict) else {}

    def write_record(self, record: dict[str, Any]) -> None:
        """Replace the record."""
        write_json(self.path / "run.json", record)

    @contextmanager
    def logging(self) -> Iterator[None]:
        """Write the package's log into the folder; one process at a time.

        Raises:
            ConfigError: Another process is at work on this run.
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
    def _aside(self) -> Path:
        return self.path / ".former"

    @staticmethod
    def _remove(folder: Path) -> None:
        """A folder that holds nothing but a run's files."""
        for name in RUN_FILES:
            with suppress(FileNotFoundError, NotADirectoryError):
                (folder / name).unlink()
        with suppress(OSError):
            folder.rmdir()
