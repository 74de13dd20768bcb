"""Which axis of an array counts its frames: arrays come as (N, h, w), (h, w, N) and turned in other ways."""

from __future__ import annotations

from typing import Any

import numpy as np

from deepir.arrays.samples import as_float32
from deepir.errors import DataError
from deepir.io.inspection.checks import MIN_FRAME_SIDE

Array = np.ndarray[Any, np.dtype[Any]]

USUAL = "nhw"  # frames, height, width
TURNED = ("hwn", "wnh")  # frames counted along the last axis, and an array (N, h, w) of MATLAB
MAX_ASPECT = 4.0  # of a frame's sides, above which another reading is looked for
USUAL_ASPECT = 2.0  # of the sides in that reading, at most
#: Heights and widths of thermal detectors, px.
DETECTORS = {(60, 80), (120, 160), (156, 208), (192, 256), (240, 320), (256, 320), (256, 336), (288, 382)} | {
    (288, 384),
    (480, 640),
    (512, 640),
    (768, 1024),
    (1024, 1280),
}
BLOCK_SIDE = 96  # samples along an axis that are compared
LAGS = (1, 8)  # samples between those that are compared
MIN_PERSISTENCE = 0.25  # correlation at the longer lag along the axis of frames, which hold one fixed pattern
MIN_PERSISTENCE_RATIO = 0.5  # of the correlations at the longer and the shorter lag; a scene's texture has less
MAX_OTHER_PERSISTENCE = 0.5  # correlation at the longer lag along the first axis over that along the axis of frames
MAX_DIFFERENCE = 0.3  # of the correlations at the shorter lag along both axes of a frame
MIN_TEXTURE = 0.5  # correlation at the shorter lag along both axes of frames of a scene without a fixed pattern
MAX_MOVING_TEXTURE = 0.1  # the same along the axis of the frames, where that scene jumps


def oriented(frames: Array, axes: str | None, source: str) -> Array:
    """Frames (N, h, w) of an array whose `axes` are named in order, such as "hwn".

    Args:
        frames: Three axes.
        axes: None: `USUAL`, unless the array looks turned.
        source: The file, for messages.

    Raises:
        DataError: It looks turned, and `axes` does not say.
    """
    if axes is None:
        if (likely := turned_axes(frames)) is not None:
            count, other = frames.shape[0], frames.shape[likely.index("n")]
            raise DataError(
                f"{source}: {count} frames of {frames.shape[1]} x {frames.shape[2]} px, or {other} frames counted "
                f"along another axis? data.axes={likely} reads {other} frames, data.axes={USUAL} reads it as it is"
            )
        return frames
    return frames.transpose([axes.index(each) for each in USUAL])


def turned_axes(frames: Array) -> str | None:
    """The likely axes of an array that is read as (N, h, w) but is not; None if nothing speaks for that.

    Small frames speak for it; long and narrow ones, and those whose other sides are a detector's, unless a fixed
    pattern goes on along the first axis; a fixed pattern along another axis; and a scene that is continuous along the
    first axis but not along another.
    """
    shape = frames.shape
    block = as_float32(np.ma.getdata(frames)[:BLOCK_SIDE, :BLOCK_SIDE, :BLOCK_SIDE])
    is_large = min(block.shape) > LAGS[-1] + 1
    correlations = [_correlations(block, axis) if is_large else [0.0, 0.0] for axis in range(3)]
    first = correlations[0]
    for axes in TURNED:
        height, width, count = (shape[axes.index(each)] for each in "hwn")
        if count == 1 or min(height, width) < MIN_FRAME_SIDE:
            continue
        along = correlations[axes.index("n")]
        side = correlations[3 - axes.index("n")]  # the other axis of a frame beside the first
        aspect = max(shape[1:]) / min(shape[1:])
        narrow = aspect > MAX_ASPECT and max(height, width) <= USUAL_ASPECT * min(height, width)
        known = (height, width) in DETECTORS and (shape[1], shape[2]) not in DETECTORS
        goes_on = first[1] > MIN_PERSISTENCE and along[1] < MAX_OTHER_PERSISTENCE * first[1]
        pattern = (
            along[1] > max(MIN_PERSISTENCE, MIN_PERSISTENCE_RATIO * along[0])
            and first[1] < MAX_OTHER_PERSISTENCE * along[1]
            and abs(first[0] - side[0]) < MAX_DIFFERENCE
        )
        texture = all(each[0] > max(MIN_TEXTURE, each[1] / MIN_PERSISTENCE_RATIO) for each in (first, side))
        moves = texture and abs(along[0]) < MAX_MOVING_TEXTURE
        if count < MIN_FRAME_SIDE or ((narrow or known) and not goes_on) or pattern or moves:
            return axes
    return None


def _correlations(block: Array, axis: int) -> list[float]:
    """Correlation of the diagonal detail across the two other axes, at lags along one."""
    x = np.nan_to_num(np.moveaxis(block, axis, 0), posinf=0, neginf=0)
    detail = x[:, :-1, :-1] - x[:, 1:, :-1] - x[:, :-1, 1:] + x[:, 1:, 1:]
    most = 3 * float(np.median(np.abs(detail)))  # defective pixels and edges count no more than others
    detail = np.clip(detail, -most, most)
    power = float((detail * detail).mean())
    return [float((detail[:-lag] * detail[lag:]).mean()) / power if power else 0.0 for lag in LAGS]
