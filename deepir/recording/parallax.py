"""Whether the scene shows parallax: whether a homography describes its displacements as well as a dense flow does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch

from deepir.kernels.block_means import block_means
from deepir.multiview.texture_flow import Displacement
from deepir.operators.warp import project_pixels
from deepir.recording.keyframes import spread
from deepir.recording.offset import agreement

Array = np.ndarray[Any, Any]

PAIRS = 16  # of frames that are looked at
MIN_MOTION = 0.5  # px of the averaged frames; median displacement of a pair that counts
POINTS = 1500  # of a displacement field to which the homography is fitted
MIN_POINTS = 60
REWEIGHTINGS = 8  # of the fit, by Cauchy's likelihood
RIDGE = 1e-9  # px^2 of the averaged frames, less than any displacement is missed by
BORDER = 1  # px from the border within which a homography's displacement does not count
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
    for dense in spread(found, PAIRS):
        plane = _homography(dense)
        if plane is None or (inside := dense.known & _inside(plane)).sum() < MIN_POINTS:
            continue
        numbers = [dense.first, dense.second]
        factor = min(frames.shape[1:]) // min(dense.y.shape)
        coarse = block_means((frames[numbers] - offset) / gain, usable[numbers], factor)
        pair = [replace(each, first=0, second=1) for each in (plane, dense)]
        logs.append(np.log(agreement(coarse, pair[0], inside) / agreement(coarse, pair[1], inside)))
        weights.append(float(inside.mean()))
    return float(np.exp(np.average(logs, weights=weights))) if logs else np.nan


def _homography(found: Displacement) -> Displacement | None:
    """The displacements (h, w) of the homography nearest to those known; None where these are few or small."""
    from kornia.geometry.homography import find_homography_dlt, oneway_transfer_error

    height, width = found.y.shape
    middle = np.array([(width - 1) / 2, (height - 1) / 2])
    y, x = np.nonzero(found.known)
    stride = max(1, len(y) // POINTS)
    at = (np.stack((x, y), 1) - middle)[::stride]
    to = (np.stack((found.x[y, x], found.y[y, x]), 1) - middle)[::stride]
    if len(at) < MIN_POINTS or np.median(np.hypot(*(to - at).T)) < MIN_MOTION:
        return None
    here, there = (torch.from_numpy(each)[None] for each in (at, to))
    weights = torch.ones(1, len(at), dtype=torch.float64)
    for _ in range(REWEIGHTINGS):
        plane = find_homography_dlt(here, there, weights)
        missed = oneway_transfer_error(here, there, plane)  # squared
        weights = 1 / (missed.median() + missed + RIDGE)
    to_x, to_y = (project_pixels(plane, (height, width))[0].numpy() + middle).T.swapaxes(1, 2)
    return replace(found, x=to_x, y=to_y)


def _inside(found: Displacement) -> Array:
    """Where a displacement (h, w) ends within the frame."""
    height, width = found.y.shape
    return np.asarray(
        (found.y > BORDER)
        & (found.y < height - 1 - BORDER)
        & (found.x > BORDER)
        & (found.x < width - 1 - BORDER)
    )
