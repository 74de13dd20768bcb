"""Torn frames: the upper part is of one time, the lower part of another."""

from __future__ import annotations

from typing import Any

import numpy as np

from deepir.messages import Message

Array = np.ndarray[Any, np.dtype[Any]]

MIN_PART_ROWS = 8  # rows of either part, where one repeats a neighbour's
MIN_SEAM_ROWS = 16  # rows of either part, where only their seam tells
MIN_FRAMES = 3  # frames whose common fixed pattern is left out
MAX_REPEATING = 0.5  # share of frames that repeat rows, above which these rows stand still
CHUNK = 16  # frames that are compared with each other
COLUMN_STRIDE = 2  # every n-th column is inspected
MIN_SEAM_RATIO = (
    1.9  # step across a seam over the largest of usual frames, and over the next largest of its own
)


def torn_frames(frames: Array) -> dict[int, int]:
    """Numbers of torn frames (N, h, w), and the first row of their lower part.

    Either a part of rows is that of a neighbour, sample for sample, or one step from row to row stands out over the
    whole width. Steps that all frames show are the fixed pattern's.
    """
    if frames.shape[1] < 2 * MIN_PART_ROWS:
        return {}
    found = {k: row for k in range(len(frames)) if (row := _repeated_rows(frames, k))}
    if len(found) > MAX_REPEATING * len(frames):
        found = {}
    for start in range(0, len(frames), CHUNK):
        some = frames[start : start + CHUNK]
        if len(some) >= MIN_FRAMES:
            found |= {start + k: row for k, row in _seams(some).items() if start + k not in found}
    return dict(sorted(found.items()))


def torn_message(torn: dict[int, int], count: int) -> list[str]:
    """A warning on torn frames of `count`; [] if there are none."""
    if not torn:
        return []
    some = ", ".join(f"{k} (at row {row})" for k, row in torn.items())
    rest = ", ".join(str(k) for k in range(count) if k not in torn)
    advice = (
        f"leave them out: data.frames=[{rest}]" if count <= 2 * CHUNK else "leave them out by data.frames"
    )
    return [Message("torn-frames", f"torn frame(s), of two times above and below a row: {some}; {advice}")]


def _repeated_rows(frames: Array, k: int) -> int:
    """First row of the lower part of frame k if one part repeats a neighbour's, else 0."""
    height = frames.shape[1]
    for other in (k - 1, k + 1):
        if 0 <= other < len(frames):
            same = (frames[k] == frames[other]).all(1) & (frames[k] != frames[k][:, :1]).any(1)
            upper, lower = int(same.cumprod().sum()), int(same[::-1].cumprod().sum())
            if other < k and MIN_PART_ROWS <= upper <= height - MIN_PART_ROWS:
                return upper
            if other > k and MIN_PART_ROWS <= lower <= height - MIN_PART_ROWS:
                return height - lower
    return 0


def _seams(frames: Array) -> dict[int, int]:
    """Frames in which one step from row to row stands out, and the row below it."""
    some = frames[:, :, ::COLUMN_STRIDE]
    steps = np.nan_to_num(np.diff(np.where(np.isfinite(some), some, np.nan).astype(np.float32), axis=1))
    steps = np.median(np.abs(steps - np.median(steps, axis=0)), axis=-1)  # (N, h - 1)
    rows, largest = steps.argmax(1), steps.max(1)
    usual = float(np.median(largest))
    found = {}
    for k, row in enumerate(rows.tolist()):
        beside = np.concatenate((steps[k, : max(0, row - 2)], steps[k, row + 3 :]))
        inside = MIN_SEAM_ROWS <= row + 1 <= frames.shape[1] - MIN_SEAM_ROWS
        if (
            inside
            and usual > 0
            and beside.size
            and largest[k] > MIN_SEAM_RATIO * max(usual, float(beside.max()))
        ):
            found[k] = row + 1
    return found
