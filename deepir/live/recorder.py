"""Recordings of what comes and of what leaves, started and stopped meanwhile."""

from __future__ import annotations

import queue
import shutil
import threading
import time
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from deepir.arrays.samples import as_float32
from deepir.errors import DataError
from deepir.io.output.recording import Write, output_type, tiff

Array = np.ndarray[Any, Any]

RESERVE = 200e6  # bytes of the disk that are left free
PENDING = 32  # frames that wait to be written, at most


class Recorder:
    """Writes raw and corrected frames into two TIFFs, in a thread of its own, so that the next frame does not wait.

    A recording ends by itself before the disk is full, and is kept. Frames that the disk is too slow for are left out,
    and counted.

    Args:
        folder: Of the recordings.
        metadata: Written as JSON into each.

    Attributes:
        frames: Written, of the newest recording.
        left_out: Frames that the disk was too slow for, of the newest recording.
        message: What becomes of the newest recording.
    """

    def __init__(self, folder: Path, metadata: Mapping[str, Any] | None = None) -> None:
        self._folder, self._metadata = folder, metadata or {}
        self._pending: queue.SimpleQueue[tuple[Array, Array] | None] = queue.SimpleQueue()
        self._thread: threading.Thread | None = None
        self.recording = False
        self.frames = self.left_out = 0
        self.message = ""

    def start(self) -> None:
        """Begin a recording with the next frame; nothing while the last one is still being written."""
        if self._thread is not None and self._thread.is_alive():
            return
        stem = self._folder / time.strftime("live-%Y-%m-%d-%H%M%S")
        self.frames = self.left_out = 0
        self.message = f"recording into {stem}-raw.tif and -corrected.tif"
        self._pending, self.recording = queue.SimpleQueue(), True
        self._thread = threading.Thread(target=self._record, args=(stem,))
        self._thread.start()

    def add(self, raw: Array, corrected: Array) -> None:
        """The next frame (h, w), raw and corrected; it is taken if there is a recording."""
        if self.recording and self._pending.qsize() < PENDING:
            self._pending.put((raw, corrected))
        elif self.recording:
            self.left_out += 1

    def stop(self) -> None:
        """End the recording with the frames that wait."""
        if self.recording:
            self.message = "the recording is being written"
        self.recording = False
        self._pending.put(None)

    def close(self) -> None:
        """End the recording, and wait until it is written."""
        self.stop()
        if self._thread is not None:
            self._thread.join()

    def _record(self, stem: Path) -> None:
        """Write until there is no more, and say what became of it."""
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            with ExitStack() as stack:
                full = self._write(stem, stack)
            ended = f"the disk is full, less than {RESERVE / 1e6:.0f} MB are free: " if full else ""
            kept = f"{self.frames} frame(s) are in {stem}-raw.tif and -corrected.tif"
            lost = f"; the disk was too slow for {self.left_out} more" if self.left_out else ""
            self.recording = False
            self.message = f"{ended}{kept if self.frames else 'nothing was recorded'}{lost}"
        except (DataError, OSError) as error:
            self.recording = False
            self.message = f"the recording has failed, and is not kept: {error}"
        finally:
            self.recording = False
            self._pending = queue.SimpleQueue()

    def _write(self, stem: Path, stack: ExitStack) -> bool:
        """Write all frames; whether the disk was full before the end."""
        writers: list[Write] = []
        while (frames := self._pending.get()) is not None:
            if shutil.disk_usage(self._folder).free < RESERVE:
                return True
            if not writers:
                writers = self._open(stem, output_type(frames[0].dtype, rounded=True), stack)
            for write, frame in zip(writers, frames, strict=True):
                write(as_float32(frame))
            self.frames += 1
        return False

    def _open(self, stem: Path, dtype: np.dtype[Any], stack: ExitStack) -> list[Write]:
        paths = [Path(f"{stem}-{what}.tif") for what in ("raw", "corrected")]
        for path in paths:
            if path.exists():
                raise DataError(f"{path} exists: start again")
        return [stack.enter_context(tiff(path, dtype, self._metadata)) for path in paths]
