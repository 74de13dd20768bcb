"""Thresholding of wavelets."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from deepir.errors import ConfigError
from deepir.registry import register

#: Daubechies wavelet with two vanishing moments.
WAVELET = "db2"
#: Mirrored margin, px: the shifts are cyclic.
MIRRORED_MARGIN = 16
#: Factor on the universal threshold, which is meant for a single image, not for an average over shifts.
THRESHOLD_FACTOR = 0.75
#: Largest shift along each axis, px.
MAX_SHIFT = 3


@register("denoiser", "wavelets")
def wavelets(picture: Tensor, noise: float) -> Tensor:
    """Hard thresholding of wavelets, averaged over shifts of the picture (Coifman and Donoho 1995).

    As scikit-image has it; `pip install PyWavelets` is needed.

    Raises:
        ConfigError: PyWavelets is not installed.
    """
    from skimage.restoration import cycle_spin, denoise_wavelet  # not above: it is slow to import

    options = {
        "sigma": THRESHOLD_FACTOR * noise,
        "wavelet": WAVELET,
        "method": "VisuShrink",
        "mode": "hard",
        "rescale_sigma": False,
    }
    planes = picture.reshape(-1, *picture.shape[-2:]).double().cpu().numpy()
    try:
        found = [
            cycle_spin(
                np.pad(plane, MIRRORED_MARGIN, "symmetric"),
                denoise_wavelet,
                MAX_SHIFT,
                workers=1,
                func_kw=options,
            )
            for plane in planes
        ]
    except ImportError:
        raise ConfigError(
            "denoiser 'wavelets': it needs PyWavelets: pip install 'deepir[wavelets]'"
        ) from None
    inside = np.stack(found)[:, MIRRORED_MARGIN:-MIRRORED_MARGIN, MIRRORED_MARGIN:-MIRRORED_MARGIN]
    return torch.from_numpy(inside.copy()).to(picture).reshape(picture.shape)
