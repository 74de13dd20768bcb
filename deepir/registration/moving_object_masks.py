"""Somebody who walks through a burst: in which samples he stands, and frames in which he is filled in."""

from __future__ import annotations

import numpy as np
import torch
from scipy.ndimage import binary_dilation, binary_opening, label, uniform_filter
from torch import Tensor

from deepir.arrays.statistics import MAD_TO_SIGMA
from deepir.registration.block_vote import SIZE
from deepir.registration.pyramid import Level, average, sample

SMOOTH = 3  # px, of frames of 320 px at most: side of the windows whose mean change is looked at
#: Robust standard deviations of it: where somebody stands; and what he reaches somewhere.
STANDS, REACHES = 8.0, 16.0
THIN = 5  # px of these: what is thinner is an edge of the scene
RIM = 4  # px of these by which he is larger than he looks
MOST = 1 / 3  # share of a frame that he covers: where more differs, it is of another place
CLEAR = 0.99  # share of a sample between pixels that are of the scene, if it is
PASSES = 3  # over scene and pattern


def someone(flat: Tensor) -> Tensor:
    """The samples `(N, H, W)`, bool, of flat frames in which somebody stands, who is elsewhere in others.

    They differ from the median of all frames in regions that are nowhere thin, as the edges of a scene that moves are.
    """
    h, w = flat.shape[1:]
    factor = max(1, -(-max(h, w) // SIZE))
    seen = average(flat, factor)
    seen = seen - seen.flatten(1).median(1).values[:, None, None]
    change = np.abs(uniform_filter((seen - seen.median(0).values).numpy(), (0, SMOOTH, SMOOTH)))
    usual = MAD_TO_SIGMA * float(np.median(change))
    wide = binary_opening(change > STANDS * usual, np.ones((1, THIN, THIN)))
    in_frame = np.arange(27).reshape(3, 3, 3) // 9 == 1  # neighbours of a sample
    regions, _ = label(wide, in_frame)
    held = np.unique(regions[wide & (change > REACHES * usual)])
    stands = binary_dilation(np.isin(regions, held), in_frame, iterations=RIM)
    stands &= stands.mean((1, 2), keepdims=True) < MOST
    stands = stands.repeat(factor, 1).repeat(factor, 2)
    rest = (0, 0), (0, h - stands.shape[1]), (0, w - stands.shape[2])
    return torch.from_numpy(np.pad(stands, rest, mode="edge"))


def blanked(frames: Tensor, stands: Tensor, weight: Tensor) -> Tensor:
    """Frames `(N, H, W)` with the mean of the others in the place of samples `(N, H, W)`: as if nothing moved.

    weight: `(H, W)`, zero where a pixel is bad.
    """
    levels = frames.flatten(1).median(1).values[:, None, None]
    seen = frames - levels
    return torch.where(stands, _mean(seen, weight * ~stands), seen).add_(levels)


def filled(frames: Tensor, stands: Tensor, weight: Tensor, motion: Tensor) -> Tensor:
    """The same with what the others show of scene and pattern, at motions `(N, 3, 3)`."""
    level = Level(1, frames, weight, bool(weight.all()), (weight.shape[0], weight.shape[1]))
    levels = frames.flatten(1).median(1).values[:, None, None]
    seen, free, back = frames - levels, weight * ~stands, torch.linalg.inv(motion)
    mean = _mean(seen, free)
    clear, known = sample(free, back, level)
    clear = known * (clear > CLEAR)
    pattern = torch.zeros_like(mean)
    for _ in range(PASSES):
        scene = (sample(seen - pattern, back, level)[0] * clear).sum(0) / clear.sum(0).clamp_min(1)
        scene = torch.where(clear.any(0), scene, mean - pattern)
        expected, known = sample(scene[None], motion, level)
        counts = free * known
        pattern = ((seen - expected) * counts).sum(0) / counts.sum(0).clamp_min(1)
    return torch.where(stands, torch.where(known > 0, expected + pattern, mean), seen) + levels


def _mean(seen: Tensor, free: Tensor) -> Tensor:
    """That of the samples `(N, H, W)` which are free, `(H, W)`; of all where none is."""
    count = free.sum(0)
    return torch.where(count > 0, (seen * free).sum(0) / count.clamp_min(1), seen.mean(0))
