"""How strong the parts of gain and offset are: by their marginal likelihood.

Each column (or row, or pixel) has a gain and an offset `x` of prior variance `V = diag(σ²)`, of which the data, with
all else held, say `½ x' A x - s' x` nats. With `x` integrated out, minus the logarithm of the strengths' likelihood is

    ½ Σ log det(1 + A V) - s' V (1 + A V)^-1 s.

(Expectation-maximisation has the same optimum, and takes hundreds of rounds to it where one of the strengths is zero.)
"""

from __future__ import annotations

import numpy as np
import torch
from scipy.optimize import minimize
from torch import Tensor

ENOUGH = 20_000  # of the pixels are asked
#: Squared prior standard deviations, and medians of them, beyond which a value is an outlier, and is not asked.
OUTLIER, MEDIANS = 20.0, 12.0
#: What is known of gains before: as much as so large a share of the values says, at such a strength.
SHARE, GAIN = 0.05, 0.02
PASSES = 2
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
    values = aa, ab, bb, aa * x + ab * y + prior[0] * x, ab * x + bb * y + prior[1] * y
    low, high = LEAST * sigma, most.clamp(min=LEAST * sigma)
    found = sigma.clamp(max=high)
    for _ in range(PASSES):  # who is an outlier depends on the strengths
        typical = _typical(values, *found.square().unbind())
        some = tuple(each[typical] for each in values)

        def cost(logarithms: np.ndarray, some: tuple[Tensor, ...] = some, found: Tensor = found) -> float:
            trial = found.clone()
            trial[free] = torch.from_numpy(np.exp(logarithms)).to(found)
            u, v = trial.square().unbind()
            system, gained = _nats(some, u, v)
            nats = (system.log() - gained).mean()
            return float(nats + SHARE * (u.log() + GAIN**2 / u)) if 0 in free else float(nats)

        bounds = torch.stack((low, high), 1)[free].log().tolist()
        best = minimize(cost, found[free].log().numpy(), method="L-BFGS-B", bounds=bounds).x
        found = found.clone()
        found[free] = torch.from_numpy(np.exp(best)).to(found)
    return found


def _nats(values: tuple[Tensor, ...], u: Tensor, v: Tensor) -> tuple[Tensor, Tensor]:
    """`det(1 + A V)` and `s' V (1 + A V)^-1 s` of each value (aa, ab, bb, s)."""
    aa, ab, bb, s, t = values
    system = 1 + u * aa + v * bb + u * v * (aa * bb - ab * ab)
    gained = u * (1 + v * bb) * s * s + v * (1 + u * aa) * t * t - 2 * u * v * ab * s * t
    return system, gained / system


def _typical(values: tuple[Tensor, ...], u: Tensor, v: Tensor) -> Tensor:
    """Those whose posterior means are not too many of their prior standard deviations."""
    aa, ab, bb, s, t = values
    system, _ = _nats(values, u, v)
    x, y = (s + v * (bb * s - ab * t)) / system, (t + u * (aa * t - ab * s)) / system
    squares = u * x * x + v * y * y
    return squares <= max(OUTLIER, MEDIANS * float(squares.median()))
