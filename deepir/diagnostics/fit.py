"""What frames alone show, and whether what was found fits them: residuals are noise, motion and pattern are theirs.

A correction by another motion or pattern than the frames' may be worse than none.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from scipy import ndimage
from torch import Tensor

from deepir.arrays.samples import MAD_TO_SIGMA, Array, autocorrelation
from deepir.arrays.statistics import median, mixed_difference, subsample
from deepir.diagnostics.misfit import CAUSES, MIN_MISFIT, misfit
from deepir.messages import Message
from deepir.operators import Sensor, Warp
from deepir.operators.motion_models import identity
from deepir.optim.low_order_model import polynomials
from deepir.problem import Problem
from deepir.registration.motion_search import search_level
from deepir.registration.preprocess import preprocess
from deepir.registration.robust_score import log_likelihood_ratio

MIN_MOTION_NATS = 0.3  # nats by which the motion makes each sample likelier than rest; 0.1 at most where it was wrong
#: The same before a scene that repeats itself: if all frames register, and if fewer than a share do, since frames of
#: another phase of the period are then left out, and the others rest.
MIN_NATS_PERIODIC, MIN_NATS_PERIODIC_FEW, MIN_REGISTERED = 0.5, 1.2, 0.7
MAX_PAIRS = 4  # pairs of frames whose differences show a period, at most
#: Share of the autocorrelation one px from zero, where noise is no more, that it reaches at a period.
MIN_REPETITION = 0.8
MAX_BETWEEN = 0.5  # the same share, below which it falls on the way to the period; smooth scenes, as clouds, stay above
PEAK_REACH = 1.5  # distance of the peak of a repetition over that of its nearest sample, at most
#: Distance at which pixels of the pattern are compared, px: noise in the motion and interpolation reach one.
PATTERN_DISTANCE = 2
PATTERN_CLIP_SIGMAS = 4.0  # robust standard deviations of the pattern at which its values are cut off
#: Correlation of pixels so far apart from which a pattern is a picture; those that were found right have 0.08 at most.
MIN_PATTERN_CORRELATION = 0.1
#: Least pattern, relative to the scene: less may be of a sensor that was corrected with a scene in view.
MIN_PATTERN_CONTRAST = 0.2
#: Largest distance of the cumulative histogram from a uniform one; 0.13 and more in frames that are not equalised.
MAX_DISTANCE_FROM_UNIFORM = 0.01
MAX_SAMPLES = 40_000  # samples of all frames that suffice to find a shutter event
MIN_SAMPLES_PER_FRAME = 200  # fewest samples of a frame
BULK_FRACTION = 0.75  # fraction of the smallest differences that count: the others are edges of the scene
#: Distance between two groups of frames relative to that within them from which their patterns differ.
MIN_SEPARATION = 1.3


@torch.no_grad()
def misfit_message(problem: Problem, said: Sequence[str] = ()) -> list[str]:
    """Warning that names the cause that explains most of the residuals; [] where none does, or messages `said` so."""
    if not isinstance(problem.operator.named()[-1][1], Sensor) or not problem.motion_unknown():
        return []
    message, nats, frames = _misfit(problem)
    if nats < MIN_MISFIT or message.name in (getattr(each, "name", "") for each in said):
        return []
    few = f" (frames {', '.join(map(str, frames))})" if 2 * len(frames) <= len(problem.data) else ""
    return [Message(message.name, f"{message}{few}")]


@torch.no_grad()
def misses_bending(problem: Problem) -> bool:
    """Whether what rigid motion of the frames misses is that of a homography."""
    message, nats, _ = _misfit(problem, [each for each in CAUSES if each.name != "parallax"])  # which is any motion
    return message.name == "frames-bend" and nats > MIN_MISFIT


def _misfit(problem: Problem, among: Sequence[Message] = CAUSES) -> tuple[Message, float, list[int]]:
    """`misfit` of a problem that ends in a sensor."""
    values = problem.values()
    residual = problem.data - problem.predict(values)
    # What moves by itself was given up, but may be a part of a torn frame.
    whole = problem.precision.amax(0, keepdim=True).where(problem.moving, problem.precision)
    gain = values[problem.slots[f"{problem.operator.named()[-1][0]}.gain"]]
    images = (residual, problem.precision, whole, problem.flux(values), gain)
    left, precision, whole_precision, flux, gains = (each[:, 0].numpy(force=True) for each in images)
    return misfit(left, precision, whole_precision, flux, gains, among)


@torch.no_grad()
def motion_nats(problem: Problem) -> float:
    """Nats by which the motion of whole frames makes each sample likelier than rest; infinite for other motions."""
    motion = problem.field_of(problem.slot(Warp, "motion"))().double().cpu()
    if motion.shape != (len(problem.data), 3, 3):
        return float("inf")
    flat, weight = preprocess(problem.data[:, 0].cpu(), ~problem.alive().cpu())
    return log_likelihood_ratio(search_level(flat, weight), identity(len(motion)), motion)


@torch.no_grad()
def doubtful_motion(problem: Problem, frames: Array, usable: Array, used: Array) -> list[str]:
    """Say why the motion is not to be trusted; [] where it is.

    Args:
        problem: Solved.
        frames: All of the burst, (N, h, w).
        usable: Samples that count, same shape, bool.
        used: Frames that registered, (N,) bool.
    """
    if not isinstance(problem.operator.named()[-1][1], Sensor) or not problem.slot(Warp, "motion"):
        return []
    period = scene_period(frames, usable)
    if period is not None:
        least = MIN_NATS_PERIODIC if used.mean() >= MIN_REGISTERED else MIN_NATS_PERIODIC_FEW
        if motion_nats(problem) < least:
            return [
                Message(
                    "scene-repeats",
                    f"the scene repeats itself, by about {period:.0f} px, so that frames match at many displacements, "
                    "and the motion that was found explains them little better than rest",
                )
            ]
    values = problem.values()
    left = problem.data - problem.predict(values)
    gain, offset = (values[name] for name in problem.gain_and_offset())
    pattern = gain * problem.flux(values).median() + offset
    counts = problem.precision > 0
    shown = pattern.expand_as(left[:1])[counts.any(0, keepdim=True)]
    fits = len(left) < 3 or left[counts].std() < shown.std()  # the cheapest first
    if fits or _misfit(problem)[1] < MIN_MISFIT or motion_nats(problem) > MIN_MOTION_NATS:
        return []
    return [
        Message(
            "motion-not-trusted",
            "the frames do not show one scene that moves: the motion that was found explains them no better than rest, "
            "and leaves more than the pattern",
        )
    ]


def scene_period(frames: Array, usable: Array) -> float | None:
    """Smallest displacement at which the scene repeats itself, px; None if it does not, or by more than is seen.

    Args:
        frames: (N, h, w).
        usable: Samples that count, same shape, bool.
    """
    total, good = np.zeros((0, 0)), np.asarray(usable.all(0))
    for k in range(0, len(frames) - 1, max(1, -(-(len(frames) - 1) // MAX_PAIRS))):
        change = np.where(good, frames[k + 1].astype(float) - frames[k], 0.0)
        change[good] -= np.median(change[good]) if good.any() else 0.0
        if change.any():
            found = autocorrelation(change, change, good)
            total = total + found if total.size else found
    if not total.size:
        return None
    middle = len(total) // 2
    near = total[middle - 1 : middle + 2, middle - 1 : middle + 2]
    highest = max(near[0, 1], near[1, 0], near[0, 0], near[0, 2], 0.0)
    parts, _ = ndimage.label(total > MAX_BETWEEN * highest, np.ones((3, 3)))
    apart = np.hypot(*(np.indices(total.shape) - middle))
    other = (total > MIN_REPETITION * highest) & (parts != parts[middle, middle])
    if not other.any():
        return None
    nearest = other & (apart < PEAK_REACH * apart[other].min())  # of a ridge, the part that is nearest
    return float(apart[nearest][total[nearest].argmax()])


@torch.no_grad()
def scene_in_pattern_message(problem: Problem) -> list[str]:
    """Say so if the pattern that was found is a picture: then the motion was wrong, and the scene is in the pattern.

    A sensor has columns, rows, pixels and something smooth, and what one pixel has says nothing of the one next but
    one. Where the camera stands still while something moves, or moves by less than a pixel under a strong pattern, the
    motion that is found may be of something else: what stands still is then the scene, and what is left may be its
    negative. Dust on a window, a bonnet, the corners that a lens leaves dark look like pictures, too, but there the
    motion explains the frames far better than rest does.
    """
    if not problem.closed_form() or not problem.slot(Warp, "motion"):
        return []
    values, flux = problem.optimum()
    gain, offset = (values[name] for name in problem.gain_and_offset())
    shown = (gain * flux.median() + offset).expand_as(flux[:1])
    pattern, scene = (_rough(each[0, 0], problem.alive()) for each in (shown, flux))
    if (
        pattern.std() < MIN_PATTERN_CONTRAST * scene.std()
        or _neighbour_correlation(pattern, problem.alive()) < MIN_PATTERN_CORRELATION
        or motion_nats(problem) > MIN_MOTION_NATS
    ):
        return []
    return [
        Message(
            "scene-in-pattern",
            "the fixed pattern that was found looks like a picture, as where the camera stands still and something "
            "else moves, or where the motion is not found: do not trust the scene. Move the camera between frames, by "
            "3 to 10 px in x and in y",
        )
    ]


def _rough(image: Tensor, good: Tensor) -> Tensor:
    """An image (h, w) less its lines and all that is smooth, outliers cut off; zero where it is not good."""
    image = image.double()
    image = image - image.median(1, keepdim=True).values
    image = image - image.median(0, keepdim=True).values
    image = image - polynomials(*image.shape, image.device).project(image)
    limit = PATTERN_CLIP_SIGMAS * MAD_TO_SIGMA * median(image.abs())
    return image.clamp(-limit, limit) * good


def _neighbour_correlation(image: Tensor, good: Tensor) -> float:
    """Correlation of pixels that are `PATTERN_DISTANCE` px apart, along rows and columns."""
    found = autocorrelation(*(each.cpu().numpy() for each in (image, image, good)))
    middle = len(found) // 2
    return float(found[middle, middle + PATTERN_DISTANCE] + found[middle + PATTERN_DISTANCE, middle]) / 2


def is_equalised(frames: Array) -> bool:
    """Whether the histogram of every frame is uniform; frames (N, h, w), NaN where unknown."""
    for frame in frames:
        values, counts = np.unique(frame[np.isfinite(frame)], return_counts=True)
        if len(values) < 3:
            return False
        below = counts[1:].cumsum() / counts[1:].sum()
        if np.abs(below - (values[1:] - values[0]) / (values[-1] - values[0])).max() > MAX_DISTANCE_FROM_UNIFORM:
            return False
    return True


def equalised_message(frames: Array) -> list[str]:
    """Warning for equalised frames (N, h, w), NaN where unknown; [] otherwise."""
    if not is_equalised(frames):
        return []
    return [
        Message(
            "equalised-frames",
            "each frame's histogram is equalised: its values are ranks, not flux, so that neither gain and offset nor "
            "the scene's contrasts mean much. Record the raw (radiometric) stream of 14 or 16 bits, or a linear gain",
        )
    ]


@torch.no_grad()
def longest_shutter_segment(frames: Tensor, usable: Tensor) -> slice:
    """Longest run of frames with one fixed pattern.

    Mixed differences of frames are mostly pattern and noise. Across a shutter event they differ by more than within
    either part; a camera in motion does not separate frames into such parts.

    Args:
        frames: (N, h, w).
        usable: Samples that count, same shape, bool.

    Returns:
        The frames of the longer part; all of them without an event.
    """
    n, whole = len(frames), slice(0, len(frames))
    if n < 4:
        return whole
    fine, counts = mixed_difference(frames, usable.all(0).expand_as(usable))
    some, known = subsample(fine[:, None], counts[:, None], max_samples=max(MIN_SAMPLES_PER_FRAME, MAX_SAMPLES // n))
    some = some[:, known[0]]
    if not some.numel():
        return whole
    bulk = max(1, int(BULK_FRACTION * some.shape[1]))
    values = some.numpy()
    apart = np.stack([np.partition(np.abs(values - one), bulk - 1)[:, :bulk].mean(1) for one in values])

    def stands_out(at: int) -> float:
        within = max(float(apart[:at, :at].max()), float(apart[at:, at:].max()))
        return float(apart[:at, at:].min()) / max(within, 1e-30)

    at = max(range(2, n - 1), key=stands_out)
    if stands_out(at) < MIN_SEPARATION:
        return whole
    return slice(0, at) if 2 * at >= n else slice(at, n)


def shutter_message(part: slice, n: int) -> list[str]:
    """Warning if only a part of n frames is used; [] otherwise."""
    if part == slice(0, n):
        return []
    at, other = (part.start, f":{part.start}") if part.start else (part.stop, f"{part.stop}:")
    return [
        Message(
            "shutter-in-burst",
            f"the fixed pattern changes between frames {at - 1} and {at}, as where a shutter closes: only frames "
            f"{part.start} to {part.stop - 1} are used. The others: data.frames={other}",
        )
    ]
