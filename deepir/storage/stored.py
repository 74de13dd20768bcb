"""Stored runs and their checkpoints."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
import logging
import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from deepir.burst import Burst, Truth
from deepir.config import Config, dump, read
from deepir.errors import ConfigError, DataError, DeepIRError, SolverError
from deepir.kernels import threads
from deepir.messages import MAX_SHOWN, labelled, shown
from deepir.optim.solve import Progress
from deepir.paths import expanded
from deepir.report.progress import ProgressLines
from deepir.result import Result
from deepir.runner import Callbacks, execute, machine, prepare, versions
from deepir.storage.folder import RUN_FILES, Lock, Record, RunFolder


@dataclass(frozen=True)
class FileCheckpoint:
    """File with the state of a solve, see `deepir.optim.objective.Checkpoint`."""

    path: Path
    run: str = ""  # identity of the run; a state that was saved with another one is not read

    def __str__(self) -> str:
        return str(self.path)

    def exists(self) -> bool:
        """True if there is a state to continue from."""
        return self.path.exists()

    def save(self, tensors: dict[str, Tensor], position: dict[str, Any]) -> None:
        """Replace the file atomically: an interruption leaves the old state or the new one.

        Args:
            tensors: Tensors by name.
            position: Stage, iteration ...; anything that JSON can hold.

        Raises:
            DataError: It cannot be written, for example on a full disk.
        """
        from safetensors import SafetensorError
        from safetensors.torch import save_file

        part = self.path.with_suffix(".part")
        # Also of one element: where that was expanded, its stride may be zero.
        contiguous = {
            name: tensor.detach().cpu().clone(memory_format=torch.contiguous_format) for name, tensor in tensors.items()
        }
        about = {"position": json.dumps(position), "run": self.run}
        try:
            save_file(contiguous, part, metadata=about | {"sha256": _checksum(contiguous, about)})
            part.replace(self.path)
        except (SafetensorError, OSError) as error:
            part.unlink(missing_ok=True)
            raise DataError(f"{self.path}: the state cannot be written: {error}") from error

    def load(self) -> tuple[dict[str, Tensor], dict[str, Any]]:
        """Tensors and position.

        Raises:
            DataError: The file is not a checkpoint, is damaged, or of another run.
        """
        from safetensors import SafetensorError, safe_open

        try:
            with safe_open(self.path, framework="pt") as file:
                about = dict(file.metadata() or {})
                # Cloned: in the file they lie unaligned, and sums would round differently from the interrupted run.
                tensors = {name: file.get_tensor(name).clone() for name in file.keys()}  # noqa: SIM118
            if about.pop("sha256", None) != _checksum(tensors, about):
                raise ValueError("its contents do not fit their checksum")
            if about["run"] != self.run:
                raise ValueError("it is of other frames, another configuration or another version")
            return tensors, json.loads(about["position"])
        except (SafetensorError, KeyError, ValueError, OSError) as error:
            raise DataError(f"{self.path}: this checkpoint cannot be used: {error}") from error


def _checksum(tensors: dict[str, Tensor], about: dict[str, str]) -> str:
    """SHA-256 of contiguous tensors with their names, types and shapes, and of the rest of the header."""
    found = hashlib.sha256(json.dumps(about, sort_keys=True).encode())
    for name, tensor in sorted(tensors.items()):
        found.update(f"{name} {tensor.dtype} {tuple(tensor.shape)}".encode())
        found.update(tensor.reshape(-1).view(torch.uint8).numpy().data)
    return found.hexdigest()


log = logging.getLogger("deepir")


def run_into(
    config: Config,
    path: Path,
    frames: np.ndarray[Any, Any] | None = None,
    *,
    truth: Truth | None = None,
    overwrite: bool = False,
    plugins: Sequence[str] = (),
    callbacks: Callbacks = (),
) -> Result:
    """Run a configuration into a folder, which is created once everything is checked.

    Args:
        config: The configuration.
        path: The folder.
        frames: (N, h, w), in place of `data.path`.
        truth: The known scene, or arrays by name, in place of `data.truth`.
        overwrite: Replace a former run.
        plugins: Modules that were imported, for the record.
        callbacks: Called with a `Progress` after each iteration.

    Raises:
        DeepIRError: Configuration, data or folder are wrong; nothing is written, a former run stays.
        SolverError: The solve failed; its state is in the folder.
    """
    folder = RunFolder(expanded(path).absolute())
    with folder.lock() as lock:
        config = pin_config(config, folder)
        _check_inputs(config, folder)
        data = prepare(config, frames, truth)
        folder.check_free(overwrite=overwrite)  # last: what is wrong with the input comes first
        record = _record(config, data, plugins)
        work = _Work(folder.begin(dump(config), record), lock, config, data, callbacks)
        try:
            with work.folder.logging():
                result = work.run()
        except DeepIRError as error:
            if not work.begun and not isinstance(error, SolverError):
                work.folder.clear()
            elif work.folder != folder and lock():
                raise type(error)(
                    f"{error}; the former result is kept, and the new run can go on: deepir resume {path}"
                ) from error
            raise
        folder.replace_former()
        return result


def resume(path: Path, *, plugins: Sequence[str] = (), callbacks: Callbacks = ()) -> Result | None:
    """Finish an interrupted run.

    Args:
        path: The folder of the run.
        plugins: Modules that are imported.
        callbacks: Called with a `Progress` after each iteration.

    Returns:
        The result; None if the run is already finished.

    Raises:
        ConfigError: There is no run, it lacks a plugin, or its input has changed.
    """
    folder = RunFolder(expanded(path).absolute())
    if not folder.path.is_dir() or (state := folder.state()) == "new":
        known = ", ".join(sorted(str(each.parent) for each in path.parent.glob("*/config.yaml"))[:5])
        there = f"; runs here: {known}" if known else " (a run is a folder with config.yaml)"
        raise ConfigError(f"{path}: no run in this folder{there}")
    if state == "finished":
        return None
    with folder.lock() as lock:
        if folder.state() == "finished":  # until another process ended, or a kill
            return None
        with folder.active.logging():
            result = _continued(folder.active, lock, path, plugins, callbacks).run()
        folder.replace_former()
        return result


def _continued(folder: RunFolder, lock: Lock, path: Path, plugins: Sequence[str], callbacks: Callbacks) -> _Work:
    """The rest of an interrupted run in `folder`, which the user calls `path`."""
    config, record = read(folder.config), folder.record()
    if missing := [each for each in record.plugins if each not in plugins]:
        again = " ".join(f"--plugin {each}" for each in record.plugins)
        raise ConfigError(f"{path}: the run uses the plugin {missing[0]}: deepir resume {path} {again}")
    if any(each.path is None and each.simulate is None for each in config.sources().values()):
        raise ConfigError(f"{path}: its frames came from memory and not from a file, so it cannot be resumed")
    data = prepare(config)
    fresh = _record(config, data, plugins)
    check_unchanged(record.inputs, fresh.inputs, path)
    work = _Work(folder, lock, config, data, callbacks)
    work.remove_foreign_state()
    if folder.checkpoint.exists() and record.started is not None:  # later work is repeated
        work.before = fresh.seconds = record.seconds + max(0.0, folder.checkpoint.stat().st_mtime - record.started)
    folder.write_record(fresh)
    return work


def _record(config: Config, data: Burst, plugins: Sequence[str]) -> Record:
    """Contents of run.json at the start of a run."""
    return Record(
        versions=versions(),
        machine=machine(),
        plugins=list(plugins),
        inputs=input_digests(config, [each.sha256 for each in (data, *data.datasets.values())]),
        started=time.time(),
    )


@dataclasses.dataclass
class _Work:
    """A solve into a folder that is ready."""

    folder: RunFolder
    lock: Lock
    config: Config
    data: Burst
    callbacks: Callbacks
    before: float = 0.0  # seconds of work that an interrupted process did
    begun: bool = False

    @functools.cached_property
    def checkpoint(self) -> FileCheckpoint:
        return FileCheckpoint(self.folder.checkpoint, _identity(self.config, self.data))

    def remove_foreign_state(self) -> None:
        """Remove a checkpoint that is damaged or of another run: the run starts again."""
        try:
            if self.checkpoint.exists():
                self.checkpoint.load()
        except DataError as error:
            log.warning("%s; the run starts again", error)
            self.folder.checkpoint.unlink()

    def run(self) -> Result:
        folder, data = self.folder, self.data
        log.info("deepir %(deepir)s, torch %(torch)s, python %(python)s", versions())
        log.info("input %s, %s, sha256 %s", data.source, data.frames.shape, data.sha256)
        try:
            callbacks: Callbacks = [self._first, ProgressLines(log.info), *self.callbacks]
            result = execute(self.config, data, callbacks=callbacks, checkpoint=self.checkpoint)
            self.begun = True
            lines = labelled(result.messages)
            for line in shown(lines, "report.html"):
                log.warning(line)
            for line in lines[MAX_SHOWN:]:
                log.info(line)
            result.metrics["seconds"] = round(result.metrics["seconds"] + self.before, 3)
            if not self.lock():
                raise DataError(
                    f"{folder.path}: this folder was moved or deleted while the run was at work; "
                    "if it was moved, go on with `deepir resume` there"
                )
            result.save(folder.path)
        except (ConfigError, DataError, SolverError) as error:
            log.error(str(error))
            raise
        except Exception as error:
            log.exception("unexpected")
            error.add_note(f"the traceback is in {folder.path / 'deepir.log'}")
            raise
        except BaseException as error:
            log.info("interrupted: %s", error or type(error).__name__)
            raise
        folder.checkpoint.unlink(missing_ok=True)
        log.info("finished: %s", result.metrics["stop_reason"])
        return result

    def _first(self, progress: Progress) -> None:
        self.begun = True


def _identity(config: Config, data: Burst) -> str:
    """Digest of all that a solve depends on: configuration, samples and versions."""
    found = hashlib.sha256(f"{dump(config)}{versions()}".encode())
    for each in (data, *data.datasets.values()):
        for array in (each.frames, each.valid, each.bad_pixels):
            found.update(f"{array.shape} {array.dtype}".encode())
            found.update(np.ascontiguousarray(array).data)
    return found.hexdigest()


def pin_config(config: Config, folder: RunFolder) -> Config:
    """The configuration with everything fixed that may differ in a later process: absolute paths, threads."""

    def pinned(value: Any, *where: str) -> Any:
        if isinstance(value, Mapping):
            return {key: pinned(each, *where, key) for key, each in value.items()}
        section, key = where[0], where[-1]
        always = where[-2] == "data" and key in ("path", "truth", "mask")
        named = key in ("path", "init", "scene") if section != "method" else key != "type"
        of_a_set = section == "datasets" and where[2] == "scene"  # shared or own
        if not isinstance(value, str) or not (always or (named and not of_a_set and Path(value).exists())):
            return value
        return os.path.abspath(expanded(value))  # noqa: PTH100 - keeps globs

    parts = ("data", "datasets", "method", "physics", "scene")
    whole = config.model_dump()
    whole |= {name: pinned(whole[name], name) for name in parts if isinstance(whole[name], dict)}
    whole["output"]["dir"], whole["threads"] = str(folder.path), config.threads or threads.available()
    return Config.model_validate(whole)


def _check_inputs(config: Config, folder: RunFolder) -> None:
    for where, data in config.sources().items():
        for key in ("path", "truth", "mask"):
            path = getattr(data, key)
            if path is not None and Path(path).parent == folder.path and Path(path).name in RUN_FILES:
                raise ConfigError(
                    f"{where}.{key}: {path} is a result that this run would replace; give another output.dir"
                )


def input_digests(config: Config, frames: Sequence[str]) -> dict[str, str]:
    """Digest of each input file.

    Args:
        config: The configuration.
        frames: Digest of the frames of each data set.
    """
    found = {}
    for data, digest in zip(config.sources().values(), frames, strict=True):
        if data.path is not None:
            found[data.path] = digest
        for path in (data.mask, data.truth):
            if path is not None and Path(path).is_file():
                found[path] = hashlib.sha256(Path(path).read_bytes()).hexdigest()
    return found


def check_unchanged(then: Mapping[str, str], now: Mapping[str, str], path: Path) -> None:
    """Compare the input's digests with those at the start of a run.

    Raises:
        ConfigError: A file has changed.
    """
    for name, digest in then.items():
        if now.get(name) != digest:
            raise ConfigError(
                f"{path}: {name} has changed since the run started; put the old file back, "
                "or start again with `deepir run ... --overwrite`"
            )
