"""What frames alone show: an equalised histogram, interlacing, a shutter that closed between them."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from deepir.arrays.samples import Array
from deepir.arrays.statistics import mixed_difference, subsample
from deepir.messages import Message
from deepir.registration.alignment import tukey_weights
from deepir.registration.preprocess import Level, preprocess, sample, smooth_shading

#: Largest distance of the cumulative histogram from a uniform one; 0.13 and more in frames that are not equalised.
MAX_DISTANCE_FROM_UNIFORM = 0.01
#: Largest side of the central crop that is examined for interlacing, px.
MAX_CROP_SIDE = 320
#: Most frames that are examined for it.
MAX_FRAMES = 10
#: Fewest frames: a scene and a pattern explain any two.
MIN_FRAMES = 3
#: Alternations between scene and pattern.
N_ALTERNATIONS = 3
#: Row classes modulo which shifts are estimated: two of each field.
N_ROW_CLASSES = 4
#: Shift between fields relative to that within a field; 2.5 at most in progressive frames, 9 at least in interlaced.
MIN_FIELD_SHIFT_RATIO = 5.0
#: Smallest shift between fields that counts, px.
MIN_FIELD_SHIFT = 0.1
#: Samples of all frames that suffice to find a shutter event.
MAX_SAMPLES = 40_000
#: Fewest samples of a frame.
MIN_SAMPLES_PER_FRAME = 200
#: Fraction of the smallest differences that count: the others are edges of the scene.
BULK_FRACTION = 0.75
#: Distance between two groups of frames relative to that within them from which their patterns differ.
MIN_SEPARATION = 1.3


def is_equalised(frames: Array) -> bool:
    """Whether the histogram of every frame is uniform; frames (N, h, w), NaN where unknown."""
    for frame in frames:
        values, counts = np.unique(frame[np.isfinite(frame)], return_counts=True)
        if len(values) < 3:
            return False
        below = counts[1:].cumsum() / counts[1:].sum()
        if (
            np.abs(below - (values[1:] - values[0]) / (values[-1] - values[0])).max()
            > MAX_DISTANCE_FROM_UNIFORM
        ):
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
def are_interlaced(frames: Tensor, motion: Tensor, ignore: Tensor | None = None) -> bool:
    """Whether even and odd rows are shifted by more than rows of one field are by chance.

    Args:
        frames: (N, H, W).
        motion: (N, 3, 3) homographies.
        ignore: Pixels without use, (H, W), bool.
    """
    if len(frames) < MIN_FRAMES:
        return False
    steps = row_class_shifts(
        centre_crop(frames[:MAX_FRAMES]), motion[:MAX_FRAMES], None if ignore is None else centre_crop(ignore)
    )
    first, second, third, fourth = steps.unbind()
    between = (first - second + third - fourth) / 2
    within = torch.stack((first + second - third - fourth, first - second - third + fourth)) / 2
    apart, chance = (float(each.square().sum(-1).mean().sqrt()) for each in (between, within))
    return apart > max(MIN_FIELD_SHIFT, MIN_FIELD_SHIFT_RATIO * chance)


def centre_crop(images: Tensor) -> Tensor:
    """Central crop of images (..., H, W), with the same centre."""
    for axis in (-2, -1):
        cut = max(0, -(-(images.shape[axis] - MAX_CROP_SIDE) // 2))
        images = images.narrow(axis, cut, images.shape[axis] - 2 * cut)
    return images


def row_class_shifts(frames: Tensor, motion: Tensor, ignore: Tensor | None) -> Tensor:
    """Residual shift of each class of rows, one Gauss-Newton step for scene and pattern of all rows.

    Args:
        frames: (N, H, W).
        motion: (N, 3, 3) homographies.
        ignore: Pixels without use, (H, W), bool.

    Returns:
        (4, N, 2), px; a shift common to all classes is an error of the motion.
    """
    flat, weight = preprocess(frames, ignore)
    flat -= weight * torch.stack([smooth_shading(frame[None])[0] for frame in flat])
    level = Level(1, flat, weight, bool(weight.all()), (weight.shape[0], weight.shape[1]))
    pattern = torch.zeros_like(weight)
    for _ in range(N_ALTERNATIONS):
        pulled, known = sample(flat - pattern, torch.linalg.inv(motion), level)
        scene, seen = sample((pulled.sum(0) / known.sum(0).clamp_min(1))[None], motion, level)
        rest = (flat - scene) * seen
        pattern = rest.sum(0) / seen.sum(0).clamp_min(1)
    seen = seen * weight
    rest = (rest - pattern) * seen
    trust = tukey_weights(rest.flatten(1), seen.flatten(1)).view_as(rest)[:, 1:-1, 1:-1]
    slope_x, slope_y = scene[:, 1:-1, 2:] - scene[:, 1:-1, :-2], scene[:, 2:, 1:-1] - scene[:, :-2, 1:-1]
    each = torch.stack((slope_x / 2, slope_y / 2, torch.ones_like(slope_x)), 1).double()
    found = []
    for row in range(N_ROW_CLASSES):
        some = [image[..., row::N_ROW_CLASSES, :].flatten(-2) for image in (each, trust, rest[:, 1:-1, 1:-1])]
        design, right = some[0] * some[1][:, None], some[2].double()
        normal = design @ some[0].mT + 1e-9 * torch.eye(3, dtype=torch.float64)
        found.append(torch.linalg.solve(normal, design @ right[:, :, None])[:, :2, 0])
    return torch.stack(found)


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
    some, known = subsample(
        fine[:, None], counts[:, None], max_samples=max(MIN_SAMPLES_PER_FRAME, MAX_SAMPLES // n)
    )
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
