"""Super-resolution of single frames by a trained network."""

from __future__ import annotations

import functools
from itertools import pairwise

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from deepir import weights
from deepir.baselines.average import Array, average_frames, fill_invalid, register_burst, registered_mean
from deepir.baselines.single_frame.bicubic import enlarge
from deepir.burst import Burst
from deepir.config import Config
from deepir.operators.warp import rescale_motion
from deepir.registry import register
from deepir.result import Result


@register("method", "vdsr")
def vdsr(burst: Burst, config: Config) -> Result:
    """Enlarge each frame by a cubic spline and sharpen it by a trained network, then register and average.

    Convolutions of 3 x 3 px predict the residual; one network serves all factors (`deepir train vdsr`). The paper's
    network is deeper and wider, and its training pictures are different ones. Gain and offset stay as they are.

    Source: J. Kim, J. K. Lee, K. M. Lee: Accurate image super-resolution using very deep convolutional networks, CVPR
    (2016).
    """
    found = motion, used, _ = register_burst(burst, config)
    result = average_frames(burst, config, burst.frames, found)
    if motion is not None:
        ratio = result.scene.shape[0] / burst.size[0]
        good = (burst.valid & ~burst.bad_pixels)[used]
        fine = np.stack([sharpen(enlarge(frame, ratio)) for frame in fill_invalid(burst.frames[used], good)])
        seen = np.stack([enlarge(each.astype(float), ratio) > 0.5 for each in good])
        result.scene = (
            registered_mean(fine, seen, rescale_motion(motion[used], ratio).numpy())
            .numpy()
            .astype(np.float32)
        )
    return result


def sharpen(frame: Array) -> Array:
    """Restore the detail of an enlarged frame (h, w), in any unit."""
    level = frame.mean(dtype=np.float64)
    picture = torch.from_numpy((frame - level).astype(np.float32))[None, None]
    with torch.no_grad():
        return np.asarray(_trained()(picture)[0, 0].numpy() + level)


class VDSR(nn.Module):
    """Convolutions whose result is added to the picture, (B, 1, H, W).

    There are no biases, and the picture's mean is subtracted first, so that the network does not depend on units.
    Borders are padded with zeros, as in the paper.
    """

    def __init__(self, depth: int = 10, width: int = 32) -> None:
        super().__init__()
        widths = pairwise([1, *[width] * (depth - 1), 1])
        layers = [nn.Conv2d(before, after, 3, padding=1, bias=False) for before, after in widths]
        for layer in layers:
            nn.init.kaiming_normal_(layer.weight, nonlinearity="relu")
        nn.init.zeros_(layers[-1].weight)  # at first it does nothing
        self.layers = nn.ModuleList(layers)

    def forward(self, picture: Tensor) -> Tensor:
        """Same shape as `picture`."""
        *layers, last = self.layers
        x = picture - picture.mean((1, 2, 3), keepdim=True)
        for layer in layers:
            x = F.relu(layer(x))
        out: Tensor = picture + last(x)
        return out


@functools.cache
def _trained() -> VDSR:
    return weights.load(VDSR(), weights.SHIPPED / "vdsr.safetensors")
