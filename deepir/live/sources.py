"""Sources of frames: recordings played back, cameras, a virtual one."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import IO, Any

import numpy as np

from deepir.arrays import Array
from deepir.config.schema import Raw
from deepir.errors import DataError
from deepir.io.guards import import_optional
from deepir.io.raw import clear_unused_bits, sample_type
from deepir.io.tone_mapping import TONE_MAPPINGS, apply_palette
from deepir.kernels import memory
from deepir.live.corrector import Corrector, Status

NO_DEVICE = (
    "no virtual camera: {}. On Linux load its driver: sudo modprobe v4l2loopback; on Windows and macOS install "
    "OBS Studio and start its virtual camera once"
)
RATE_OVER = 30  # frames, over which the rate is measured


def stream_raw(stream: IO[bytes], layout: Raw) -> Iterator[Array]:
    """Frames (h, w) of a layout from a stream, until it ends; what is left of the last one is dropped."""
    dtype = sample_type(layout)
    size = layout.height * layout.width * dtype.itemsize
    stream.read(layout.offset)
    while len(data := stream.read(size)) == size:
        yield clear_unused_bits(np.frombuffer(data, dtype).reshape(layout.height, layout.width), layout)


class Paced:
    """Frames of a recording at a rate; those that come too late are dropped, and counted.

    Args:
        frames: Of the recording.
        rate: Frames a second.
    """

    def __init__(self, frames: Iterable[Array], rate: float) -> None:
        self._frames, self._rate = frames, rate
        self.dropped = 0

    def __iter__(self) -> Iterator[Array]:
        begun = time.monotonic()
        for number, frame in enumerate(self._frames):
            ahead = begun + number / self._rate - time.monotonic()
            if ahead < -1 / self._rate:
                self.dropped += 1
                continue
            time.sleep(max(0.0, ahead))
            yield frame


@contextmanager
def virtual_camera(rate: float, palette: str, tones: str) -> Iterator[Callable[[CorrectedFrame], None]]:
    """A context with a function that shows corrected frames as a camera; the camera begins with the first one.

    Args:
        rate: Frames a second that it announces.
        palette: Of the pictures.
        tones: Tone mapping.

    Raises:
        DataError: pyvirtualcam, or a driver for it, is not installed.
    """
    library = import_optional("pyvirtualcam", "virtual-camera", "--virtual-camera")
    camera: Any = None

    def show(frame: CorrectedFrame) -> None:
        nonlocal camera
        shown = apply_palette(TONE_MAPPINGS[tones](frame.corrected), palette)
        if shown.ndim == 2:
            shown = np.repeat(shown[..., None], 3, axis=2)
        height, width = (side - side % 2 for side in shown.shape[:2])  # drivers want even sides
        if camera is None:
            try:
                camera = library.Camera(width=width, height=height, fps=rate)
            except RuntimeError as error:
                raise DataError(f"--virtual-camera: {NO_DEVICE.format(error)}") from None
        camera.send(np.ascontiguousarray(shown[:height, :width]))

    try:
        yield show
    finally:
        if camera is not None:
            camera.close()


@dataclass(frozen=True)
class CorrectedFrame:
    """A corrected frame, and the state of its corrector."""

    number: int  # of the frame, from 1
    raw: Array  # (h, w), as it came
    corrected: Array  # (h, w), float32
    status: Status  # of the corrector
    rate: float  # frames a second
    delay: float  # of the correction, s
    dropped: int  # frames that came too late, so far


def play(frames: Iterable[Array], corrector: Corrector) -> Iterator[CorrectedFrame]:
    """Correct frames as they come.

    Args:
        frames: (h, w) each.
        corrector: Of their camera.
    """
    times: deque[float] = deque(maxlen=RATE_OVER + 1)
    with memory.kept():
        for number, frame in enumerate(frames, 1):
            begun = time.perf_counter()
            corrected = corrector(frame)
            now = time.perf_counter()
            times.append(now)
            rate = (len(times) - 1) / (now - times[0]) if len(times) > 1 else 0.0
            dropped = frames.dropped if isinstance(frames, Paced) else 0
            yield CorrectedFrame(number, frame, corrected, corrector.status, rate, now - begun, dropped)
