"""Frames that a user selects, pairs of frames beside them, and their type."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from deepir.errors import DataError

Array = np.ndarray[Any, np.dtype[Any]]
Select = str | int | Sequence[int] | None

MAX_UNSELECTED_PAIRS = 6  # pairs of frames outside a burst that are kept to score its correction
MAX_PAIR_GAP = 8  # frames between the two of a pair
MIN_STEPS = 8  # steps of single precision that a frame spans; fewer hide what it shows
MAX_JUDGED = 10_000  # samples of a frame that are enough to judge that


def to_float32(array: Array) -> np.ndarray[Any, np.dtype[np.float32]]:
    """Copy in float32: exact up to 24 bits, infinite beyond its range, NaN where the array is masked."""
    with np.errstate(over="ignore"):
        return np.ma.filled(array.astype(np.float32, order="C"), np.nan)


def selected_in_float32(frames: Array, select: Select, source: str) -> np.ndarray[Any, np.dtype[np.float32]]:
    """The selected frames, see `read_frames`, in float32.

    Raises:
        DataError: `select` does not fit the frames, or they span too little of their level for single precision.
    """
    chosen = select_frames(frames, select, source)
    found = to_float32(chosen)
    if chosen.dtype.kind not in "uif" or np.can_cast(chosen.dtype, np.float32) or not len(chosen):
        return found
    spans, errors, step = [], [], max(1, chosen[0].size // MAX_JUDGED)
    for frame, rounded in zip(chosen, found, strict=True):
        known = np.isfinite(rounded)
        values, steps = np.asarray(frame)[known][::step].astype(np.float64), rounded[known][::step]
        low, high = np.quantile(values, (0.01, 0.99)) if values.size else (0.0, 0.0)
        spans.append(high - low)
        errors.append(np.abs(values - steps).max(initial=0.0))
    if 0 < np.median(spans) < 2 * MIN_STEPS * np.median(errors):
        raise DataError(
            f"{source}: frames span {np.median(spans):.3g} at a level of {np.median(steps):.6g}, which single "
            "precision does not resolve. Subtract the level in double precision, before"
        )
    return found


def select_frames(frames: Array, select: Select, source: str) -> Array:
    """The selected frames, see `read_frames`.

    Raises:
        DataError: `select` does not fit the frames; the message names `source`.
    """
    if select is None:
        return frames
    count = len(frames)
    wrong = DataError(
        f"{source}: data.frames={select!r} does not fit its {count} frames (numbered from 0). "
        "Give a count (8), a slice ('2:10', '::2') or a list of frame numbers ([0, 3, 5])."
    )
    try:
        picked = _indices(select)
    except ValueError:
        raise wrong from None
    named = [picked.start, picked.stop] if isinstance(picked, slice) else picked
    # A slice's end may be one beyond the last frame.
    limit = count + isinstance(picked, slice)
    if any(i is not None and not -count <= i < limit for i in named) or not len(np.arange(count)[picked]):
        raise wrong
    return frames[picked]


def unselected_pairs(frames: Array, select: Select) -> np.ndarray[Any, np.dtype[np.float32]] | None:
    """Pairs of frames outside the selection, from its neighbourhood.

    The two frames of a pair are half the reach of the burst apart, at most `MAX_PAIR_GAP` frames.

    Args:
        frames: (N, h, w).
        select: The selection, see `read_frames`.

    Returns:
        (2 M, h, w), float32; None if there is no pair.
    """
    if select is None:
        return None
    numbers = np.arange(len(frames))
    taken = numbers[_indices(select)]
    reach = int(np.ptp(taken))
    gap = int(np.clip(reach // 2, 1, MAX_PAIR_GAP))
    free = (
        ~np.isin(numbers, taken) & (numbers >= taken.min() - reach) & (numbers <= taken.max() + reach + gap)
    )
    starts = numbers[:-gap][free[:-gap] & free[gap:]]
    if not len(starts):
        return None
    some = starts[
        np.unique(np.linspace(0, len(starts) - 1, min(len(starts), MAX_UNSELECTED_PAIRS)).round().astype(int))
    ]
    return to_float32(frames[np.stack((some, some + gap), 1).ravel()])


def _indices(select: str | int | Sequence[int]) -> slice | list[int]:
    """A slice or a list of a selection; `ValueError` if it is neither, or has a step of zero."""
    if isinstance(select, str) and ":" in select:
        bounds = [int(part) if part.strip() else None for part in select.split(":")]
        if len(bounds) > 3 or (len(bounds) == 3 and bounds[2] == 0):
            raise ValueError(select)
        return slice(*bounds)
    if isinstance(select, bool) or not isinstance(select, str | int | Sequence):
        raise ValueError(select)
    if isinstance(select, str | int):
        count = int(select)
        if count < 1:
            raise ValueError(select)
        return slice(0, count)
    if any(isinstance(i, bool) or not isinstance(i, int | np.integer) for i in select):
        raise ValueError(select)
    return [int(i) for i in select]
