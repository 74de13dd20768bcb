"""Checks of frames, and masks of their usable samples."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.ndimage import label

from deepir.errors import DataError

MIN_FRAME_SIDE = 16  # px; smaller frames can be neither registered nor reconstructed
MAX_VALUE = 1e9  # largest value of a frame: its fourth power stays within float32
MIN_RANGE = 1e-15  # smallest range of a frame: its square stays within float32
#: Share of the line beside a bar that may hold its value; above, it is a scene at the end of the range.
MAX_BAR_CONTINUATION = 0.05
SAMPLES = 100_000  # from which the range of the others is measured
MIN_COLD_PIXELS = 20  # pixels inside, and at the rim, of a region that is too cold to be recorded
MIN_COLD_CORE = 0.3  # pixels inside such a region over pixels at its rim

Mask = np.ndarray[Any, np.dtype[np.bool_]]


def validate(frames: np.ndarray[Any, Any], source: str, *, needs: int = 1, are_pictures: bool = True) -> Mask:
    """Check frames and find their finite samples.

    Args:
        frames: (N, h, w).
        source: The file, for messages.
        needs: Least number of frames.
        are_pictures: Whether they are to be registered. Else they may have any size, and NaN at any sample.

    Returns:
        (N, h, w) bool, finite samples.

    Raises:
        DataError: There are fewer frames, they are smaller than `MIN_FRAME_SIDE`, one is unusable or out of bounds, or
            no sample has finite neighbours.
    """
    count, height, width = frames.shape
    if count < needs:
        raise DataError(f"{source}: {count} frame(s), but this needs at least {needs}")
    valid = np.isfinite(frames)
    if are_pictures:
        _check_side(height, width, source)
        for k, why in unusable_frames(frames).items():
            raise DataError(f"{source}: frame {k} is {why}. Leave it out (data.frames)")
    elif not valid.any():
        raise DataError(f"{source}: all samples are NaN or infinite")
    if are_pictures and not has_neighbours(valid):
        raise DataError(
            f"{source}: no sample has finite neighbours, as where every second row or column is NaN. Keep the rows and "
            "columns that are there (frames[:, ::2, ::2]), or fill in the others"
        )
    for k in map(int, np.flatnonzero(valid.any((1, 2)))):
        values = frames[k] if valid[k].all() else frames[k][valid[k]]
        low, high = float(values.min()), float(values.max())
        if max(-low, high) > MAX_VALUE or (are_pictures and high - low < MIN_RANGE):
            raise DataError(
                f"{source}: frame {k} is {low:g} to {high:g}, which is out of bounds (values up to 1e9, a range from "
                "1e-15): damaged, or in unusual units? Give counts, kelvin or [0, 1]"
            )
    return valid


def has_neighbours(valid: Mask) -> bool:
    """Whether 2 x 2 samples side by side count anywhere; valid: (N, h, w)."""
    return any((v[1:, 1:] & v[1:, :-1] & v[:-1, 1:] & v[:-1, :-1]).any() for v in valid)


def unusable_frames(frames: np.ndarray[Any, Any]) -> dict[int, str]:
    """Numbers of the frames (N, h, w) without content, and the reason: constant, or mostly not finite."""
    found = {}
    for k, frame in enumerate(frames):
        if np.isfinite(low := frame.min()) and low < frame.max() < np.inf:
            continue
        values = frame[np.isfinite(frame)]
        lost = 1 - values.size / frame.size
        if lost > 0.5:
            found[k] = f"{lost:.0%} NaN or infinite"
        elif values.min() == values.max():
            found[k] = f"{values[0]:g} everywhere (a shutter, or lost)"
    return found


def unrecorded_samples(frames: np.ndarray[Any, Any]) -> Mask:
    """Samples in which nothing was recorded.

    Bars are whole rows and columns, from the edge on, that hold one value in all frames. Lost samples, rows or packets
    are zeros further below all other values than their range, except in regions of a scene that is too cold.

    Args:
        frames: (N, h, w).

    Returns:
        (N, h, w) bool.
    """
    bars = _bars(frames) if len(frames) > 1 else np.zeros(frames.shape[1:], bool)
    zero = frames == 0
    if zero.any() and (seen := ~(zero | bars)).any():
        step = frames.size // SAMPLES | 1  # odd: not the same columns in every row
        some = frames.ravel()[::step][seen.ravel()[::step]]
        low, high = np.nanquantile(some if some.size else frames[seen], (0.01, 0.99))
        if low > high - low:
            return bars | zero & ~_cold(zero & ~bars)
    return np.broadcast_to(bars, frames.shape)


def _bars(frames: np.ndarray[Any, Any]) -> Mask:
    """Pixels (h, w) of bars; a scene at the end of the range is none, if its value continues beside it."""
    found, bars = (np.zeros(frames.shape[1:], bool) for _ in range(2))
    directions = [(axis, way) for axis in (0, 1) for way in (slice(None), slice(None, None, -1))]
    widths = []
    for axis, way in directions:
        lines = np.moveaxis(frames, axis + 1, 0)[way]
        widths.append(next((k for k, line in enumerate(lines) if (line != line[0, 0]).any()), len(lines)))
        np.moveaxis(found, axis, 0)[way][: widths[-1]] = True
    for (axis, way), width in zip(directions, widths, strict=True):
        lines, known = np.moveaxis(frames, axis + 1, 0)[way], ~np.moveaxis(found, axis, 0)[way]
        beside = lines[width][:, known[width]] if 0 < width < len(lines) else np.zeros((1, 0))
        if beside.size and (beside == lines[0, 0, 0]).mean() < MAX_BAR_CONTINUATION:
            np.moveaxis(bars, axis, 0)[way][:width] = True
    return bars


def _cold(zero: Mask) -> Mask:
    """Pixels (h, w) of regions that are zero inside in all frames and at the rim in some, as the camera moves."""
    always, region = zero.all(0), label(zero.any(0))[0]
    inside, rim = (np.bincount(region.flat, each.flat) for each in (always, zero.any(0) & ~always))
    cold = (np.minimum(inside, rim) >= MIN_COLD_PIXELS) & (inside > MIN_COLD_CORE * rim)
    return np.asarray(cold[region])


def crop(frames: np.ndarray[Any, Any], box: Sequence[int]) -> np.ndarray[Any, Any]:
    """Crop frames (..., h, w).

    Args:
        frames: (..., h, w).
        box: [y0, y1, x0, x1]; y1 and x1 are the first row and column outside.

    Raises:
        DataError: The box is not inside the frame, or is smaller than `MIN_FRAME_SIDE`.
    """
    height, width = frames.shape[-2:]
    if len(box) != 4:
        raise DataError(f"data.crop: {list(box)} must be four numbers, [y0, y1, x0, x1]")
    y0, y1, x0, x1 = box
    if not (0 <= y0 < y1 <= height and 0 <= x0 < x1 <= width):
        raise DataError(
            f"data.crop: [y0, y1, x0, x1] = {list(box)} is not inside the frame of {height} x {width} px "
            f"(the whole frame is [0, {height}, 0, {width}])"
        )
    _check_side(y1 - y0, x1 - x0, "data.crop")
    return frames[..., y0:y1, x0:x1]


def _check_side(height: int, width: int, source: str) -> None:
    if min(height, width) < MIN_FRAME_SIDE:
        raise DataError(f"{source}: {height} x {width} px is too small; at least {MIN_FRAME_SIDE} px on a side")
