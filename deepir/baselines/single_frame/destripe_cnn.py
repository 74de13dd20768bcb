"""Column stripes of single frames by a trained network."""

from __future__ import annotations

import functools

import numpy as np
import torch

from deepir import weights
from deepir.baselines.average import Array, average_frames, fill_invalid
from deepir.burst import Burst
from deepir.config import Config
from deepir.denoisers.unet import UNet
from deepir.registry import register
from deepir.result import Result


@register("method", "destripe_cnn")
def destripe_cnn(burst: Burst, config: Config) -> Result:
    """Remove column stripes from each frame by a trained network, then register and average.

    The network predicts the residual and was trained on simulated columns (`deepir train destripe_cnn`). The paper's
    network and its training pictures are different ones.

    Source: Z. He, Y. Cao, Y. Dong, J. Yang, Y. Cao, C.-L. Tisse: Single-image-based nonuniformity correction of
    uncooled long-wave infrared detectors: a deep-learning approach, Applied Optics 57 (2018).
    """
    frames = fill_invalid(burst.frames, burst.valid & ~burst.bad_pixels)
    return average_frames(burst, config, np.stack([destripe(frame) for frame in frames]))


def destripe(frame: Array) -> Array:
    """A frame (h, w), in any unit, without its stripes; its mean stays."""
    level = frame.mean(dtype=np.float64)
    picture = torch.from_numpy((frame - level).astype(np.float32))[None, None]
    with torch.no_grad():
        found = _trained().of_any_size(picture, 0.0)[0, 0].numpy()
    return np.asarray(found - found.mean() + level)


def network() -> UNet:
    """A U-net without a noise level as input."""
    return UNet((24, 48, 96))


@functools.cache
def _trained() -> UNet:
    return weights.load(network(), weights.SHIPPED / "destripe_cnn.safetensors")
