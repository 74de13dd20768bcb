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

ENOUGH = 8_000  # of the pixels are asked
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

        def cost(
            logarithms: np.ndarray, some: tuple[Tensor, ...] = some, found: Tensor = found
        ) -> tuple[float, np.ndarray]:
            trial = found.clone()
            trial[free] = torch.from_numpy(np.exp(logarithms)).to(found)
            nats, slope = _nats(some, *trial.square().unbind())
            u = trial[0].square()
            nats, slope = nats.mean(), slope.mean(1)
            if 0 in free:
                nats, slope[0] = (
                    nats + SHARE * (u.log() + GAIN**2 / u),
                    slope[0] + SHARE * (1 / u - (GAIN / u) ** 2),
                )
            return float(nats), (2 * trial.square() * slope)[free].numpy()

        bounds = torch.stack((low, high), 1)[free].log().tolist()
        best = minimize(cost, found[free].log().numpy(), jac=True, method="L-BFGS-B", bounds=bounds).x
        found = found.clone()
        found[free] = torch.from_numpy(np.exp(best)).to(found)
    return found


def _nats(values: tuple[Tensor, ...], u: Tensor, v: Tensor) -> tuple[Tensor, Tensor]:
    """`log det(1 + A V) - s' V (1 + A V)^-1 s` of each value (aa, ab, bb, s), and its slope in V, (2, K)."""
    aa, ab, bb, s, t = values
    whole = aa * bb - ab * ab
    system = 1 + u * aa + v * bb + u * v * whole
    by_u, by_v = (1 + v * bb) * s - v * ab * t, (1 + u * aa) * t - u * ab * s
    gained = (u * s * by_u + v * t * by_v) / system
    # That of the second term is the square of (1 + A V)^-1 s.
    slope = torch.stack((aa + v * whole, bb + u * whole)) / system
    return system.log() - gained, slope - (torch.stack((by_u, by_v)) / system).square()


def _typical(values: tuple[Tensor, ...], u: Tensor, v: Tensor) -> Tensor:
    """Those whose posterior means are not too many of their prior standard deviations."""
    aa, ab, bb, s, t = values
    system = 1 + u * aa + v * bb + u * v * (aa * bb - ab * ab)
    x, y = (s + v * (bb * s - ab * t)) / system, (t + u * (aa * t - ab * s)) / system
    squares = u * x * x + v * y * y
    return squares <= max(OUTLIER, MEDIANS * float(squares.median()))
