"""Cameras: their interface, and frames captured from them."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from typing import ClassVar, Self

import numpy as np

from deepir.arrays import Array
from deepir.errors import DataError

MAX_REGISTRATION_SIDE = 160  # px; frames are reduced to at most this side before registration
MIN_CAPTURE_SPAN = 3.0  # px of motion along each axis that a burst needs
FREEZE_TIME = 0.4  # s without a new picture that indicate a shutter closure; export cameras send 9 Hz
FRAME_TIMEOUT = 5.0  # s without a new picture after which the capture fails
POLL_INTERVAL = 0.005  # s between two reads of the camera


class Camera:
    """A camera that gives raw frames. The constructor opens it; its arguments are the user's settings.

    The constructor raises `DataError` where the camera is missing, busy or not accessible, or its library is missing.
    """

    #: What the driver did about the camera's own correction, or what the user has to do, in one line.
    correction: ClassVar[str] = ""
    #: What identifies the camera, such as a serial number; empty if nothing does, and its maps are not kept.
    identity: str = ""

    def read(self) -> Array | None:
        """The newest frame, without waiting.

        Returns:
            (h, w), integers or float32; None if there is no new frame.

        Raises:
            DataError: The camera is gone.
        """
        raise NotImplementedError

    def close(self) -> None:
        """Close the camera and restore its former state."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def camera_frames(camera: Camera) -> Iterator[Array]:
    """The newest frame of an open camera, again and again.

    Raises:
        DataError: None has come for `FRAME_TIMEOUT`, or the camera is gone.
    """
    last = time.monotonic()
    while True:
        frame = camera.read()
        if frame is not None:
            yield frame
            last = time.monotonic()  # whoever takes the frames may be slow
        elif time.monotonic() - last > FRAME_TIMEOUT:
            raise DataError(
                f"the camera has sent nothing for {FRAME_TIMEOUT:g} s: is it busy? Else unplug it and plug it in again"
            )
        else:
            time.sleep(POLL_INTERVAL)


def capture(
    camera: Camera, count: int, every: float, on_frame: Callable[[Sequence[Array]], None]
) -> tuple[Array, Array, float]:
    """Take frames from a camera; pictures identical to the last one are skipped.

    Args:
        camera: The open camera.
        count: Number of frames.
        every: Least time between two frames, s.
        on_frame: Called with all frames so far after each.

    Returns:
        The frames (N, h, w), their times (N,), s after the first, and the longest time without a new picture, s.

    Raises:
        DataError: No new picture arrives for `FRAME_TIMEOUT`, or the size changes.
    """
    frames: list[Array] = []
    times: list[float] = []
    last, seen, freeze = None, 0.0, 0.0
    for frame in camera_frames(camera):
        now = time.monotonic()
        if last is not None and np.array_equal(frame, last):
            if now - seen > FRAME_TIMEOUT:
                raise DataError(
                    f"the camera's picture has not changed for {FRAME_TIMEOUT:.0f} s, not even by noise: its shutter "
                    "is closed, it is frozen, or something reduces its noise to nothing"
                )
            time.sleep(POLL_INTERVAL)
            continue
        if frame.ndim != 2 or (last is not None and frame.shape != last.shape):
            raise DataError(f"the camera gives frames of shape {frame.shape}; one size (h, w) is needed")
        freeze = max(freeze, now - seen) if frames else 0.0
        if not times or now - times[-1] >= every:
            frames.append(frame.copy())
            times.append(now)
            on_frame(frames)
        if len(frames) == count:
            break
        last, seen = frame, time.monotonic()
    return np.stack(frames), np.array(times) - times[0], freeze


def motion_span(frames: Sequence[Array]) -> tuple[float, float] | None:
    """Range of the frames' motion along x and along y, px; None if the last frame shows another place.

    The frames (h, w) are registered as in a run, but by shifts only and at a reduced size.
    """
    import torch

    from deepir.registration import register

    stack = torch.from_numpy(np.stack(frames).astype(np.float32))
    factor = -(-max(stack.shape[1:]) // MAX_REGISTRATION_SIDE)
    found = register(torch.nn.functional.avg_pool2d(stack, factor), model="shift")
    if not found.used[-1]:
        return None
    at = factor * found.motion[found.used][:, :2, 2]
    x, y = (at.amax(0) - at.amin(0)).tolist()
    return x, y


def advice(span: tuple[float, float] | None) -> str:
    """What the person with the camera should do next, given `motion_span`."""
    if span is None:
        return "this frame shows another place: move less at a time"
    x, y = span
    so_far = f"{x:.0f} px along x and {y:.0f} px along y so far"
    if x < MIN_CAPTURE_SPAN and y < MIN_CAPTURE_SPAN:
        return f"{so_far}: move the camera, in a small circle"
    if x < MIN_CAPTURE_SPAN:
        return f"{so_far}: move it sideways too"
    if y < MIN_CAPTURE_SPAN:
        return f"{so_far}: move it up and down too"
    return f"{so_far}: well done, on in a circle"
