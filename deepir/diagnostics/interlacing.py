"""Detect interlaced frames: even and odd rows are exposed at different times, and a moving camera shifts them."""

from __future__ import annotations

import torch
from torch import Tensor

from deepir.registration.alignment import tukey_weights
from deepir.registration.preprocess import preprocess
from deepir.registration.pyramid import Level, sample, smooth_shading

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
