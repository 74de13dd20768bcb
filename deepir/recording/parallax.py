"""Whether the scene shows parallax: whether a homography describes its displacements as well as a dense flow does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from deepir.kernels.block_means import block_means
from deepir.multiview.texture_flow import Displacement
from deepir.recording.offset import agreement

Array = np.ndarray[Any, Any]

PAIRS = 16  # of frames that are looked at
LEAST_MOTION = 0.5  # px of the averaged frames; median displacement of a pair that counts
POINTS = 1500  # of a displacement field to which the homography is fitted
LEAST_POINTS = 60
REWEIGHTINGS = 8  # of the fit, by Cauchy's likelihood
BORDER = 1  # px from the border within which a homography's displacement does not count
RIDGE = 1e-9
#: Ratio from which there is parallax. Of 72 simulated recordings 66 are on the right side: drives and walks at 1.0 to
#: 1.5, pans and flights high above the ground at 0.9 to 1.05; two real drives have 1.14 and 1.4.
PARALLAX_RATIO = 1.05


def parallax_ratio(
    frames: Array, usable: Array, gain: Array, offset: Array, found: Sequence[Displacement]
) -> float:
    """Change of brightness along the best homographies, relative to that along the displacements themselves.

    Args:
        frames: (N, h, w), raw.
        usable: (N, h, w) bool, which samples count.
        gain, offset: (h, w), of the sensor.
        found: displacements between the frames averaged over blocks.

    Returns:
        The geometric mean over pairs of frames, weighted by the share of each that is known; NaN where nothing moves.
    """
    gain, offset = gain.astype(np.float32), offset.astype(np.float32)
    logs, weights = [], []
    for k in np.unique(np.linspace(0, len(found) - 1, min(PAIRS, len(found))).astype(int)):
        dense = found[k]
        plane = _homography(dense)
        if plane is None:
            continue
        numbers = [dense.first, dense.second]
        factor = min(frames.shape[1:]) // min(dense.y.shape)
        coarse = block_means((frames[numbers] - offset) / gain, usable[numbers], factor)
        inside = dense.known & _inside(plane)
        pair = [replace(each, first=0, second=1) for each in (plane, dense)]
        logs.append(np.log(agreement(coarse, pair[0], inside) / agreement(coarse, pair[1], inside)))
        weights.append(float(inside.mean()))
    return float(np.exp(np.average(logs, weights=weights))) if logs else np.nan


def _homography(found: Displacement) -> Displacement | None:
    """The displacements (h, w) of the homography nearest to those known; None where these are few or small."""
    y, x = np.nonzero(found.known)
    stride = max(1, len(y) // POINTS)
    y, x = y[::stride], x[::stride]
    if len(y) < LEAST_POINTS:
        return None
    to_y, to_x = found.y[y, x], found.x[y, x]
    if np.median(np.hypot(to_y - y, to_x - x)) < LEAST_MOTION:
        return None
    height, width = found.y.shape
    middle_y, middle_x, scale = height / 2, width / 2, height / 2
    u, v = (x - middle_x) / scale, (y - middle_y) / scale
    to_u, to_v = (to_x - middle_x) / scale, (to_y - middle_y) / scale
    h = _fitted(u, v, to_u, to_v)
    u, v = (np.arange(width) - middle_x) / scale, (np.arange(height)[:, None] - middle_y) / scale
    to_u, to_v = _mapped(h, u, v)
    return replace(found, x=scale * to_u + middle_x, y=scale * to_v + middle_y)


def _fitted(u: Array, v: Array, to_u: Array, to_v: Array) -> Array:
    """The eight parameters of a homography, by robust least squares of its linear equations (P,)."""
    none, one = np.zeros_like(u), np.ones_like(u)
    design = np.concatenate(
        [
            np.stack([u, v, one, none, none, none, -u * to_u, -v * to_u], 1),
            np.stack([none, none, none, u, v, one, -u * to_v, -v * to_v], 1),
        ]
    )
    target, weights = np.concatenate([to_u, to_v]), one
    for _ in range(REWEIGHTINGS):
        weighted = design * np.tile(weights, 2)[:, None]
        h = np.linalg.solve(weighted.T @ design + RIDGE * np.eye(8), weighted.T @ target)
        at_u, at_v = _mapped(h, u, v)
        miss = np.hypot(at_u - to_u, at_v - to_v)
        weights = 1 / (np.median(miss) ** 2 + miss**2 + RIDGE)
    return np.asarray(h)


def _mapped(h: Array, u: Array, v: Array) -> tuple[Array, Array]:
    below = h[6] * u + h[7] * v + 1
    return (h[0] * u + h[1] * v + h[2]) / below, (h[3] * u + h[4] * v + h[5]) / below


def _inside(found: Displacement) -> Array:
    """Where a displacement (h, w) ends within the frame."""
    height, width = found.y.shape
    return np.asarray(
        (found.y > BORDER)
        & (found.y < height - 1 - BORDER)
        & (found.x > BORDER)
        & (found.x < width - 1 - BORDER)
    )
