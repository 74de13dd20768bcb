"""The rival `vdsr`."""

from __future__ import annotations

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from deepir.baselines.single_frame.bicubic import enlarged
from deepir.baselines.single_frame.vdsr import VDSR
from deepir.registry import register
from deepir.training.pictures import JUDGES_OF_RIVALS, Pictures
from deepir.training.training import Training

COUNT, SIDE = 8, 48  # crops of an iteration, and their px
FACTORS = (2, 3, 4)
FAINT = 1e-3  # of a picture's range: what is lost of flat crops counts less


@register("training", "vdsr")
class SuperResolution(Training):
    """Pictures made coarse by a detector's pixels and enlarged again: the method `vdsr`."""

    iterations = 2400

    def __init__(self, rng: np.random.Generator) -> None:
        super().__init__(rng)
        self.pictures = Pictures(rng, without=JUDGES_OF_RIVALS)

    def network(self) -> nn.Module:
        """Ten layers."""
        return VDSR()

    def loss(self, network: nn.Module) -> Tensor:
        """Mean absolute error over that of the enlarged crops: a network that does nothing has one."""
        fine = self.pictures.crops(COUNT, SIDE)
        coarse = torch.stack([self._coarse(each) for each in fine])
        with torch.autocast("cpu", enabled=False):  # what is lost is finer than bfloat16 tells
            error = (network(coarse) - fine).abs()
        lost = (coarse - fine).abs().mean((1, 2, 3))
        return (error.mean((1, 2, 3)) / lost.clamp(min=FAINT)).mean()

    def _coarse(self, fine: Tensor) -> Tensor:
        """A crop (1, h, w) as pixels of two to four times the size see it, enlarged."""
        factor = int(self.rng.choice(FACTORS))
        pixels = F.avg_pool2d(fine, factor)[0].numpy()
        return torch.from_numpy(enlarged(pixels, factor).astype(np.float32))[None]
