"""What no frame sees of the scene: it is to go on smoothly from where some frame does."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from deepir.problem import Problem

SEEN = 0.2  # frames that must show a pixel of the scene, for it to be known


@torch.no_grad()
def smooth_unseen(problem: Problem) -> None:
    """Let the scene go on smoothly where no frame sees it.

    No data hold it there. Left alone it keeps the pattern that the scene once had at its edge, and a solve spends most
    of its iterations on what the penalties make of that.
    """
    values = problem.values()
    slots = {slot: values[name] for slot, name in problem.slots.items()}
    usable = (problem.precision > 0).to(problem.data)
    weight = problem.operator.adjoint(usable, tuple(values["scene"].shape), **slots)
    known = weight > SEEN * weight.max() / len(problem.data)
    if not known.all():
        problem.fields["scene"].init_from(smoothly_filled(values["scene"], known))


def smoothly_filled(image: Tensor, known: Tensor) -> Tensor:
    """Replace unknown pixels (S, C, H, W) by means of what is known around, over ever larger squares.

    (Pull and push: Gortler et al. 1996, "The lumigraph".)
    """
    if known.all() or not known.any():
        return image
    height, width = image.shape[-2:]
    odd = (0, width % 2, 0, height % 2)
    share = F.avg_pool2d(F.pad(known.to(image), odd), 2)
    total = F.avg_pool2d(F.pad(image.where(known, 0), odd), 2)
    coarse = smoothly_filled(total / share.clamp(min=1e-6), share > 0)
    fine = F.interpolate(coarse, scale_factor=2, mode="bilinear")[..., :height, :width]
    return torch.where(known, image, fine)
