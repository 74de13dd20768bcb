"""Checks of frames: their usable samples, rows that are no picture, and frames that were torn while transferred."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.ndimage import label

from deepir.arrays import Array
from deepir.errors import DataError
from deepir.messages import Message

MIN_FRAME_SIDE = 16  # px; smaller frames can be neither registered nor reconstructed
MAX_VALUE = 1e9  # largest value of a frame: its fourth power stays within float32
MIN_RANGE = 1e-15  # smallest range of a frame: its square stays within float32
#: Share of the line beside a bar that may hold its value; above, it is a scene at the end of the range.
MAX_BAR_CONTINUATION = 0.05
SAMPLES = 100_000  # from which the range of the others is measured
MIN_COLD_PIXELS = 20  # pixels inside, and at the rim, of a region that is too cold to be recorded
MIN_COLD_CORE = 0.3  # pixels inside such a region over pixels at its rim
MAX_TELEMETRY_ROWS = 4  # telemetry rows at one edge
COMPARED_ROWS = 4  # picture rows next to them, with which they are compared
ROUGHNESS_QUANTILE = 0.9  # quantile of a row's absolute differences that is its roughness
MIN_ROUGHNESS_RATIO = 8.0  # roughness of a telemetry row over that of a picture row
MIN_STEP_RATIO = 16.0  # of a row of few words: its distance from the picture, and its largest step, over usual steps
SAMPLED_FRAMES = 8  # frames that are inspected
ROW_STRIDE = 8  # every n-th row of the middle of a frame is inspected
MIN_PART_ROWS = 8  # rows of either part
BLOCK_SIDE = 4  # px, of blocks within those that a codec leaves as they were
MAX_EQUAL_BLOCKS = 0.02  # share of them that repeat a neighbour's in the other part; above, a codec repeats rows too
LISTED_FRAMES = 32  # that advice names one by one, at most
MAX_REPEATING = 0.5  # share of frames that repeat rows, above which these rows stand still

Mask = np.ndarray[Any, np.dtype[np.bool_]]


def validate(frames: Array, source: str, *, needs: int = 1, are_pictures: bool = True) -> Mask:
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


def unusable_frames(frames: Array) -> dict[int, str]:
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


def unrecorded_samples(frames: Array) -> Mask:
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


def _bars(frames: Array) -> Mask:
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


def crop(frames: Array, box: Sequence[int]) -> Array:
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


def telemetry_rows(frames: Array) -> list[int]:
    """Telemetry rows of frames: pictures are continuous from row to row, numbers are not.

    Args:
        frames: (N, h, w).

    Returns:
        Row numbers.
    """
    count, height, width = frames.shape
    edge = MAX_TELEMETRY_ROWS + COMPARED_ROWS
    if height < 2 * edge or width < 2:
        return []
    some = frames[:: max(1, count // SAMPLED_FRAMES)]
    inside = some[:, edge:-edge:ROW_STRIDE] if height >= 4 * edge else some
    seen, steps = np.isfinite(inside).any((0, 2)), np.abs(np.diff(_known(some), axis=1))
    if not seen.any() or not (known := np.isfinite(steps)).any():
        return []
    usual, step = float(np.median(_rough(inside)[seen])), float(np.median(steps[known]))
    above, below = (_at_start(rows, usual, step) for rows in (some[:, :edge], some[:, : -edge - 1 : -1]))
    return [*range(above), *range(height - below, height)]


def _known(rows: Array) -> Array:
    """NaN in place of what is infinite."""
    return np.where(np.isfinite(rows), rows, np.nan).astype(np.float32)


def _rough(rows: Array) -> Array:
    """Roughness (K,) of rows (N, K, w): a high quantile of their absolute differences, in a typical frame."""
    steps = np.nan_to_num(np.abs(np.diff(_known(rows), axis=-1)))
    found: Array = np.median(np.quantile(steps, ROUGHNESS_QUANTILE, axis=-1), axis=0)
    return found


def _at_start(rows: Array, usual: float, step: float) -> int:
    """Number of telemetry rows at the start of rows (N, K, w), by roughness and difference of usual picture rows."""
    rough, known = _rough(rows), _known(rows)
    peaks = np.median(np.nan_to_num(np.abs(np.diff(known, axis=-1))).max(-1), axis=0)
    for count in range(MAX_TELEMETRY_ROWS, 0, -1):
        beside = max(usual, float(rough[count : count + COMPARED_ROWS].max()))
        is_rough = (rough[:count] > MIN_ROUGHNESS_RATIO * beside) & (beside > 0)
        apart = np.median(np.nan_to_num(np.abs(known[:, :count] - known[:, count : count + 1])), axis=(0, 2))
        has_words = (np.minimum(apart, peaks[:count]) > MIN_STEP_RATIO * step) & (step > 0)
        if (is_rough | has_words).all():
            return count
    return 0


def telemetry_message(rows: list[int], shape: tuple[int, int]) -> str:
    """A warning on telemetry rows of frames of a shape (h, w)."""
    height, width = shape
    above = sum(row < height / 2 for row in rows)
    box = [above, height - len(rows) + above, 0, width]
    some = f"row {rows[0]} shows" if len(rows) == 1 else f"rows {', '.join(map(str, rows))} show"
    return Message(
        "telemetry-rows", f"{some} numbers and no picture (telemetry?): left out. data.crop={box} takes them off"
    )


def torn_frames(frames: Array) -> dict[int, int]:
    """Numbers of torn frames (N, h, w), and the first row of their lower part.

    A part of rows is that of a neighbour, sample for sample.
    """
    if frames.shape[1] < 2 * MIN_PART_ROWS or frames.shape[2] < BLOCK_SIDE:
        return {}
    found = {k: row for k in range(len(frames)) if (row := _repeated_rows(frames, k))}
    return {} if len(found) > MAX_REPEATING * len(frames) else found


def torn_message(torn: dict[int, int], count: int) -> list[str]:
    """A warning on torn frames of `count`; [] if there are none."""
    if not torn:
        return []
    some = ", ".join(f"{k} (at row {row})" for k, row in torn.items())
    rest = ", ".join(str(k) for k in range(count) if k not in torn)
    advice = f"leave them out: data.frames=[{rest}]" if count <= LISTED_FRAMES else "leave them out by data.frames"
    return [Message("torn-frames", f"torn frame(s), of two times above and below a row: {some}; {advice}")]


def _repeated_rows(frames: Array, k: int) -> int:
    """First row of the lower part of frame k if one part repeats a neighbour's, else 0."""
    height = frames.shape[1]
    for other in (k - 1, k + 1):
        edge = 0 if other < k else -1  # from which a repeated part reaches inwards
        if not 0 <= other < len(frames) or (frames[k, edge] != frames[other, edge]).any():
            continue
        same = (frames[k] == frames[other]).all(1) & (frames[k] != frames[k][:, :1]).any(1)
        count = int((same if other < k else same[::-1]).cumprod().sum())
        row = count if other < k else height - count
        elsewhere = slice(row, None) if other < k else slice(row)
        if not MIN_PART_ROWS <= count <= height - MIN_PART_ROWS:
            continue
        if _equal_blocks(frames[k, elsewhere], frames[other, elsewhere]) < MAX_EQUAL_BLOCKS:
            return row
    return 0


def _equal_blocks(part: Array, other: Array) -> float:
    """Share of the blocks of two parts (h, w) that are equal, sample for sample, and not of one value."""
    height, width = (side // BLOCK_SIDE * BLOCK_SIDE for side in part.shape)
    a, b = (
        each[:height, :width].reshape(height // BLOCK_SIDE, BLOCK_SIDE, width // BLOCK_SIDE, BLOCK_SIDE)
        for each in (part, other)
    )
    return float(((a == b).all((1, 3)) & (a != a[:, :1, :, :1]).any((1, 3))).mean())
