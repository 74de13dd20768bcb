"""Signs that frames are unlike a scene: repetition, an equalised histogram, interlacing."""

from __future__ import annotations

import numpy as np
import torch
from scipy import ndimage
from torch import Tensor

from deepir.arrays.samples import autocorrelation
from deepir.io.inspection.samples import Array
from deepir.messages import Message
from deepir.registration.alignment import tukey_weights
from deepir.registration.preprocess import Level, preprocess, sample, smooth_shading

#: Largest distance of the cumulative histogram from a uniform one; 0.13 and more in frames that are not equalised.
MAX_DISTANCE_FROM_UNIFORM = 0.01
MAX_PAIRS = 4  # of frames whose differences are taken
#: Share of the autocorrelation one px from zero, where noise is no more, that it reaches at a period.
MIN_REPETITION = 0.8
MAX_BETWEEN = (
    0.5  # the same share, below which it falls on the way to the period; smooth scenes, as clouds, stay above
)
PEAK_REACH = 1.5  # distance of the peak of a repetition over that of its nearest sample, at most
#: Largest side of the central crop that is examined, px.
MAX_CROP_SIDE = 320
#: Most frames that are examined.
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
