"""The denoiser `cnn`."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor, nn

from deepir.denoisers.unet import UNet
from deepir.registry import register
from deepir.training.pictures import Pictures
from deepir.training.training import Training

COUNT, SIDE = 8, 64  # crops of an iteration, and their px
NOISE = (0.003, 0.15)  # standard deviations, of a picture's range; each order of magnitude equally often


@register("training", "denoiser")
class Denoiser(Training):
    """White noise of known strength, taken off pictures: the denoiser `cnn`."""

    iterations = 4500

    def __init__(self, rng: np.random.Generator) -> None:
        super().__init__(rng)
        self.pictures = Pictures(rng)

    def network(self) -> nn.Module:
        """A small U-net."""
        return UNet()

    def loss(self, network: nn.Module) -> Tensor:
        """Mean absolute error, in units of the noise: a network that does nothing has 0.8."""
        clean = self.pictures.crops(COUNT, SIDE)
        low, high = (math.log(each) for each in NOISE)
        sigma = torch.from_numpy(np.exp(self.rng.uniform(low, high, (COUNT, 1, 1, 1))).astype(np.float32))
        noise = torch.from_numpy(self.rng.standard_normal(clean.shape, dtype=np.float32))
        return ((network(clean + sigma * noise, sigma) - clean) / sigma).abs().mean()
