"""Noise that the configuration gives, in place of what the samples show."""

from __future__ import annotations

import math

from torch.nn.functional import avg_pool2d

from deepir.config import Config
from deepir.errors import ConfigError
from deepir.messages import Message
from deepir.problem import NoiseModel, Problem

ROUNDING_SIGMA = 0.29  # standard deviation of rounding to whole counts, 1 / √12
SIGNAL_WINDOW = 5  # px: side of the window whose mean is a sample's signal
MIN_RELATIVE_VARIANCE = (
    0.3  # of a sample, relative to the median: an offset is no light, and has no photon noise
)


def given_noise(problem: Problem, config: Config) -> list[str]:
    """Take the noise that the configuration gives, if it does; a message where whole counts cannot have so little."""
    if config.noise == "auto":
        return []
    read, photon = config.noise.read**2, 1 / (config.noise.photons or math.inf)
    # Until there is a prediction, the mean of the neighbours: of single samples the low ones would seem the surest.
    data = problem.data + problem.reference
    signal = avg_pool2d(data, SIGNAL_WINDOW, stride=1, padding=SIGNAL_WINDOW // 2, count_include_pad=False)
    variance = read + photon * signal.clamp_(min=0)
    if not variance.min() > 0:
        raise ConfigError("noise: with read = 0 each sample must be positive, or have photons")
    least = MIN_RELATIVE_VARIANCE * float(variance.median())
    problem.precision.copy_((problem.precision > 0) / variance.clamp_(min=least))
    problem.noise = NoiseModel(read, photon, least)
    if variance.max() > ROUNDING_SIGMA**2 / 10 or data.max() <= 1 or (data % 1).any():
        return []
    return [
        Message(
            "noise-below-rounding",
            f"noise.read is {config.noise.read:g} in units of the data, and rounding to whole counts makes "
            f"{ROUNDING_SIGMA}: is the configuration meant for frames in [0, 1]?",
        )
    ]
