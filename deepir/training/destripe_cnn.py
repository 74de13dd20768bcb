"""Training of the method `destripe_cnn`."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor, nn

from deepir.baselines.stripes import destriping_network
from deepir.registry import register
from deepir.training.training import BATCH_SIZE, BENCHMARK_PHOTOGRAPHS, Pictures, Training

CROP_SIDE = 64  # px of a crop
GAIN_RANGE = (0.01, 0.25)  # standard deviations of the column gains; log-uniform
#: Standard deviations of the column offsets, in ranges of a picture; log-uniform.
OFFSET_RANGE = (0.005, 0.15)
NOISE_RANGE = (0.001, 0.1)  # standard deviations of white noise, in ranges of a picture; log-uniform


@register("training", "destripe_cnn")
class DestripeCNN(Training):
    """Random column gains and offsets, removed from pictures: the method `destripe_cnn`."""

    iterations = 4500

    def __init__(self, rng: np.random.Generator) -> None:
        super().__init__(rng)
        self.pictures = Pictures(rng, without=BENCHMARK_PHOTOGRAPHS)

    def network(self) -> nn.Module:
        """A small U-net."""
        return destriping_network()

    def loss(self, network: nn.Module) -> Tensor:
        """Mean absolute error in units of the stripes; noise is part of the target."""
        clean = self.pictures.crops(BATCH_SIZE, CROP_SIDE)
        gain, offset = (
            self._strength(each) * self._normal(1, CROP_SIDE) for each in (GAIN_RANGE, OFFSET_RANGE)
        )
        stripes = gain * clean + offset
        target = clean + self._strength(NOISE_RANGE) * self._normal(CROP_SIDE, CROP_SIDE)
        height = stripes.std((1, 2, 3), keepdim=True)
        return ((network(target + stripes, 0.0) - target) / height).abs().mean()

    def _strength(self, limits: tuple[float, float]) -> Tensor:
        """One for each crop, log-uniform."""
        low, high = (math.log(each) for each in limits)
        return torch.from_numpy(np.exp(self.rng.uniform(low, high, (BATCH_SIZE, 1, 1, 1))).astype(np.float32))

    def _normal(self, height: int, width: int) -> Tensor:
        return torch.from_numpy(self.rng.standard_normal((BATCH_SIZE, 1, height, width), dtype=np.float32))
