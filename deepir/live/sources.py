"""Where live frames come from: a camera, a recording at its own rate, or raw frames on standard input."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from typing import IO, Any

import numpy as np

from deepir.cameras.camera import Camera
from deepir.cameras.capture import FRAME_TIMEOUT, POLL_INTERVAL
from deepir.config.schema import Raw
from deepir.errors import DataError
from deepir.io.raw import clear_unused_bits, sample_type

Array = np.ndarray[Any, Any]


def camera_frames(camera: Camera) -> Iterator[Array]:
    """The newest frame of an open camera, again and again.

    Raises:
        DataError: None has come for `FRAME_TIMEOUT`, or the camera is gone.
    """
    last = time.monotonic()
    while True:
        frame, now = camera.read(), time.monotonic()
        if frame is not None:
            last = now
            yield frame
        elif now - last > FRAME_TIMEOUT:
            raise DataError(
                f"the camera has sent no frame for {FRAME_TIMEOUT:g} s: is it unplugged, or busy?"
            )
        else:
            time.sleep(POLL_INTERVAL)


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
