"""Whether the camera of a recording stands still.

What stands still in all frames of such a recording is the scene and the pattern in one: nothing separates them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import ndimage

from deepir.kernels.block_means import block_means
from deepir.multiview.low_order_pattern import coarsening
from deepir.multiview.pattern import median_pattern
from deepir.multiview.texture_flow import TEXTURE_SIGMA, displacements

Array = np.ndarray[Any, Any]

#: Pairs of frames, half the recording apart, that are compared.
PAIRS = 5
DETAIL = 5  # px, of the box average that is taken off for the fine part of what all frames share
#: Deviation of the coarser texture that all frames share, in that of its fine part, from which it may be a scene's:
#: white pixels have 0.2, a raw pattern that hides the scene 0.3 to 0.7, a camera at rest behind a shutter 2.
SCENE_RATIO = 1.0
#: Share of the frame that two frames of a camera at rest both show, at least, and upper quartile of its displacements,
#: px, at most.
SHARED, REST = 0.5, 1.0


def is_at_rest(frames: Array, usable: Array) -> bool:
    """Whether frames (N, h, w) show the same scene at the same place, whatever moves through it."""
    shared = median_pattern(frames, usable)
    coarse = ndimage.uniform_filter(shared, DETAIL)
    detail, texture = shared - coarse, coarse - ndimage.gaussian_filter(shared, TEXTURE_SIGMA)
    if np.median(np.abs(texture)) < SCENE_RATIO * np.median(np.abs(detail)):
        return False
    factor, half = coarsening(frames.shape[1:]), len(frames) // 2
    blocks = block_means(frames - detail, usable, factor)
    first = np.unique(np.linspace(0, len(frames) - half - 1, PAIRS).round().astype(int))
    shares, quartiles = [], []
    for found in displacements(blocks, [(k, k + half) for k in first]):
        moved = np.hypot(*found.vectors)[found.known]
        shares.append(found.known.mean())
        quartiles.append(np.quantile(moved, 0.75) * factor if moved.size else np.inf)
    return bool(np.median(shares) >= SHARED and np.median(quartiles) <= REST)
