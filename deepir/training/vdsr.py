"""Training of the method `vdsr`."""

from __future__ import annotations

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from deepir.baselines.super_resolution import VDSR, enlarge
from deepir.registry import register
from deepir.training.training import BATCH_SIZE, BENCHMARK_PHOTOGRAPHS, Pictures, Training

CROP_SIDE = 48  # px of a crop
ENLARGEMENT_FACTORS = (2, 3, 4)  # reductions of a crop; one network learns all
MIN_LOST_DETAIL = 1e-3  # least mean loss of detail, in ranges of a picture, by which errors are divided


@register("training", "vdsr")
class SuperResolution(Training):
    """Pictures made coarse by a detector's pixels and enlarged again: the method `vdsr`."""

    iterations = 2400

    def __init__(self, rng: np.random.Generator) -> None:
        super().__init__(rng)
        self.pictures = Pictures(rng, without=BENCHMARK_PHOTOGRAPHS)

    def network(self) -> nn.Module:
        """Ten layers."""
        return VDSR()

    def loss(self, network: nn.Module) -> Tensor:
        """Mean absolute error over that of the enlarged crops; a network without effect has one."""
        fine = self.pictures.crops(BATCH_SIZE, CROP_SIDE)
        coarse = torch.stack([self._coarse(each) for each in fine])
        with torch.autocast("cpu", enabled=False):  # lost detail is finer than bfloat16
            error = (network(coarse) - fine).abs()
        lost = (coarse - fine).abs().mean((1, 2, 3))
        return (error.mean((1, 2, 3)) / lost.clamp(min=MIN_LOST_DETAIL)).mean()

    def _coarse(self, fine: Tensor) -> Tensor:
        """A crop (1, h, w) as pixels of two to four times the size see it, enlarged."""
        factor = int(self.rng.choice(ENLARGEMENT_FACTORS))
        pixels = F.avg_pool2d(fine, factor)[0].numpy()
        return torch.from_numpy(enlarge(pixels, factor).astype(np.float32))[None]
