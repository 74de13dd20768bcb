"""Pixels that are no sensors, and samples that show something else than the scene.

A pixel is judged by what it does beside the model, never by its value: pixels of a saturated sky, or exact zeros, are
as good as any.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.ndimage
import torch
import torch.nn.functional as F
from scipy.special import chdtri
from torch import Tensor

from deepir.arrays.samples import ISOLATION, MAD_TO_SIGMA
from deepir.arrays.statistics import subsample
from deepir.arrays.windows import DEFAULT_WINDOW, box_sum, median_filter
from deepir.effects.effect import Effect, InitialEstimate
from deepir.estimation.residuals import temporal_mean
from deepir.messages import Message
from deepir.registry import register

DEAD_DEVIATION = 4.0  # the same of a static pixel
DEFECT_MISFIT = 12.0  # mean squared residual over the frames, in units of the noise
MAX_MISFIT = 100.0  # squared residual at which that of one sample is clipped: one frame makes no defect
MIN_REGION = 0.01  # share of the pixels: fewer are no region
STATIC_PROBABILITY = 1e-3  # at which noise alone varies as little, or as much, over the frames
CROWD_SHARE = 0.5  # of a pixel's surroundings that stand still before a scene that moves, where it is no chance
EXPECTED_CHANGE = 9.0  # variance over the frames, in units of the noise, of the scene that an overlay hides
RIM_SHARE = 0.5  # of the rim of a static region that is overlay, for all of it to be
LINE_SAMPLES = 128  # pixels of a line for its median
CROWD_MISFIT = 2.0  # mean squared residual of a neighbourhood, from which its samples are doubted


@torch.no_grad()
def static_pixels(frames: Tensor, usable: Tensor, noise: float, probability: float = 1 - STATIC_PROBABILITY) -> Tensor:
    """Pixels (1, 1, h, w), bool, that do not even show noise, of standard deviation `noise`; of (N, 1, h, w).

    probability: At which noise alone varies more: that which is small finds all pixels that show no more than noise.
    """
    change, count = changes(frames, usable)
    # What noise alone makes of so many samples is a chi-squared number.
    bound = torch.from_numpy(chdtri(np.arange(len(frames) + 1).clip(2) - 1, probability) * noise**2)
    return (count > 1) & (change < bound.to(change)[count])


@torch.no_grad()
def dead_pixels(calm: Tensor, pattern: Tensor, known: Tensor) -> Tensor:
    """Pixels (1, 1, h, w), bool, of those that are `calm`, whose pattern is far from that of the others known.

    Whole lines and blocks too, which `pattern_outliers` takes for columns or for scene. Pixels of a saturated or zero
    scene have no pattern.
    """
    live = known & ~calm
    far = torch.zeros_like(calm)
    for axis in (-2, -1):  # a dead column differs from all others in its rows
        apart = (pattern - line_median(pattern, live, axis)).abs()
        some, counts = subsample(apart, live)
        far |= apart > DEAD_DEVIATION * MAD_TO_SIGMA * some[counts].median()
    return calm & far


@torch.no_grad()
def still_region(still: Tensor, expected: Tensor, usable: Tensor, noise: float) -> Tensor:
    """Pixels (1, 1, h, w), bool, of those that are `still` in the frames, in regions where the scene should move.

    A bonnet, a mount or a barrel in view, or pixels that do not respond; expected, usable (N, 1, h, w).
    """
    change, count = changes(expected, usable)
    found = still & (change > EXPECTED_CHANGE * noise**2 * (count - 1).clamp(min=1))
    crowd = box_sum(found.to(change)) > CROWD_SHARE * box_sum(torch.ones_like(change))
    return still & crowd & ((still & crowd).float().mean() >= MIN_REGION)


def region_message(bad: Tensor) -> list[str]:
    """A warning on regions of pixels (1, 1, h, w), bool, that a solve gave up, where the largest is; or []."""
    region = bad & (box_sum(bad.float()) > CROWD_SHARE * DEFAULT_WINDOW**2)
    if (share := float(region.float().mean())) < MIN_REGION:
        return []
    names, _ = scipy.ndimage.label(region[0, 0].numpy(force=True))
    y, x = (np.unique(each) for each in np.nonzero(names == np.bincount(names[names > 0]).argmax()))
    return [
        Message(
            "still-region",
            f"{share:.1%} of the pixels, between rows {y[0]} and {y[-1]}, columns {x[0]} and {x[-1]}, "
            "do not follow the scene: something stands still before it, or they do not respond. They are left out. "
            "data.mask, or data.crop, says so beforehand",
        )
    ]


@torch.no_grad()
def overlay_mask(calm: Tensor, expected: Tensor, usable: Tensor, noise: float) -> Tensor:
    """Pixels (1, 1, h, w), bool, of those that are `calm`, at which the scene that is expected changes all the same.

    Bars, boxes and letters that a camera draws over its pictures. The inside of a box expects itself, as a plain sky
    does: of what hangs together all is drawn if most of its rim is. expected, usable (N, 1, h, w).
    """
    change, count = changes(expected, usable)
    drawn = calm & (change > EXPECTED_CHANGE * noise**2 * (count - 1))
    if not drawn.any():
        return drawn
    whole = calm[0, 0].numpy(force=True)
    names, _ = scipy.ndimage.label(whole, np.ones((3, 3)))
    rim = whole & ~scipy.ndimage.binary_erosion(whole, border_value=1)
    at_rim = rim & drawn[0, 0].numpy(force=True), rim
    found, all_of_it = (np.bincount(names[each], minlength=names.max() + 1) for each in at_rim)
    return drawn | torch.from_numpy((found > RIM_SHARE * all_of_it)[names]).to(drawn)


def changes(frames: Tensor, usable: Tensor) -> tuple[Tensor, Tensor]:
    """The sum of each pixel's squared deviations from its mean over the frames, (1, 1, h, w); how many are usable."""
    count, mean, change = (torch.zeros_like(frames[:1]) for _ in range(3))
    for frame, known in zip(frames, usable, strict=True):  # one at a time stays in the cache
        count += known
        mean += frame * known
    mean /= count.clamp(min=1)
    for frame, known in zip(frames, usable, strict=True):
        change += (frame - mean).square_().mul_(known)
    return change, count.long()


def line_median(image: Tensor, known: Tensor, axis: int) -> Tensor:
    """The median of each line of an image (1, 1, h, w) along an axis, of what is known of it; zero if nothing is."""
    lines, mask = (each.transpose(axis, -1) for each in (image, known))
    step = max(1, lines.shape[-1] // LINE_SAMPLES)
    some = lines[..., ::step].where(mask[..., ::step], torch.nan)
    return some.nanmedian(-1, keepdim=True).values.nan_to_num().transpose(axis, -1)


@torch.no_grad()
def misfitting_pixels(misfit: Tensor, usable: Tensor) -> Tensor:
    """Pixels (1, 1, h, w), bool, whose mean misfit over the frames is large, also relative to their neighbours.

    misfit: Squared residuals, noise variances, (N, 1, h, w). usable: Samples that count, same shape.
    """
    count = usable.sum(0, keepdim=True)
    mean = misfit.clamp(max=MAX_MISFIT).sum(0, keepdim=True) / count.clamp(min=1)
    return (count > 0) & (mean > DEFECT_MISFIT) & (mean > ISOLATION * median_filter(mean))


@torch.no_grad()
def with_scene_error(misfit: Tensor, expected: Tensor, usable: Tensor, variance: Tensor | float) -> Tensor:
    """Misfits in units of the noise and of the errors of the expected scene, (N, 1, h, w).

    A displacement that is a little wrong misfits in proportion to the contrast of the scene. So the variance of these
    errors is in proportion to the square of the contrast, by a factor that all samples share.

    misfit: Squared residuals, noise variances, (N, 1, h, w). expected: What the scene lets expect, same shape.
    usable: Samples that count, same shape. variance: Of the noise, same shape or a number.
    """
    contrast = F.max_pool2d(expected, 3, 1, 1).add_(F.max_pool2d(-expected, 3, 1, 1)).div_(2)  # half the range
    error = contrast.square_().div_(variance)
    excess = (misfit.clamp(max=MAX_MISFIT) - 1).mul_(usable).sum().clamp_(min=0)
    return misfit / error.mul_(excess / (error * usable).sum().clamp_(min=1e-30)).add_(1)


@torch.no_grad()
def neighbourhood_doubt(misfit: Tensor, usable: Tensor) -> Tensor:
    """How much samples are to be doubted for their neighbourhood's sake, (N, 1, h, w): zero for a clean one.

    What moves by itself misfits over many pixels, a little each.
    """
    total, share = box_sum(misfit.clamp(max=MAX_MISFIT)), box_sum(usable.to(misfit))
    return total.div_(share.clamp_(min=0.1 * DEFAULT_WINDOW**2)).sub_(CROWD_MISFIT).clamp_(min=0)


@register("effect", "bad_pixels")
@dataclass(frozen=True)
class BadPixels(Effect):
    """Dead pixels, and overlays that a camera draws over its frames."""

    @torch.no_grad()
    def reject(self, estimate: InitialEstimate) -> None:
        """Give up pixels that are dead, or drawn over; from the edge of a block inwards, for its inside shows itself.

        Those that do not change in the frames as they are, and others once levels and contrasts are evened out.
        """
        problem, rest, noise = estimate.problem, estimate.residual, estimate.noise
        usable = problem.precision > 0
        calm = estimate.static | static_pixels(problem.data, usable, noise)
        gone = dead_pixels(calm, temporal_mean(rest, problem.precision.sign()), usable.any(0, keepdim=True))
        still = estimate.still
        if problem.saturation is not None:  # a scene beyond the range is as calm
            inside = (problem.saturation == 0).all(0, keepdim=True)
            calm, still = calm & inside, still & inside
        gone |= overlay_mask(calm, problem.data - rest, usable, noise)
        if problem.motion_unknown() and estimate.step > 1:  # before, what is expected has the pattern, which moves
            gone |= still_region(still, problem.data - rest, usable, noise)
        problem.precision.mul_(~gone)
