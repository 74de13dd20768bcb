"""Rows of a frame that are no picture: telemetry, and frames that were torn while they were transferred."""

from __future__ import annotations

from typing import Any

import numpy as np

from deepir.messages import Message

MAX_TELEMETRY_ROWS = 4  # telemetry rows at one edge
COMPARED_ROWS = 4  # picture rows next to them, with which they are compared
ROUGHNESS_QUANTILE = 0.9  # quantile of a row's absolute differences that is its roughness
MIN_ROUGHNESS_RATIO = 8.0  # roughness of a telemetry row over that of a picture row
MIN_STEP_RATIO = 16.0  # of a row of few words: its distance from the picture, and its largest step, over usual steps
SAMPLED_FRAMES = 8  # frames that are inspected
ROW_STRIDE = 8  # every n-th row of the middle of a frame is inspected
Array = np.ndarray[Any, np.dtype[Any]]
MIN_PART_ROWS = 8  # rows of either part
BLOCK_SIDE = 4  # px, of blocks within those that a codec leaves as they were
MAX_EQUAL_BLOCKS = 0.02  # share of them that repeat a neighbour's in the other part; above, a codec repeats rows too
LISTED_FRAMES = 32  # that advice names one by one, at most
MAX_REPEATING = 0.5  # share of frames that repeat rows, above which these rows stand still


def telemetry_rows(frames: np.ndarray[Any, Any]) -> list[int]:
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


def _known(rows: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """NaN in place of what is infinite."""
    return np.where(np.isfinite(rows), rows, np.nan).astype(np.float32)


def _rough(rows: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Roughness (K,) of rows (N, K, w): a high quantile of their absolute differences, in a typical frame."""
    steps = np.nan_to_num(np.abs(np.diff(_known(rows), axis=-1)))
    found: np.ndarray[Any, Any] = np.median(np.quantile(steps, ROUGHNESS_QUANTILE, axis=-1), axis=0)
    return found


def _at_start(rows: np.ndarray[Any, Any], usual: float, step: float) -> int:
    """Number of telemetry rows at the start.

    Args:
        rows: (N, K, w), these and the next ones, from the edge on.
        usual: Roughness of a picture row.
        step: Usual difference of neighbouring picture rows.
    """
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
        "telemetry-rows",
        f"{some} numbers and no picture (telemetry?): left out. data.crop={box} takes them off",
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
