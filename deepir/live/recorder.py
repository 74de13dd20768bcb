"""What live correction keeps: recorded frames, keyframes and maps."""

from __future__ import annotations

import queue
import re
import shutil
import threading
import time
from collections import deque
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from platformdirs import user_data_path

from deepir.arrays import Array
from deepir.arrays.samples import as_float32
from deepir.calibration import CorrectionMaps, read_maps
from deepir.errors import DataError
from deepir.io.output import Write, output_type, tiff
from deepir.recording.keyframes import WINDOW, KeyframeCollector, Keyframes, motion_spacing

RESERVE = 200e6  # bytes of the disk that are left free
PENDING = 32  # frames that wait to be written, at most
MAX_NEWEST = 64  # newest frames that are kept
MIN_IN_GROUPS = 32  # keyframes in groups, below which the newest frames count too
MAX_PENDING = 16  # frames since the camera last moved that are kept, in case it goes on
#: Change since then, relative to that between frames, from which it moves: of a camera that stands still it is 1.
MIN_CHANGE_RATIO = 1.5


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
            message = f"{ended}{kept if self.frames else 'nothing was recorded'}{lost}"
        except (DataError, OSError) as error:
            message = f"the recording has failed, and is not kept: {error}"
        finally:
            self.recording = False
            self._pending = queue.SimpleQueue()
        self.message = message

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


class KeptMaps:
    """The maps that are kept for a camera.

    Args:
        identity: What identifies it.
    """

    def __init__(self, identity: str) -> None:
        name = re.sub(r"[^A-Za-z0-9.-]+", "_", identity).strip("._")
        self.path: Path = user_data_path("deepir") / "cameras" / f"{name}.npz"

    @property
    def date(self) -> str:
        """Local date and time at which they were kept."""
        return time.strftime("%Y-%m-%d %H:%M", time.localtime(self.path.stat().st_mtime))

    def read(self, shape: tuple[int, ...]) -> CorrectionMaps | None:
        """Those of frames of a shape (h, w); None if there are none, they are damaged, or of another mode's frames."""
        try:
            maps = read_maps(self.path)
        except (DataError, OSError):
            return None
        return maps if maps.gain.shape == shape else None

    def save(self, maps: CorrectionMaps) -> None:
        """Keep maps in place of those before.

        Raises:
            DataError: The folder cannot be written.
        """
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            maps.save(self.path)
        except OSError as error:
            raise DataError(f"{self.path}: the maps cannot be kept: {error}") from None


Averaged = tuple[int, Array, Array]  # number, frame (h, w), the frame averaged over blocks


class LiveKeyframes:
    """Chooses keyframes, the first of them at once."""

    def __init__(self) -> None:
        self._groups = KeyframeCollector(latest=True)
        self._newest: deque[Averaged] = deque(maxlen=MAX_NEWEST)
        self._pending: deque[Averaged] = deque(maxlen=MAX_PENDING)
        self._steps: deque[float] = deque(maxlen=WINDOW)  # changes from frame to frame
        self._before: Array | None = None  # the last frame, averaged
        self._taken = 0

    @property
    def length(self) -> int:
        """Frames so far."""
        return self._groups.length

    @property
    def taken(self) -> int:
        """Keyframes chosen since the start, those that were dropped included."""
        return self._taken + self._groups.taken

    @property
    def count(self) -> int:
        """About as many keyframes are there now."""
        return max(len(self._newest), self._groups.count)

    def add(self, frame: Array) -> None:
        """The next frame (h, w); one that repeats the frame before it is no keyframe."""
        small = self._groups.add(frame)
        if small is None:
            return
        if self._before is not None:
            self._steps.append(float(np.abs(small - self._before).mean()))
        self._before = small
        self._pending.append((self.length - 1, frame, small))
        if not self._newest or (np.abs(small - self._newest[-1][2]).mean() > MIN_CHANGE_RATIO * np.median(self._steps)):
            self._taken += min(len(self._pending), MAX_NEWEST - len(self._newest))
            self._newest.extend(self._pending)
            self._pending.clear()

    def forget(self, number: int) -> None:
        """Drop the keyframes before a frame."""
        self._groups.forget(number)
        for frames in (self._newest, self._pending):
            while frames and frames[0][0] < number:
                frames.popleft()

    def chosen(self) -> Keyframes:
        """Those that are there now; at least one."""
        groups = self._groups.groups
        if self._groups.count < MIN_IN_GROUPS:
            first = self._newest[0][0]
            spacing, _ = motion_spacing(np.stack([small for _, _, small in self._newest]))
            newest = [(number, frame, spacing) for number, frame, _ in self._newest]
            groups = [*(group for group in groups if group[-1][0] < first), newest]
        return Keyframes.of_groups(groups, self.length)
