"""Training of the denoiser `cnn`."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor, nn

from deepir.denoisers.unet import UNet
from deepir.registry import register
from deepir.training.training import BATCH_SIZE, Pictures, Training

CROP_SIDE = 64  # px of a crop
NOISE_RANGE = (0.003, 0.15)  # standard deviations, in ranges of a picture; log-uniform


@register("training", "denoiser")
class Denoiser(Training):
    """White noise of known strength, removed from pictures: the denoiser `cnn`."""

    iterations = 4500

    def __init__(self, rng: np.random.Generator) -> None:
        super().__init__(rng)
        self.pictures = Pictures(rng)

    def network(self) -> nn.Module:
        """A small U-net."""
        return UNet()

    def loss(self, network: nn.Module) -> Tensor:
        """Mean absolute error, in units of the noise: a network that does nothing has 0.8."""
        clean = self.pictures.crops(BATCH_SIZE, CROP_SIDE)
        low, high = (math.log(each) for each in NOISE_RANGE)
        sigma = torch.from_numpy(
            np.exp(self.rng.uniform(low, high, (BATCH_SIZE, 1, 1, 1))).astype(np.float32)
        )
        noise = torch.from_numpy(self.rng.standard_normal(clean.shape, dtype=np.float32))
        return ((network(clean + sigma * noise, sigma) - clean) / sigma).abs().mean()
