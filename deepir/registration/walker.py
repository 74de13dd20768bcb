"""Somebody hot who walks before a plain scene: he is what registers, unless the places where he passes are left out."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from scipy.ndimage import binary_dilation, gaussian_filter
from torch import Tensor

from deepir.registration.align import standing
from deepir.registration.likelihood import likeliest_shifts
from deepir.registration.motion import identity
from deepir.registration.pyramid import Level, average, build_level
from deepir.registration.vote import SIZE, reduced
from deepir.registration.whole import whole_shifts

MUCH = (30.0, 10.0)  # times the median of what changes: where somebody passes; and where he may
AROUND = 3.0  # px, of frames of 320 px at most: over so many that is taken
RIM = 3  # px of these by which such places are larger than they look
LEAST = 0.05  # share of the frame that changes so much, if he is worth a second look
#: Of what no motion leaves unexplained beside him: more is hardly explained, less is well explained; plain skies alone
#: come to 0.37.
HARDLY, WELL = 0.4, 0.15
LIKELY, CLEARLY = 1.2, 1.5  # times more unexplained than by another motion: before that is refined, and after

#: Motions of least residuals, of frames that are zero where their weights are, from others.
Refine = Callable[[Tensor, Tensor, Tensor], Tensor]


def beside_walker(
    frames: Tensor, flat: Tensor, weight: Tensor, level: Level, motion: Tensor, refine: Refine
) -> tuple[Tensor, Tensor]:
    """Motions `(N, 3, 3)` of what is not in the places where somebody passes, and weights that are zero there.

    They are those that are given, if these explain the rest as well. frames, flat: `(N, H, W)`, as they are and flat.
    weight: `(H, W)`.
    """
    known = torch.where(weight > 0, frames.float(), 0.0)
    factor = max(1, -(-max(weight.shape) // SIZE))
    change = changes(average(known, factor) / average(weight[None], factor).clamp_min(1e-6))
    passed = (change > MUCH[0]).mean()
    if len(frames) < 3 or not passed > LEAST:
        return motion, weight

    def left(places: Tensor, at: Tensor) -> float:
        return standing(build_level(flat * places, places, level.factor), at)[1]

    surely, likely = (weight * ~passes(change, much, factor, level.shape) for much in MUCH)
    unexplained, at_rest = left(surely, motion), left(surely, identity(len(frames)))
    if not unexplained > WELL * at_rest:
        return motion, weight
    start, had = likeliest(frames, surely), left(likely, motion)
    if unexplained <= HARDLY * at_rest and had < LIKELY * left(likely, start):
        return motion, weight
    starts = (surely, start), (likely, likeliest(frames, likely))
    found = [refine(flat * places, places, at) for places, at in starts]
    best = min(found, key=lambda each: left(likely, each))
    return (best, likely) if had > CLEARLY * left(likely, best) else (motion, weight)


def changes(frames: Tensor) -> np.ndarray:
    """What changes from frame to frame `(N, h, w)` around each pixel, squared, over the median of it."""
    apart = frames - frames.mean(0)
    apart -= apart.flatten(1).median(1).values[:, None, None]
    change = gaussian_filter(apart.square().mean(0).numpy(), AROUND, mode="nearest")
    return np.asarray(change / max(float(np.median(change)), 1e-30))


def passes(change: np.ndarray, much: float, factor: int, size: tuple[int, int]) -> Tensor:
    """The pixels `(H, W)` of the frames where so much changes, and those next to them."""
    places = binary_dilation(change > much, iterations=RIM)
    h, w = size
    whole = places.repeat(factor, 0).repeat(factor, 1)
    return torch.from_numpy(np.pad(whole, ((0, h - len(whole)), (0, w - whole.shape[1])), mode="edge"))


def likeliest(frames: Tensor, weight: Tensor) -> Tensor:
    """The likeliest shifts of frames, as motions; what has no weight is left out."""
    seen, factor = reduced(frames, weight)
    motion = identity(len(frames))
    motion[1:, :2, 2] = factor * torch.from_numpy(likeliest_shifts(seen, whole_shifts(seen)))
    return motion
