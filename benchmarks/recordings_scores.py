"""Figures of a corrected recording: what is left of the pattern, likeness of frames, stated deviations, bad pixels."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from deepir.multiview.held_out_pattern import CorrectionScorer

Array = np.ndarray
Figures = dict[str, float]

LOW_ORDER = 8.0  # px, sigma of the Gaussian below which a pattern counts as fine
MARGIN = 4  # px at the border that are not judged
BLOCK = 16  # px, side of the blocks whose deviations are compared
ROBUST_SIGMA = 1.4826  # standard deviations of a Gaussian per median absolute deviation
#: Shares that intervals of a stated standard deviation should cover, and their half widths in deviations.
COVERAGE = {"covers 68": 1.0, "covers 95": 1.96}


def parts(pattern: Array) -> tuple[Array, Array]:
    """Low-order and fine part of a map (h, w) without its border; NaN is left out, and stays NaN."""
    known = np.isfinite(pattern)
    weight = ndimage.gaussian_filter(known.astype(float), LOW_ORDER)
    low = ndimage.gaussian_filter(np.where(known, pattern, 0.0), LOW_ORDER) / np.maximum(weight, 1e-6)
    inner = np.s_[MARGIN:-MARGIN, MARGIN:-MARGIN]
    return np.where(known, low, np.nan)[inner], (pattern - low)[inner]


def left_over(error: Array, pattern: Array) -> Figures:
    """What is left, (h, w), over the pattern that was there, low-order and fine: 1 is nothing done, more is harm."""
    rms = [[float(np.nanstd(part)) for part in parts(each)] for each in (error, pattern)]
    return {name: rms[0][k] / max(rms[1][k], 1e-12) for k, name in enumerate(("low", "fine"))}


def mean_error(corrected: Array, scene: Array, gains: Array | None = None) -> Array:
    """Mean over the frames (N, h, w) of the error, (h, w); the level of each frame is free, its gain (N,) known."""
    factors = np.ones(len(scene)) if gains is None else gains
    total = np.zeros(scene.shape[1:])
    for frame, true, gain in zip(corrected, scene, factors, strict=True):
        error = np.asarray(frame, float) - true
        total += (error - error.mean()) / gain
    return total / len(scene)


def likeness(frames: Array, scene: Array, known: Array) -> float:
    """Median correlation of frames (N, h, w) with the true ones, over the pixels (h, w) that are known."""
    return float(np.median([alike(a[known], b[known]) for a, b in zip(frames, scene, strict=True)]))


def alike(first: Array, second: Array) -> float:
    return float(np.corrcoef(first.ravel(), second.ravel())[0, 1])


def covered(error: Array, deviation: Array | None) -> Figures:
    """Shares of the errors (h, w) that the stated deviations (h, w) cover; none where nothing is stated."""
    if deviation is None:
        return {}
    known = np.isfinite(error)
    error = np.abs(error - np.nanmean(error))[known]
    return {name: float(np.mean(error <= times * deviation[known])) for name, times in COVERAGE.items()}


def bad_pixels(found: Array | None, true: Array | None) -> Figures:
    """Share of pixels that are called bad; where the truth is known, the share that is found, and false ones."""
    if found is None:
        return {}
    figures = {"bad": float(found.mean())}
    if true is not None:
        figures["bad, false"] = float((found & ~true).mean())
        if true.any():
            figures["bad, found"] = float(found[true].mean())
    return figures


def unevenness(pattern: Array) -> float:
    """90th percentile over median of the deviations of the blocks of a map's detail: about 1.3 for a sensor's pattern.

    A sensor's pixels deviate alike everywhere. Burnt-in edges of a scene do not.
    """
    detail = pattern - ndimage.uniform_filter(pattern, 5)
    detail = detail - np.median(detail, 0)
    detail = detail - np.median(detail, 1)[:, None]
    height, width = (side // BLOCK for side in detail.shape)
    blocks = detail[: height * BLOCK, : width * BLOCK].reshape(height, BLOCK, width, BLOCK)
    middle = np.median(blocks, (1, 3), keepdims=True)
    deviations = ROBUST_SIGMA * np.median(np.abs(blocks - middle), (1, 3))
    return float(np.quantile(deviations, 0.9) / max(np.median(deviations), 1e-12))


def taken_off(frames: Array, corrected: Array) -> Figures:
    """What a correction takes off a camera that is corrected already, over the scene's deviation."""
    pattern = np.mean([a.astype(float) - b for a, b in zip(frames, corrected, strict=True)], 0)
    scene = float(np.median([each.std() for each in frames]))
    low, fine = (float(part.std()) / scene for part in parts(pattern - pattern.mean()))
    return {"low": low, "fine": fine, "unevenness": unevenness(pattern) if pattern.std() > 0 else float("nan")}


def held_out(frames: Array, maps: tuple[Array | float, Array] | None) -> Figures:
    """Pattern that frames (N, h, w), which no estimate used, keep along their displacements, over the raw one.

    Fine pattern and slow one; and the nats by which the corrected frames are more likely than the raw ones.
    """
    if maps is None:
        return {}
    one = np.ones(frames.shape[1:])
    raw, found = (one, 0 * one), (one * maps[0], maps[1])
    pairs = [(k, k + len(frames) // 2) for k in range(len(frames) // 2)]
    scorer = CorrectionScorer(frames, np.ones(frames.shape, bool), pairs, [raw, found])
    before, after = scorer.score(*raw), scorer.score(*found)
    if before is None or after is None:
        return {}
    gained = before.nats - after.nats + float(np.nan_to_num(before.detail_nats - after.detail_nats))
    fine = after.detail / before.detail if before.detail > 0 else float("nan")
    return {"held-out fine": fine, "held-out slow": after.change / before.change, "held-out nats": gained}
