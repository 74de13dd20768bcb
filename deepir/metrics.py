"""How close is a scene to the truth? Never after warping one onto the other."""

from __future__ import annotations

from typing import Any

import numpy as np
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

Array = np.ndarray[Any, Any]


def scores(scene: Array, truth: Array) -> dict[str, float]:
    """PSNR (dB) and SSIM of a scene (H, W), as it is and after one best gain and level (the gauge).

    Where each frame has a scene, (N, H, W), the gauge is one for all, and SSIM the mean. The peak is the truth's range.
    `radiometric_rmse` is the error in the data's units after one level, which no burst shows; the gain stays as it is.
    Truth that is not finite is left out, and filled with the scene for SSIM.
    """
    known = np.isfinite(truth)
    truth, scene = np.where(known, truth, scene).astype(float), scene.astype(float)
    span = float(np.ptp(truth[known])) or 1.0
    aligned = align(scene, truth, known)
    return {
        "psnr": peak_signal_noise_ratio(truth[known], scene[known], data_range=span),
        "psnr_aligned": peak_signal_noise_ratio(truth[known], aligned[known], data_range=span),
        "radiometric_rmse": (scene - truth)[known].std(),
        "ssim": _similarity(truth, scene, span),
        "ssim_aligned": _similarity(truth, np.where(known, aligned, truth), span),
    }


def _similarity(truth: Array, scene: Array, span: float) -> float:
    """SSIM, the mean over the frames."""
    pairs = zip(*(each.reshape(-1, *each.shape[-2:]) for each in (truth, scene)), strict=True)
    return float(np.mean([structural_similarity(*pair, data_range=span) for pair in pairs]))


def align(scene: Array, truth: Array, known: Array) -> Array:
    """`a * scene + b` nearest to the truth in the least squares sense."""
    design = np.stack([scene[known], np.ones(int(known.sum()))], 1)
    (gain, level), *_ = np.linalg.lstsq(design, truth[known], rcond=None)
    return gain * scene + level
