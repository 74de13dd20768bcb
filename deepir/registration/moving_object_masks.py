"""Masks of objects that move by themselves, and inpainting of the samples that they cover."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from scipy.ndimage import binary_dilation, binary_opening, label, uniform_filter
from torch import Tensor

from deepir.arrays.statistics import MAD_TO_SIGMA
from deepir.registration.block_likelihood import LIKELIHOOD_SIDE
from deepir.registration.pyramid import Level, block_mean, sample


@dataclass(frozen=True)
class DetectionCriteria:
    """Which regions of the temporal change are moving objects: hysteresis thresholding, then morphology.

    Lengths are px of frames reduced to a longer side of at most `LIKELIHOOD_SIDE` px.
    """

    window: int = 3  # px; side of the window over which the change is averaged
    low_threshold: float = 8.0  # robust standard deviations; all samples of an object exceed it
    high_threshold: float = 16.0  # robust standard deviations; one sample of an object exceeds it
    min_thickness: int = 5  # px; thinner regions are edges of a scene that moves
    margin: int = 4  # px by which regions are dilated
    max_fraction: float = 1 / 3  # of a frame; where more changes, the frame shows another place


DETECTION = DetectionCriteria()
MIN_VISIBLE_WEIGHT = 0.99  # interpolated weight at which a sample shows the background only
INPAINTING_PASSES = 3  # alternations of scene and pattern


def moving_object_mask(preprocessed: Tensor) -> Tensor:
    """Find samples of moving objects: thick regions of large deviation from the temporal median.

    Args:
        preprocessed: `(N, H, W)`.

    Returns:
        `(N, H, W)` bool, True where an object covers the scene.
    """
    h, w = preprocessed.shape[1:]
    factor = max(1, -(-max(h, w) // LIKELIHOOD_SIDE))
    reduced = block_mean(preprocessed, factor)
    reduced = reduced - reduced.flatten(1).median(1).values[:, None, None]
    deviation = (reduced - reduced.median(0).values).numpy()
    change = np.abs(uniform_filter(deviation, (0, DETECTION.window, DETECTION.window)))
    sigma = MAD_TO_SIGMA * float(np.median(change))
    element = np.ones((1, DETECTION.min_thickness, DETECTION.min_thickness))
    candidates = binary_opening(change > DETECTION.low_threshold * sigma, element)
    neighbours = np.arange(27).reshape(3, 3, 3) // 9 == 1  # the eight of a sample, in its own frame
    regions, _ = label(candidates, neighbours)
    confirmed = np.unique(regions[candidates & (change > DETECTION.high_threshold * sigma)])
    mask = binary_dilation(np.isin(regions, confirmed), neighbours, iterations=DETECTION.margin)
    mask &= mask.mean((1, 2), keepdims=True) < DETECTION.max_fraction
    mask = mask.repeat(factor, 1).repeat(factor, 2)
    padding = (0, 0), (0, h - mask.shape[1]), (0, w - mask.shape[2])
    return torch.from_numpy(np.pad(mask, padding, mode="edge"))


def inpaint_mean(frames: Tensor, mask: Tensor, weight: Tensor) -> Tensor:
    """Replace masked samples by the temporal mean of the others, as if nothing moved.

    Args:
        frames: `(N, H, W)`; the median of each frame is kept.
        mask: `(N, H, W)` bool.
        weight: `(H, W)`, zero where a pixel is bad.
    """
    levels = frames.flatten(1).median(1).values[:, None, None]
    centred = frames - levels
    return torch.where(mask, _masked_mean(centred, weight * ~mask), centred).add_(levels)


def inpaint_background(frames: Tensor, mask: Tensor, weight: Tensor, motion: Tensor) -> Tensor:
    """Replace masked samples by scene and pattern of the other frames, which are estimated alternately.

    Where no other frame shows the scene, the temporal mean replaces them.

    Args:
        frames: `(N, H, W)`; the median of each frame is kept.
        mask: `(N, H, W)` bool.
        weight: `(H, W)`, zero where a pixel is bad.
        motion: `(N, 3, 3)`, centred px.
    """
    level = Level(1, frames, weight, bool(weight.all()), (weight.shape[0], weight.shape[1]))
    levels = frames.flatten(1).median(1).values[:, None, None]
    centred, visible, inverse = frames - levels, weight * ~mask, torch.linalg.inv(motion)
    mean = _masked_mean(centred, visible)
    interpolated, known = sample(visible, inverse, level)
    is_visible = known * (interpolated > MIN_VISIBLE_WEIGHT)
    n_visible = is_visible.sum(0).clamp_min(1)
    pattern = torch.zeros_like(mean)
    for _ in range(INPAINTING_PASSES):
        scene = (sample(centred - pattern, inverse, level)[0] * is_visible).sum(0) / n_visible
        scene = torch.where(is_visible.any(0), scene, mean - pattern)
        expected, known = sample(scene[None], motion, level)
        weights = visible * known
        pattern = ((centred - expected) * weights).sum(0) / weights.sum(0).clamp_min(1)
    return torch.where(mask, torch.where(known > 0, expected + pattern, mean), centred) + levels


def _masked_mean(values: Tensor, visible: Tensor) -> Tensor:
    """Mean `(H, W)` over the visible samples, one or zero `(N, H, W)`, of values `(N, H, W)`; of all if none is."""
    count = visible.sum(0)
    return torch.where(count > 0, (values * visible).sum(0) / count.clamp_min(1), values.mean(0))
