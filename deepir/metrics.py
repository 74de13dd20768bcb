"""Metrics of a result, and averages of registered frames."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from deepir.arrays import Array

if TYPE_CHECKING:
    from deepir.problem import Problem, Values


class RegisteredAverage:
    """Weighted average of frames on the grid of the scene, `A' W (y - b) / A' W A 1` for the model `y = A x + b`.

    Terms that depend on A and W alone are computed once.

    Args:
        problem: Its operator and data.
        values: Values of the unknowns; the scene is not used.
        weights: Of the samples, (N, C, h, w); precisions relative to the largest if None.
    """

    def __init__(self, problem: Problem, values: Values, weights: Tensor | None = None) -> None:
        zero = torch.zeros_like(values["scene"])
        unit = problem.precision.amax().clamp(min=1e-30) if weights is None else 1
        self._problem, self._shape = problem, tuple(zero.shape)
        self._slots = {slot: values[name] for slot, name in problem.slots.items() if name in values}
        self._weights = (problem.precision if weights is None else weights) / unit
        #: Prediction for a zero scene, b.
        self.at_zero = problem.predict(values | {"scene": zero})
        ones = problem.predict(values | {"scene": zero + 1}) - self.at_zero
        #: Sum of the weights at each pixel of the scene, in frames, (S, C, H, W).
        self.weight = self.backproject(ones)

    def __call__(self, frames: Tensor) -> Tensor:
        """The average of frames (N, C, h, w), such as `y - b`, (S, C, H, W)."""
        return self.backproject(frames) / self.weight.clamp(min=1e-6)

    def backproject(self, frames: Tensor) -> Tensor:
        """`A' W` of frames (N, C, h, w), (S, C, H, W)."""
        # Without a warp, one prediction of its shape stands for all frames.
        each = (frames * self._weights).sum_to_size(self.at_zero.shape)
        return self._problem.operator.adjoint(each, self._shape, **self._slots)


def scores(scene: Array, truth: Array) -> dict[str, float]:
    """PSNR and SSIM of a scene, with and without alignment by one gain and one level (the gauge).

    Args:
        scene: (H, W), or (N, H, W) if each frame has a scene.
        truth: Same shape; pixels that are not finite are left out, and filled with the scene for SSIM.

    Returns:
        `psnr`, `psnr_aligned`: dB, with the range of the truth as the peak.
        `ssim`, `ssim_aligned`: mean over the frames.
        `radiometric_rmse`: after alignment by a level only, data units.
        `residual_columns`, `residual_pixels`: see `pattern`, after alignment, data units.
    """
    from skimage.metrics import peak_signal_noise_ratio  # a quarter of a second, and few runs have a truth

    known = np.isfinite(truth)
    truth, scene = np.where(known, truth, scene).astype(float), scene.astype(float)
    span = float(np.ptp(truth[known])) or 1.0
    aligned = align(scene, truth, known)
    columns, pixels = pattern(np.where(known, aligned - truth, 0.0))
    return {
        "psnr": peak_signal_noise_ratio(truth[known], scene[known], data_range=span),
        "psnr_aligned": peak_signal_noise_ratio(truth[known], aligned[known], data_range=span),
        "radiometric_rmse": (scene - truth)[known].std(),
        "ssim": _similarity(truth, scene, span),
        "ssim_aligned": _similarity(truth, np.where(known, aligned, truth), span),
        "residual_columns": columns,
        "residual_pixels": pixels,
    }


def pattern(error: Array) -> tuple[float, float]:
    """Standard deviations of column and pixel noise in an error, from differences of neighbours.

    Args:
        error: (..., H, W).

    Returns:
        Of columns and of pixels, without smooth structure; that of pixels without rows and columns, too.
    """
    columns = np.diff(error.mean(-2), axis=-1)
    pixels = np.diff(np.diff(error, axis=-1), axis=-2)
    return float(columns.std() / 2**0.5), float(pixels.std() / 2)


def roughness(scene: Array) -> float:
    """Roughness index of non-uniformity correction: L1 norm of the gradient relative to that of the scene.

    Args:
        scene: (..., H, W).

    Source: Hayat et al. 1999, "Statistical algorithm for nonuniformity correction in focal-plane arrays".
    """
    scene = scene.astype(float)
    steps = sum(float(np.abs(np.diff(scene, axis=axis)).sum()) for axis in (-1, -2))
    return steps / (float(np.abs(scene).sum()) or 1.0)


def motion_error(motion: Array, truth: Array, size: tuple[int, int]) -> float:
    """Root mean square distance of the corners of a frame under two motions, px.

    Args:
        motion: (N, 3, 3) homographies; frames that are NaN are left out.
        truth: Same shape.
        size: (h, w) of a frame.

    Returns:
        The error without the first frame, which is the reference; NaN without any frame.
    """
    y, x = ((side - 1) / 2 for side in size)
    corners = np.array([[-x, x, -x, x], [-y, -y, y, y], [1, 1, 1, 1]])
    found, true = ((at := each.astype(float) @ corners)[:, :2] / at[:, 2:] for each in (motion, truth))
    apart = ((found - true) ** 2).sum(1)[1:]
    apart = apart[np.isfinite(apart)]
    return float(np.sqrt(apart.mean())) if apart.size else float("nan")


def _similarity(truth: Array, scene: Array, span: float) -> float:
    """SSIM, the mean over the frames."""
    from skimage.metrics import structural_similarity

    pairs = zip(*(each.reshape(-1, *each.shape[-2:]) for each in (truth, scene)), strict=True)
    return float(np.mean([structural_similarity(*pair, data_range=span) for pair in pairs]))


def align(scene: Array, truth: Array, known: Array) -> Array:
    """`a * scene + b` nearest to the truth in the least squares sense; its mean for a negative, which no gain makes."""
    design = np.stack([scene[known], np.ones(int(known.sum()))], 1)
    (gain, level), *_ = np.linalg.lstsq(design, truth[known], rcond=None)
    return gain * scene + level if gain > 0 else np.full_like(scene, truth[known].mean())
