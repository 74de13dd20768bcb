"""Trainings of the denoiser `cnn` and of the methods `destripe_cnn` and `vdsr`, on crops of pictures."""

from __future__ import annotations

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from deepir.baselines.stripes import destriping_network
from deepir.baselines.super_resolution import VDSR, enlarge
from deepir.denoisers.unet import UNet
from deepir.registry import register
from deepir.training.training import BATCH_SIZE, BENCHMARK_PHOTOGRAPHS, Training

NOISE_RANGE = (0.003, 0.15)  # standard deviations, in ranges of a picture; log-uniform
COLUMN_GAIN_RANGE = (0.01, 0.25)  # standard deviations of the column gains; log-uniform
#: Standard deviations of the column offsets, in ranges of a picture; log-uniform.
COLUMN_OFFSET_RANGE = (0.005, 0.15)
STRIPED_NOISE_RANGE = (0.001, 0.1)  # standard deviations of white noise under stripes; log-uniform
ENLARGEMENT_FACTORS = (2, 3, 4)  # reductions of a crop; one network learns all
MIN_LOST_DETAIL = 1e-3  # least mean loss of detail, in ranges of a picture, by which errors are divided


@register("training", "denoiser")
class Denoiser(Training):
    """White noise of known strength, removed from pictures: the denoiser `cnn`."""

    iterations = 4500

    def network(self) -> nn.Module:
        """A small U-net."""
        return UNet()

    def loss(self, network: nn.Module) -> Tensor:
        """Mean absolute error, in units of the noise: a network that does nothing has 0.8."""
        clean = self.pictures.crops(BATCH_SIZE, 64)
        sigma = self.log_uniform(NOISE_RANGE)
        return ((network(clean + sigma * self.normal(*clean.shape[2:]), sigma) - clean) / sigma).abs().mean()


@register("training", "destripe_cnn")
class DestripeCNN(Training):
    """Random column gains and offsets, removed from pictures: the method `destripe_cnn`."""

    iterations = 4500
    without = BENCHMARK_PHOTOGRAPHS

    def network(self) -> nn.Module:
        """A small U-net."""
        return destriping_network()

    def loss(self, network: nn.Module) -> Tensor:
        """Mean absolute error in units of the stripes; noise is part of the target."""
        clean = self.pictures.crops(BATCH_SIZE, 64)
        height, width = clean.shape[2:]
        gain, offset = (
            self.log_uniform(each) * self.normal(1, width) for each in (COLUMN_GAIN_RANGE, COLUMN_OFFSET_RANGE)
        )
        stripes = gain * clean + offset
        target = clean + self.log_uniform(STRIPED_NOISE_RANGE) * self.normal(height, width)
        deviation = stripes.std((1, 2, 3), keepdim=True)
        return ((network(target + stripes, 0.0) - target) / deviation).abs().mean()


@register("training", "vdsr")
class SuperResolution(Training):
    """Pictures made coarse by a detector's pixels and enlarged again: the method `vdsr`."""

    iterations = 2400
    without = BENCHMARK_PHOTOGRAPHS

    def network(self) -> nn.Module:
        """Ten layers."""
        return VDSR()

    def loss(self, network: nn.Module) -> Tensor:
        """Mean absolute error over that of the enlarged crops; a network without effect has one."""
        fine = self.pictures.crops(BATCH_SIZE, 48)
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
