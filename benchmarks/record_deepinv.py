"""deepinv's total variation and deep image prior on one frame, where deepinv is installed.

Both know the Gaussian blur (`sigma` px; 0: none). Total variation has the weight that is best on the truth.
"""

from __future__ import annotations

import importlib.util

import numpy as np
import torch
from deconv import kernel
from record_methods import plain

from deepir.burst import Burst
from deepir.config import Config
from deepir.errors import ConfigError
from deepir.metrics import scores
from deepir.registry import register
from deepir.result import Result

MISSING = "" if importlib.util.find_spec("deepinv") else "deepinv is not installed"
WEIGHTS = (1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2)  # of total variation; the frame is in [0, 1]
STEPS, INNER = 60, 10  # of FISTA, and of the total variation in each
CHANNELS, ITERATIONS, RATE = (64, 300, 1e-2)  # of the decoder; deepinv runs 2,500 unless told, which takes minutes


@register("method", "deepinv_tv")
def deepinv_tv(burst: Burst, config: Config, *, sigma: float = 0.0) -> Result:
    """deepinv: FISTA under total variation, with the weight that is best on the truth."""
    deepinv = loaded()
    y, low, span = unit(burst)
    physics = blurred(deepinv, sigma)
    prior = deepinv.optim.TVPrior(n_it_max=INNER)
    found = []
    for weight in WEIGHTS:
        solver = deepinv.optim.FISTA(
            data_fidelity=deepinv.optim.L2(), prior=prior, lambda_reg=weight, stepsize=1.0, max_iter=STEPS
        )
        with torch.no_grad():
            found.append(solver(y, physics)[0, 0].numpy() * span + low)
    return plain(burst, max(found, key=lambda scene: scores(scene, burst.truth["scene"])["psnr"]))


@register("method", "deepinv_dip")
def deepinv_dip(burst: Burst, config: Config, *, sigma: float = 0.0) -> Result:
    """deepinv: its deep image prior, a convolutional decoder that is fitted to the frame."""
    deepinv = loaded()
    y, low, span = unit(burst)
    decoder = deepinv.models.ConvDecoder(img_size=tuple(y.shape[1:]), in_size=(4, 4), channels=CHANNELS)
    prior = deepinv.models.DeepImagePrior(decoder, img_size=[CHANNELS, 4, 4], iterations=ITERATIONS, learning_rate=RATE)
    return plain(burst, prior(y, blurred(deepinv, sigma))[0, 0].detach().numpy() * span + low)


def loaded():  # type: ignore[no-untyped-def]
    """The package."""
    if MISSING:
        raise ConfigError(f"{MISSING}: pip install deepinv")
    import deepinv

    return deepinv


def unit(burst: Burst) -> tuple[torch.Tensor, float, float]:
    """The frame (1, 1, h, w) in [0, 1], and its least value and range."""
    frame = burst.frames[0]
    low, span = float(frame.min()), float(np.ptp(frame))
    return torch.from_numpy((frame - low) / span)[None, None], low, span


def blurred(deepinv, sigma: float):  # type: ignore[no-untyped-def]
    """The blur, mirrored at the edges, or none."""
    if not sigma:
        return deepinv.physics.Denoising()
    psf = torch.from_numpy(kernel("gaussian", sigma=sigma).astype(np.float32))[None, None]
    return deepinv.physics.Blur(filter=psf, padding="reflect")
