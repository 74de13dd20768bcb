"""Scenes finer than the detector: one frame enlarged, sharpened by a network, or many frames added on a fine grid."""

from __future__ import annotations

import dataclasses
from itertools import pairwise

import numpy as np
import torch
import torch.nn.functional as F
from scipy import ndimage
from torch import Tensor, nn

from deepir import weights
from deepir.arrays.windows import fill_nearest
from deepir.assembly import build
from deepir.baselines.rival import (
    Array,
    Ratio,
    estimate_scene,
    fill_invalid,
    registered_mean,
    result_of,
    rival,
    sampling_points,
    to_indices,
)
from deepir.burst import Burst
from deepir.config import Config
from deepir.operators.warp import rescale_motion
from deepir.registry import register
from deepir.result import Result


@register("method", "bicubic")
def bicubic(burst: Burst, config: Config) -> Result:
    """Enlarge the first frame by a cubic spline; gain and offset stay as they are."""
    first = dataclasses.replace(burst, frames=burst.frames[:1], valid=burst.valid[:1])
    _, geometry = build(config, first)
    frame, good = (torch.from_numpy(each)[None] for each in (first.frames, first.valid & ~burst.bad_pixels))
    filled_frame = fill_nearest(frame, good)[0, 0].numpy()
    scene, used = enlarge(filled_frame, geometry.ratio), np.arange(len(burst.frames)) == 0
    return result_of(burst, scene, used, np.eye(3)[None])


def enlarge(frame: Array, ratio: Ratio) -> Array:
    """A frame (h, w) on a grid `ratio` times as fine; pixels are areas, so that the frame's corners stay in place."""
    return np.asarray(ndimage.zoom(frame, ratio, order=3, mode="mirror", grid_mode=True))


@rival("shift_and_add", estimate_scene)
def shift_and_add(frames: Array, valid: Array, motion: Array, shape: tuple[int, ...]) -> Array:
    """Add registered samples on the fine grid and fill the holes; the pixels' blur stays.

    This is the maximum-likelihood estimate of the blurred scene. A hole takes the mean around it, weighted by the
    narrowest Gaussian that reaches a sample.

    Source: M. Elad, Y. Hel-Or: A fast super-resolution reconstruction algorithm for pure translational motion and
    common space-invariant blur, IEEE Trans. Image Processing 10 (2001).
    """
    ratio = np.divide(shape, frames.shape[1:])
    total, count = np.zeros((2, *shape))
    for frame, good, forth in zip(frames, valid, motion, strict=True):
        row, column = np.rint(to_indices(sampling_points(forth, frame.shape), shape, ratio)).astype(int).reshape(2, -1)
        inside = good.ravel() & (row >= 0) & (row < shape[0]) & (column >= 0) & (column < shape[1])
        np.add.at(total, (row[inside], column[inside]), frame.ravel()[inside])
        np.add.at(count, (row[inside], column[inside]), 1)
    width = 0.5
    while not count.all():
        near, weight = ndimage.gaussian_filter(total, width), ndimage.gaussian_filter(count, width)
        reached = (count == 0) & (weight > 1e-6)
        total[reached], count[reached] = (near / weight.clip(min=1e-12))[reached], 1
        width *= 2
    return (total / count).astype(np.float32)


@rival("vdsr", estimate_scene)
def vdsr(frames: Array, valid: Array, motion: Array, shape: tuple[int, ...]) -> Array:
    """Enlarge each frame by a cubic spline and sharpen it by a trained network, then register and average.

    Convolutions of 3 x 3 px predict the residual; one network serves all factors (`deepir train vdsr`). The paper's
    network is deeper and wider, and its training pictures are different ones. Gain and offset stay as they are.

    Source: J. Kim, J. K. Lee, K. M. Lee: Accurate image super-resolution using very deep convolutional networks, CVPR
    (2016).
    """
    ratio = np.divide(shape, frames.shape[1:])
    fine = np.stack([sharpen(enlarge(frame, ratio)) for frame in fill_invalid(frames, valid)])
    seen = np.stack([enlarge(each.astype(float), ratio) > 0.5 for each in valid])
    return (
        registered_mean(fine, seen, rescale_motion(torch.from_numpy(motion), ratio).numpy()).numpy().astype(np.float32)
    )


def sharpen(frame: Array) -> Array:
    """Restore the detail of an enlarged frame (h, w), in any unit."""
    level = frame.mean(dtype=np.float64)
    picture = torch.from_numpy((frame - level).astype(np.float32))[None, None]
    with torch.no_grad():
        return np.asarray(weights.shipped(VDSR, "vdsr")(picture)[0, 0].numpy() + level)


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
