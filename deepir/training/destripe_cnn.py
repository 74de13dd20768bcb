"""The rival `destripe_cnn`."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor, nn

from deepir.baselines.single_frame import destripe_cnn
from deepir.registry import register
from deepir.training.pictures import JUDGES_OF_RIVALS, Pictures
from deepir.training.training import Training

COUNT, SIDE = 8, 64  # crops of an iteration, and their px
GAIN = (0.01, 0.25)  # standard deviations of the columns' gains
OFFSET = (0.005, 0.15)  # and of their offsets, of a picture's range
NOISE = (0.001, 0.1)  # and of white noise, of a picture's range


@register("training", "destripe_cnn")
class DestripeCNN(Training):
    """Columns with gains and offsets of their own, taken off pictures: the method `destripe_cnn`."""

    iterations = 4500

    def __init__(self, rng: np.random.Generator) -> None:
        super().__init__(rng)
        self.pictures = Pictures(rng, without=JUDGES_OF_RIVALS)

    def network(self) -> nn.Module:
        """A small U-net."""
        return destripe_cnn.network()

    def loss(self, network: nn.Module) -> Tensor:
        """Mean absolute error in units of the stripes. Noise is no stripe: it is to stay."""
        clean = self.pictures.crops(COUNT, SIDE)
        gain, offset = (self._strength(each) * self._normal(1, SIDE) for each in (GAIN, OFFSET))
        stripes = gain * clean + offset
        target = clean + self._strength(NOISE) * self._normal(SIDE, SIDE)
        height = stripes.std((1, 2, 3), keepdim=True)
        return ((network(target + stripes, 0.0) - target) / height).abs().mean()

    def _strength(self, limits: tuple[float, float]) -> Tensor:
        """One for each crop; each order of magnitude equally often."""
        low, high = (math.log(each) for each in limits)
        return torch.from_numpy(np.exp(self.rng.uniform(low, high, (COUNT, 1, 1, 1))).astype(np.float32))

    def _normal(self, height: int, width: int) -> Tensor:
        return torch.from_numpy(self.rng.standard_normal((COUNT, 1, height, width), dtype=np.float32))
