"""Non-local means."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from deepir.registry import register

#: Side of a patch, px.
PATCH_SIDE = 5
#: Largest distance of patches that are compared, px.
SEARCH_RADIUS = 6
#: Filter parameter h, noise standard deviations.
FILTER_STRENGTH = 0.8


@register("denoiser", "nl_means")
def nl_means(picture: Tensor, noise: float) -> Tensor:
    """Non-local means (Buades, Coll, Morel 2005), by scikit-image."""
    from skimage.restoration import denoise_nl_means  # not above: it is slow to import

    low = picture.min()
    span = float((picture.max() - low).clamp(min=1e-30))  # it works with values of about one
    options = {
        "patch_size": PATCH_SIDE,
        "patch_distance": SEARCH_RADIUS,
        "h": FILTER_STRENGTH * noise / span,
        "sigma": noise / span,
    }
    planes = ((picture - low) / span).reshape(-1, *picture.shape[-2:]).double().cpu().numpy()
    found = np.stack([denoise_nl_means(plane, fast_mode=True, **options) for plane in planes])
    return torch.from_numpy(found).to(picture).reshape(picture.shape) * span + low
