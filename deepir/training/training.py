"""Training of networks: its loop, the pictures it learns from, and the networks that learn from crops of them."""

from __future__ import annotations

import functools
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from deepir.baselines.stripes import destriping_network
from deepir.baselines.super_resolution import VDSR, enlarge
from deepir.denoisers.unet import UNet
from deepir.registry import register
from deepir.simulate.scenes.procedural import procedural

#: Pictures of scikit-image for training; all others are for tuning and benchmarks.
PHOTOGRAPHS = ("brick", "cell", "chelsea", "coffee", "hubble_deep_field", "retina")
BENCHMARK_PHOTOGRAPHS = ("chelsea", "coffee")  # test pictures of benchmarks/record.py: no rival learns from them
FIRST_SCENE_SEED = 1000  # seed of the first drawn scene; smaller seeds are for tuning and benchmarks
SCENE_COUNT = 160  # drawn scenes
BATCH_SIZE = 8  # crops of an iteration
SCENE_HEIGHTS = (160, 520)  # px of a drawn scene, from and below
PHOTOGRAPH_REDUCTIONS = (1, 2, 3)  # factors; a reduced photograph is sharper
MAX_GRADIENT_NORM = 1.0  # norm to which gradients are clipped
WARM_UP_ITERATIONS = 200  # iterations in which the step size grows to its full value
NOISE_RANGE = (0.003, 0.15)  # standard deviations, in ranges of a picture; log-uniform
COLUMN_GAIN_RANGE = (0.01, 0.25)  # standard deviations of the column gains; log-uniform
COLUMN_OFFSET_RANGE = (0.005, 0.15)  # standard deviations of the column offsets, in ranges of a picture; log-uniform
STRIPED_NOISE_RANGE = (0.001, 0.1)  # standard deviations of white noise under stripes; log-uniform
ENLARGEMENT_FACTORS = (2, 3, 4)  # reductions of a crop; one network learns all
MIN_LOST_DETAIL = 1e-3  # least mean loss of detail, in ranges of a picture, by which errors are divided


class Pictures:
    """Pictures in [0, 1], and crops of them: half of photographs, half of scenes, each drawn on demand.

    Args:
        rng: Random stream.
        without: Names of photographs to leave out.
    """

    def __init__(self, rng: np.random.Generator, without: Sequence[str] = ()) -> None:
        self.rng = rng
        self.photographs = _photographs([name for name in PHOTOGRAPHS if name not in without])
        self.heights = rng.integers(*SCENE_HEIGHTS, SCENE_COUNT)
        self.drawn: dict[int, np.ndarray] = {}

    def crops(self, count: int, side: int) -> Tensor:
        """Random crops (count, 1, side, side), float32: rotated, mirrored, and half of them negative."""
        return torch.from_numpy(np.stack([self._crop(side) for _ in range(count)])[:, None])

    def _crop(self, side: int) -> np.ndarray:
        picture = self._photograph() if self.rng.integers(2) else self._scene()
        y, x = (int(self.rng.integers(length - side + 1)) for length in picture.shape)
        crop = np.rot90(picture[y : y + side, x : x + side], int(self.rng.integers(4)))
        return (crop if self.rng.integers(2) else crop.T) * np.float32(self.rng.choice([-1, 1]))

    def _photograph(self) -> np.ndarray:
        """A photograph; larger ones are more frequent."""
        sides = np.sqrt([each.size for each in self.photographs])
        return self.photographs[self.rng.choice(len(sides), p=sides / sides.sum())]

    def _scene(self) -> np.ndarray:
        i = int(self.rng.integers(SCENE_COUNT))
        if i not in self.drawn:
            shape = (int(self.heights[i]), int(1.25 * self.heights[i]))
            self.drawn[i] = procedural(FIRST_SCENE_SEED + i, shape).astype(np.float32)
        return self.drawn[i]


def _photographs(names: Sequence[str]) -> list[np.ndarray]:
    """Each colour of each photograph, in several sizes."""
    import skimage.data
    from skimage.transform import downscale_local_mean

    found = []
    for name in names:
        whole = np.atleast_3d(getattr(skimage.data, name)()).astype(np.float32) / 255
        for colour in np.moveaxis(whole, -1, 0):
            found += [
                downscale_local_mean(colour, (times, times)).astype(np.float32) for times in PHOTOGRAPH_REDUCTIONS
            ]
    return found


class Training:
    """A network with its training data; `rate` is the step size of Adam, which falls to zero along a cosine."""

    iterations: ClassVar[int] = 10_000
    rate: ClassVar[float] = 1e-3
    without: ClassVar[Sequence[str]] = ()  # photographs that it does not learn from
    network: ClassVar[type[nn.Module] | staticmethod[[], nn.Module]]  # makes a new one; torch draws its weights

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng  # for all that is drawn at random

    @functools.cached_property
    def pictures(self) -> Pictures:
        """The pictures to learn from."""
        return Pictures(self.rng, self.without)

    def log_uniform(self, limits: tuple[float, float]) -> Tensor:
        """A random number for each crop of an iteration, (B, 1, 1, 1)."""
        low, high = (math.log(each) for each in limits)
        return torch.from_numpy(np.exp(self.rng.uniform(low, high, (BATCH_SIZE, 1, 1, 1))).astype(np.float32))

    def normal(self, height: int, width: int) -> Tensor:
        """White noise of variance one for each crop of an iteration, (B, 1, height, width)."""
        return torch.from_numpy(self.rng.standard_normal((BATCH_SIZE, 1, height, width), dtype=np.float32))

    def loss(self, network: nn.Module) -> Tensor:
        """Loss of the network on new examples; a scalar."""
        raise NotImplementedError


@register("training", "denoiser")
class Denoiser(Training):
    """White noise of known strength, removed from pictures: the denoiser `cnn`."""

    iterations = 4500
    network = UNet

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
    network = staticmethod(destriping_network)

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
    network = VDSR

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


@dataclass(frozen=True)
class TrainingProgress:
    """State of a training, handed to `report` after every iteration."""

    iteration: int
    iterations: int
    loss: float  # averaged over the last hundred iterations or so
    seconds: float


def train(
    kind: Callable[[np.random.Generator], Training],
    *,
    seed: int = 0,
    iterations: int | None = None,
    report: Callable[[TrainingProgress], Any] = lambda learning: None,
) -> nn.Module:
    """Train a network; the same seed gives the same weights, on the same machine and with as many threads.

    Networks compute in bfloat16; weights and their steps are in float32.

    Args:
        kind: The training.
        seed: Of weights and examples.
        iterations: Number of iterations; None: those of the training.
        report: Called after every iteration.
    """
    torch.manual_seed(seed)
    training = kind(np.random.default_rng(seed))
    network = training.network().to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    total = training.iterations if iterations is None else iterations
    adam = torch.optim.Adam(network.parameters(), lr=training.rate, fused=True)
    steps = torch.optim.lr_scheduler.LambdaLR(
        adam, lambda i: min(1.0, (i + 1) / WARM_UP_ITERATIONS) * (1 + math.cos(math.pi * i / total)) / 2
    )
    start, average = time.monotonic(), math.nan
    for i in range(total):
        with torch.autocast("cpu", torch.bfloat16):
            loss = training.loss(network)
        adam.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(network.parameters(), MAX_GRADIENT_NORM)
        adam.step()
        steps.step()
        last = loss.item()
        average = last if i == 0 else average + max(0.01, 1 / (i + 1)) * (last - average)
        report(TrainingProgress(i + 1, total, average, time.monotonic() - start))
    return network.eval()
