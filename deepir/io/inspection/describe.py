"""A burst in words, for `deepir check FILE`."""

from __future__ import annotations

from typing import Any

import numpy as np

from deepir.arrays.samples import block_sums, mixed_deviation
from deepir.io.frames import Frames
from deepir.io.inspection.checks import (
    has_neighbours,
    telemetry_message,
    telemetry_rows,
    torn_frames,
    torn_message,
    unrecorded_samples,
    unusable_frames,
)
from deepir.io.inspection.samples import FULL_SCALE_COUNTS, drawn_message, drawn_pixels
from deepir.io.radiometry import ZERO_CELSIUS

Array = np.ndarray[Any, np.dtype[np.float32]]

TLINEAR_COUNTS = (23315, 42315)  # counts of TLinear (K x 100) from -40 to 150 °C
BLOCK_SIDE = 8  # px; side of the blocks whose means show motion
MIN_VISIBLE_MOTION = 0.1  # px between frames below which a camera counts as still
MIN_F_STATISTIC = 10.0  # F statistic above which a shift is significant
MEASURED_PAIRS = 32  # pairs of consecutive frames in which noise and motion are measured


def describe(burst: Frames) -> list[str]:
    """Lines on number, size and type of the frames, their values, unusable samples, noise and motion."""
    frames = burst.frames
    count, height, width = frames.shape
    known = np.isfinite(frames)
    finite = frames.ravel() if known.all() else frames[known]
    lines = [f"{count} frame(s) of {height} x {width} px (height x width), stored as {burst.dtype}"]
    if not finite.size:
        return [*lines, "no finite value at all"]
    lines.append(f"values {finite.min():g} to {finite.max():g}, median {np.median(finite):g}")
    lines += _temperatures(burst, finite)
    lines += _unusable(burst, finite)
    unusable = unusable_frames(frames)
    lines += [f"frame {k} shows nothing: it is {why}" for k, why in unusable.items()]
    frames = np.delete(frames, [*unusable], axis=0)
    if len(frames) and (rows := telemetry_rows(frames)):
        lines.append(telemetry_message(rows, (height, width)))
        frames = np.delete(frames, rows, axis=1)
    lines += torn_message(torn_frames(frames), len(frames))
    if np.isfinite(frames).any() and (empty := unrecorded_samples(frames)).any():
        lines.append(f"{int(empty.sum())} sample(s) hold nothing: zeros far below all others, or bars at the edge")
        frames = np.where(empty, np.float32(np.nan), frames)
    if (drawn := drawn_pixels(frames)).any():
        lines += drawn_message(drawn)
        frames = np.where(drawn, np.float32(np.nan), frames)
    repeats = [k for k in range(1, len(frames)) if frames[k].tobytes() == frames[k - 1].tobytes()]
    if 0 < len(repeats) < len(frames) - 1:
        lines.append(f"{len(repeats)} frame(s) repeat the one before them; a run leaves them out")
        frames = np.delete(frames, repeats, axis=0)
    return lines + _noise_and_motion(frames)


def _temperatures(burst: Frames, finite: Array) -> list[str]:
    ends = np.array([finite.min(), finite.max()])
    if burst.radiometry is not None:
        low, high = burst.radiometry.kelvin(ends) - ZERO_CELSIUS
        return [f"radiometric: {low:.2f} to {high:.2f} °C by {burst.radiometry}"]
    if burst.dtype == "uint16" and np.all((ends > TLINEAR_COUNTS[0]) & (ends < TLINEAR_COUNTS[1])):
        low, high = ends / 100 - ZERO_CELSIUS
        return [f"{low:.2f} to {high:.2f} °C if these are K x 100 (TLinear): data.radiometry.scale=0.01"]
    return []


def _unusable(burst: Frames, finite: Array) -> list[str]:
    frames = burst.frames
    lines = []
    if missing := frames.size - finite.size:
        why = "colours, and none of the scene's" if burst.dtype == "uint8" else "NaN, infinite or a fill value"
        lines.append(f"{missing} sample(s) are {why} ({missing / frames.size:.2%})")
        if not has_neighbours(np.isfinite(frames)):
            lines.append("no sample has finite neighbours: keep the rows and columns that are there")
    if stuck := int((frames == 0).all(axis=0).sum()):
        lines.append(f"{stuck} pixel(s) are zero in every frame")
    top = finite.max()
    if burst.dtype.startswith("uint") and top in FULL_SCALE_COUNTS:
        lines.append(f"{int((finite == top).sum())} sample(s) are at full scale ({top:g}): saturated")
    return lines


def _noise_and_motion(frames: Array) -> list[str]:
    if _is_little(frames):
        return ["too few or too small frames to measure temporal noise and motion"]
    noise = f"{temporal_noise(frames):.3g} (standard deviation of a sample"
    if shift := visible_motion(frames):
        return [
            f"temporal noise at most {noise}; moving texture included, which a run separates)",
            f"motion: yes, roughly {shift:.1f} px between frames, or more",
        ]
    return [
        f"temporal noise about {noise})",
        "motion: none detected; without motion the fixed pattern cannot be separated from the scene",
    ]


def visible_motion(frames: Array) -> float:
    """Motion between consecutive frames (N, h, w), px, roughly; zero if none is significant."""
    if _is_little(frames) or not np.isfinite(frames).any():
        return 0.0
    shift, evidence = apparent_motion(frames)
    return shift if shift > MIN_VISIBLE_MOTION and evidence > MIN_F_STATISTIC else 0.0


def _is_little(frames: Array) -> bool:
    """True if frames (N, h, w) are too few or too small to show noise and motion."""
    return len(frames) < 2 or min(frames.shape[1:]) < 2 * BLOCK_SIDE


def _pairs(frames: Array) -> tuple[Array, Array]:
    """First and second frames of pairs of consecutive ones; of long recordings, of some over their whole length."""
    count = len(frames) - 1
    if count <= MEASURED_PAIRS:
        return frames[:-1], frames[1:]
    starts = np.linspace(0, count - 1, MEASURED_PAIRS).round().astype(int)
    return frames[starts], frames[starts + 1]


def temporal_noise(frames: Array) -> float:
    """Temporal noise of a sample of frames (N, h, w), from differences of consecutive ones; NaN if there are none.

    Mixed differences cancel most of the motion, but not fine texture: with motion it is an upper bound.
    """
    first, second = _pairs(frames)
    with np.errstate(invalid="ignore"):  # of infinite samples
        return mixed_deviation(second - first) / 2**0.5


def apparent_motion(frames: Array) -> tuple[float, float]:
    """Shift between consecutive frames, by one Lucas-Kanade step on block means.

    It is rough, and too small where the motion is large, but zero for a still camera.

    Args:
        frames: (N, h, w).

    Returns:
        Median shift, px, and median F statistic.
    """
    pairs = np.stack(_pairs(frames))
    known = np.isfinite(pairs)
    if not known.all():
        pairs = np.where(known, pairs, np.median(pairs[known]))
    shifts, evidence = [], []
    for a, b in zip(*(block_sums(each, BLOCK_SIDE) / BLOCK_SIDE**2 for each in pairs), strict=True):
        gradients = [g.ravel() for g in np.gradient((a + b) / 2)]
        model = np.stack([*gradients, np.ones(a.size)], axis=1)
        change = (b - a).ravel()
        solution = np.linalg.lstsq(model, change, rcond=None)[0]
        explained = np.var(model @ solution)
        rest = np.var(change - model @ solution)
        shifts.append(BLOCK_SIDE * np.hypot(*solution[:2]))
        evidence.append(explained / max(rest, np.finfo(np.float64).tiny) * (a.size - 3) / 2)
    return float(np.median(shifts)), float(np.median(evidence))
