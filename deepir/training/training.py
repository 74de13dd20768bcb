"""The interface of a training, and the common loop."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor, nn

MAX_GRADIENT_NORM = 1.0  # norm to which gradients are clipped
WARM_UP_ITERATIONS = 200  # iterations in which the step size grows to its full value


class Training:
    """A network with its training data; `rate` is the step size of Adam, which falls to zero along a cosine."""

    iterations: ClassVar[int] = 10_000
    rate: ClassVar[float] = 1e-3

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng  # for all that is drawn at random

    def network(self) -> nn.Module:
        """A new network; torch draws its weights."""
        raise NotImplementedError

    def loss(self, network: nn.Module) -> Tensor:
        """Loss of the network on new examples; a scalar."""
        raise NotImplementedError


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
    steps = torch.optim.lr_scheduler.LambdaLR(adam, lambda i: _step(i, total))
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


def _step(iteration: int, total: int) -> float:
    """Step size over its full value."""
    return min(1.0, (iteration + 1) / WARM_UP_ITERATIONS) * (1 + math.cos(math.pi * iteration / total)) / 2
