"""How noisy are the samples? Estimates that need no model of the scene, for a start."""

from __future__ import annotations

import torch
from torch import Tensor

from deepir.arrays.median import MAD, median
from deepir.arrays.subsample import ENOUGH, masked_values, subsample

WINDOW = 15  # px: side of the windows in which noise is looked for
FLATTEST = 0.885  # a tenth of such medians of nothing but noise are less, in its own
FEW = 5000  # samples of each frame are enough for the step of their values
ROUNDED = 12**-0.5  # standard deviation that rounding makes, in steps


def sample_noise(frames: Tensor, usable: Tensor) -> float:
    """Standard deviation of a sample's noise from frames (N, h, w); usable (N, h, w) bool.

    From differences of consecutive frames, in which a fixed pattern cancels, or from the one frame there is. The
    median of diagonal second differences leaves smooth parts and edges of the scene out; fine texture stays in, so
    that this is an upper bound.
    """
    if len(frames) > 1:
        frames, usable = (frames[1:] - frames[:-1]) / 2**0.5, usable[1:] & usable[:-1]
    some, counts = subsample(*(each[:, None] for each in mixed_difference(frames, usable)))
    found = masked_values(some, counts).abs()
    return MAD * median(found) if found.numel() else 0.0


def noise_in_flat_windows(frames: Tensor, usable: Tensor) -> float:
    """Standard deviation of a sample's noise, from the flattest parts of frames (N, h, w); usable, bool.

    For frames of different scenes that have no pattern left. Diagonal second differences have a median in each window:
    the tenth of the windows with the least is next to flat.
    """
    found = []
    for k in range(len(frames)):
        fine, whole = mixed_difference(frames[k : k + 1], usable[k : k + 1])
        fine = fine.abs().where(whole, torch.nan)[0]
        windows = fine.unfold(0, WINDOW, WINDOW).unfold(1, WINDOW, WINDOW).flatten(2)
        found.append(windows.nanmedian(2).values.flatten())
    each = torch.cat(found)
    each = each[each.isfinite()]
    return float(MAD * each.quantile(0.1) / FLATTEST) if len(each) else 0.0


def mixed_difference(frames: Tensor, usable: Tensor) -> tuple[Tensor, Tensor]:
    """Diagonal second differences, of the noise's variance, and which of them are whole, (N, h - 1, w - 1)."""
    fine = (frames[:, 1:, 1:] - frames[:, 1:, :-1] - frames[:, :-1, 1:] + frames[:, :-1, :-1]) / 2
    whole = usable[:, 1:, 1:] & usable[:, 1:, :-1] & usable[:, :-1, 1:] & usable[:, :-1, :-1]
    return fine, whole


def quantisation_step(frames: Tensor, usable: Tensor) -> float:
    """What most neighbouring values of samples (N, 1, h, w) are apart; usable, bool. The step of rounded ones."""
    some, counts = subsample(frames, usable, enough=FEW)
    apart = some[counts].unique().diff()
    return float(apart.quantile(0.25)) if len(apart) else 0.0


def median_sigma(precision: Tensor) -> float:
    """Median standard deviation of the samples (N, C, h, w) that count; NaN if none does."""
    (some,) = subsample(precision, enough=ENOUGH // len(precision))
    return median(masked_values(some, some > 0)) ** -0.5
