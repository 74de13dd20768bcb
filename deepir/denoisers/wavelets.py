"""Thresholding of wavelets."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from deepir.errors import ConfigError
from deepir.registry import register

WAVELET = "db2"
MARGIN = 16  # px, mirrored: the shifts are cyclic
SHARE = 0.75  # of the universal threshold, which is meant for one picture and not for an average over shifts
SHIFTS = 3  # px, along each axis, of the pictures whose results are averaged


@register("denoiser", "wavelets")
def wavelets(picture: Tensor, noise: float) -> Tensor:
    """Hard thresholding of wavelets, averaged over shifts of the picture (Coifman and Donoho 1995).

    As scikit-image has it; `pip install PyWavelets` is needed.

    Raises:
        ConfigError: PyWavelets is not installed.
    """
    from skimage.restoration import cycle_spin, denoise_wavelet  # not above: it is slow to import

    options = {
        "sigma": SHARE * noise,
        "wavelet": WAVELET,
        "method": "VisuShrink",
        "mode": "hard",
        "rescale_sigma": False,
    }
    planes = picture.reshape(-1, *picture.shape[-2:]).double().cpu().numpy()
    try:
        found = [
            cycle_spin(
                np.pad(plane, MARGIN, "symmetric"), denoise_wavelet, SHIFTS, workers=1, func_kw=options
            )
            for plane in planes
        ]
    except ImportError:
        raise ConfigError(
            "denoiser 'wavelets': it needs PyWavelets: pip install 'deepir[wavelets]'"
        ) from None
    inside = np.stack(found)[:, MARGIN:-MARGIN, MARGIN:-MARGIN]
    return torch.from_numpy(inside.copy()).to(picture).reshape(picture.shape)
