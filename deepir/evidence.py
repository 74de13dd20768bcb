"""How strong the parts of gain and offset are: by their marginal likelihood.

Each column (or row, or pixel) has a gain and an offset `x` of prior variance `V = diag(σ²)`, of which the data, with
all else held, say `½ x' A x - s' x` nats. With `x` integrated out, minus the logarithm of the strengths' likelihood is

    ½ Σ log det(1 + A V) - s' V (1 + A V)^-1 s.

(Expectation-maximisation has the same optimum, and takes hundreds of rounds to it where one of the strengths is zero.)
"""

from __future__ import annotations

import math

import numpy as np
import torch
from scipy.optimize import minimize
from torch import Tensor

ENOUGH = 20_000  # of the pixels are asked
#: Nats, and medians of the nats, that a value may gain of its strength: beyond, it is an outlier and is not asked.
OUTLIER, MEDIANS = 20.0, 12.0
#: What is known of gains before: as much as so large a share of the values says, at such a strength.
SHARE, GAIN = 0.05, 0.02
LEAST = 1e-3  # a strength changes by no more than such a factor, downwards


def likeliest(information: Tensor, means: Tensor, sigma: Tensor, most: Tensor, free: list[int]) -> Tensor:
    """The strengths (gain, offset), those in `free` chosen anew.

    Args:
        information: A (aa, ab, bb), (3, K).
        means: the posterior means of x, (2, K), at strengths `sigma` (2,).
        most: upper bounds, (2,).
        free: 0 for the gain's, 1 for the offset's.
    """
    free = [i for i in free if sigma[i] > 0]
    if not free:
        return sigma
    step = max(information.shape[1] // ENOUGH, 1)
    (aa, ab, bb), (x, y) = information[:, ::step], means[:, ::step]
    prior = torch.where(sigma > 0, sigma.square().reciprocal(), 0.0)
    s, t = aa * x + ab * y + prior[0] * x, ab * x + bb * y + prior[1] * y
    whole = aa * bb - ab * ab

    def gained(u: Tensor, v: Tensor, system: Tensor) -> Tensor:
        return (u * (1 + v * bb) * s * s + v * (1 + u * aa) * t * t - 2 * u * v * ab * s * t) / system

    def system(u: Tensor, v: Tensor) -> Tensor:
        return 1 + u * aa + v * bb + u * v * whole

    u, v = sigma.square()
    nats = gained(u, v, system(u, v))
    typical = nats <= max(OUTLIER, MEDIANS * float(nats.median()))
    aa, ab, bb, s, t, whole = (each[typical] for each in (aa, ab, bb, s, t, whole))

    def cost(logarithms: np.ndarray) -> float:
        trial = sigma.clone()
        trial[free] = torch.from_numpy(np.exp(logarithms)).to(sigma)
        u, v = trial.square()
        each = system(u, v)
        nats = (each.log() - gained(u, v, each)).mean()
        return float(nats + SHARE * (u.log() + GAIN**2 / u)) if 0 in free else float(nats)

    bounds = [
        (math.log(LEAST * float(sigma[i])), math.log(max(float(most[i]), LEAST * float(sigma[i]))))
        for i in free
    ]
    start = [min(math.log(float(sigma[i])), high) for i, (_, high) in zip(free, bounds, strict=True)]
    found = sigma.clone()
    found[free] = torch.from_numpy(np.exp(minimize(cost, start, method="L-BFGS-B", bounds=bounds).x)).to(
        sigma
    )
    return found
