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
MARGIN = 16  # px around a crop: waves go round
NOISE = (0.0005, 0.1)  # standard deviations that the network is told, of a picture's range
TRUST = (
    0.1,
    2.0,
)  # weight of the denoised picture against the data, where its error is what the network is told
FACTORS = (1, 1, 1, 2, 3, 4)  # px of the scene that a detector's pixel is wide


@register("training", "denoiser")
class Denoiser(Training):
    """Takes off what a solve leaves in a picture: half white noise, half noise that has been carried back."""

    iterations = 10_000

    def __init__(self, rng: np.random.Generator) -> None:
        super().__init__(rng)
        self.pictures = Pictures(rng)

    def network(self) -> nn.Module:
        """A small U-net."""
        return UNet()

    def loss(self, network: nn.Module) -> Tensor:
        """Mean absolute error, as a share of what it is before."""
        clean = self.pictures.crops(COUNT, SIDE + 2 * MARGIN)
        sigma = self._drawn(*NOISE, COUNT)
        noise = torch.from_numpy(self.rng.standard_normal(clean.shape, dtype=np.float32))
        error = sigma * noise
        some = COUNT // 2
        error[:some] = self._carried_back(clean[:some], sigma[:some], noise[:some])
        inner = (..., slice(MARGIN, -MARGIN), slice(MARGIN, -MARGIN))
        clean, error = clean[inner], error[inner]
        left = (network(clean + error, sigma) - clean).abs().mean((1, 2, 3))
        return (left / error.abs().mean((1, 2, 3))).mean()

    def _carried_back(self, clean: Tensor, sigma: Tensor, noise: Tensor) -> Tensor:
        """The error of `argmin_x |H x - y|² / v + trust |x - z|² / sigma²`, where z lacks fine detail.

        H is a pixel's area and a lens, v the variance of the noise; both are drawn, and so is what z lacks.
        """
        count, side = len(clean), clean.shape[-1]
        fy, fx = torch.fft.fftfreq(side)[:, None], torch.fft.rfftfreq(side)
        factor = torch.from_numpy(self.rng.choice(FACTORS, (count, 1, 1, 1))).float()
        lens = torch.from_numpy(self.rng.uniform(0, 0.6, (count, 1, 1, 1)).astype(np.float32))
        lack = torch.from_numpy(self.rng.uniform(0, 0.5, (count, 1, 1, 1)).astype(np.float32)) * factor
        seen = torch.where(factor > 1, torch.sinc(factor * fy) * torch.sinc(factor * fx), 1.0)
        seen = seen * _gaussian(lens, fy, fx)
        shrunk = self._drawn(0.5, 3.0, count)  # sigma, in units of the data's noise
        weight = self._drawn(*TRUST, count) / shrunk**2
        detail = weight * (_gaussian(lack, fy, fx) - 1) * torch.fft.rfft2(clean)
        grain = seen * sigma / shrunk * torch.fft.rfft2(noise)
        return torch.fft.irfft2((detail + grain) / (seen**2 + weight), s=(side, side))

    def _drawn(self, low: float, high: float, count: int) -> Tensor:
        """Numbers (count, 1, 1, 1), each order of magnitude equally often."""
        powers = self.rng.uniform(math.log(low), math.log(high), (count, 1, 1, 1))
        return torch.from_numpy(np.exp(powers).astype(np.float32))


def _gaussian(sigma: Tensor, fy: Tensor, fx: Tensor) -> Tensor:
    """Response of a Gaussian blur along each wave."""
    return torch.exp(-2 * (math.pi * sigma) ** 2 * (fy**2 + fx**2))
