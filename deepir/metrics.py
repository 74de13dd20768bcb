"""How close is a result to the truth? Never after warping one onto the other."""

from __future__ import annotations

from typing import Any

import numpy as np

Array = np.ndarray[Any, Any]


def scores(scene: Array, truth: Array) -> dict[str, float]:
    """PSNR (dB) and SSIM of a scene (H, W), as it is and after one best gain and level (the gauge).

    Where each frame has a scene, (N, H, W), the gauge is one for all, and SSIM the mean. The peak is the truth's range.
    `radiometric_rmse` is the error in the data's units after one level, which no burst shows; the gain stays as it is.
    `residual_columns` and `residual_pixels` are what is left of a fixed pattern then, see `pattern`.
    Truth that is not finite is left out, and filled with the scene for SSIM.
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
    """Standard deviations of columns and of pixels in an error (..., H, W), from what neighbours differ by.

    What is smooth does not count, and for pixels neither do rows and columns.
    """
    columns = np.diff(error.mean(-2), axis=-1)
    pixels = np.diff(np.diff(error, axis=-1), axis=-2)
    return float(columns.std() / 2**0.5), float(pixels.std() / 2)


def roughness(scene: Array) -> float:
    """What neighbours in a scene (..., H, W) differ by, to its level: the index of works on non-uniformity correction.

    The sum of all absolute differences along rows and columns, over that of absolute values.
    """
    scene = scene.astype(float)
    steps = sum(float(np.abs(np.diff(scene, axis=axis)).sum()) for axis in (-1, -2))
    return steps / (float(np.abs(scene).sum()) or 1.0)


def motion_error(motion: Array, truth: Array, size: tuple[int, int]) -> float:
    """How far two motions (N, 3, 3) send the corners of a frame (h, w) apart: root mean square, px.

    The first frame, which defines both, and frames that are NaN are left out; NaN if none is left.
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
