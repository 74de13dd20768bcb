"""Thresholding of wavelets."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from deepir.errors import ConfigError
from deepir.registry import register

SHIFTS = 3  # px, along each axis, of the pictures whose results are averaged


@register("denoiser", "wavelets")
def wavelets(picture: Tensor, noise: float) -> Tensor:
    """Soft thresholds for each band (BayesShrink: Chang, Yu, Vetterli 2000), averaged over shifts of the picture.

    As scikit-image has it; `pip install PyWavelets` is needed.

    Raises:
        ConfigError: PyWavelets is not installed.
    """
    from skimage.restoration import cycle_spin, denoise_wavelet  # not above: it is slow to import

    options = {"sigma": noise, "method": "BayesShrink", "mode": "soft", "rescale_sigma": False}
    planes = picture.reshape(-1, *picture.shape[-2:]).double().cpu().numpy()
    try:
        found = [
            cycle_spin(plane, denoise_wavelet, max_shifts=SHIFTS, workers=1, func_kw=options)
            for plane in planes
        ]
    except ImportError:
        raise ConfigError(
            "denoiser 'wavelets': it needs PyWavelets: pip install 'deepir[wavelets]'"
        ) from None
    return torch.from_numpy(np.stack(found)).to(picture).reshape(picture.shape)
