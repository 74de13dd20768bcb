"""How strong the parts of gain and offset are: by their marginal likelihood.

Each column (or row, or pixel) has a gain and an offset `x` of prior variance `V = diag(σ²)`, of which the data, with
all else held, say `½ x' A x - s' x` nats. With `x` integrated out, minus the logarithm of the strengths' likelihood is

    ½ Σ log det(1 + A V) - s' V (1 + A V)^-1 s.

(Expectation-maximisation has the same optimum, and takes hundreds of rounds to it where one of the strengths is zero.)
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from deepir.fields.sensor_maps import GaussianMap

ENOUGH = 8_000  # of the pixels are asked
#: Squared prior standard deviations, and medians of them, beyond which a value is an outlier, and is not asked.
OUTLIER, MEDIANS = 20.0, 12.0
#: What is known of gains before: as much as so large a share of the values says, at such a strength.
SHARE, GAIN = 0.05, 0.02
PASSES = 2
LEAST = 1e-3  # a strength changes by no more than such a factor, downwards
#: Newton's steps: the most, how far at once, and how short the last, of which the square is left.
STEPS, LONGEST, PRECISE = 50, 1.0, 1e-2

#: A function's value, slope (K,) and curvature (K, K).
Known = tuple[float, np.ndarray, np.ndarray]


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
    score = aa * x + ab * y + prior[0] * x, ab * x + bb * y + prior[1] * y
    values = torch.stack((aa, ab, bb, *score)).cpu()  # so few that a GPU would be no faster
    found, high = sigma.cpu().numpy().copy(), most.cpu().numpy()
    low = LEAST * found[free]
    high = high[free].clip(min=low)
    found[free] = found[free].clip(max=high)
    for _ in range(PASSES):  # who is an outlier depends on the strengths
        typical = _typical(values, *found**2)

        def cost(logarithms: np.ndarray, typical: Tensor = typical) -> Known:
            found[free] = np.exp(logarithms)
            nats, slope, curvature = _nats(values, typical, found)
            return nats, slope[free], curvature[free][:, free]

        found[free] = np.exp(_least(cost, np.log(found[free]), np.log(low), np.log(high)))
    return torch.from_numpy(found).to(sigma)


def marginal(information: Tensor, means: Tensor, sigma: Tensor, level: float) -> float:
    """Minus the logarithm of the likelihood of a reference level, at the strengths that are the likeliest with it.

    Measured from a level L the offset is `y + L (x - 1)`, and independent of the gain x.

    Args:
        information: A (aa, ab, bb), (3, K), measured from the present level.
        means: the posterior means of x, (2, K), at strengths `sigma` (2,), which are positive.
        level: L, from the present level.
    """
    step = max(information.shape[1] // ENOUGH, 1)
    (aa, ab, bb), (x, y) = information[:, ::step], means[:, ::step]
    s, t = aa * x + ab * y + x / sigma[0] ** 2, ab * x + bb * y + y / sigma[1] ** 2
    values = torch.stack((aa, ab, bb, s, t)).cpu()
    typical = _typical(values, *(sigma.cpu().numpy() ** 2))
    moved = torch.stack((aa - 2 * level * ab + level**2 * bb, ab - level * bb, bb, s - level * t, t)).cpu()
    start = np.log(
        [max(float(sigma[0]), GAIN / 2), max(float((y + level * x)[typical].std()), float(sigma[1]))]
    )

    def cost(logarithms: np.ndarray) -> Known:
        return _nats(moved, typical, np.exp(logarithms))

    far = np.full(2, np.log(1 / LEAST))
    best = _least(cost, start, start - far, start + far)
    return cost(best)[0] * float(typical.sum()) * step / 2


def _nats(values: Tensor, typical: Tensor, sigma: np.ndarray) -> Known:
    """Twice minus the mean logarithm of the likelihood of strengths, with what is known before; in their logarithms."""
    from deepir.kernels.compile import parallel_for
    from deepir.kernels.marginal_likelihood import negative_log_likelihood

    sums, (u, v) = torch.empty(6, dtype=torch.float64), sigma**2
    parallel_for(negative_log_likelihood, 1, values, typical, u, v, sums)
    value, *slope, uu, uv, vv = (sums / typical.sum()).tolist()
    if u > 0:
        value, slope[0] = value + SHARE * (math.log(u) + GAIN**2 / u), slope[0] + SHARE * (u - GAIN**2) / u**2
        uu += SHARE * (2 * GAIN**2 - u) / u**3
    by = 2 * np.array((u, v))  # of the variances by the logarithms
    return value, by * slope, by[:, None] * by * ((uu, uv), (uv, vv)) + np.diag(2 * by * slope)


def _least(
    cost: Callable[[np.ndarray], Known], start: np.ndarray, low: np.ndarray, high: np.ndarray
) -> np.ndarray:
    """Where a function between two bounds is least: by Newton's steps, along the slope where it curves downwards."""
    x, (value, slope, curvature) = start, cost(start)
    for _ in range(STEPS):
        free = ~((x <= low) & (slope > 0) | (x >= high) & (slope < 0))
        if not (free.any() and np.isfinite(curvature).all()):
            break
        sizes, axes = np.linalg.eigh(curvature[free][:, free])
        way = np.zeros_like(x)
        way[free] = -axes @ ((slope[free] @ axes) / np.abs(sizes).clip(min=1e-9))
        trial = (x + way.clip(-LONGEST, LONGEST)).clip(low, high)
        while not (new := cost(trial))[0] <= value and np.abs(trial - x).max() > PRECISE:
            trial = x + (trial - x) / 4
        if not new[0] <= value:
            break
        last = np.abs(trial - x).max() < PRECISE
        x, (value, slope, curvature) = trial, new
        if last:
            break
    return x


def _typical(values: Tensor, u: float, v: float) -> Tensor:
    """Those whose posterior means are not too many of their prior standard deviations."""
    aa, ab, bb, s, t = values
    system = 1 + u * aa + v * bb + u * v * (aa * bb - ab * ab)
    x, y = (s + v * (bb * s - ab * t)) / system, (t + u * (aa * t - ab * s)) / system
    squares = u * x * x + v * y * y
    return squares <= max(OUTLIER, MEDIANS * float(squares.median()))


#: A part is at most so many times as strong as the frames' average shows it: where the scene is not quite the same in
#: all frames (parallax), gain and offset would otherwise grow to explain it, and cancel each other.
MAX_SIGMA_RATIO = 2.0


def high_pass(pattern: Tensor, part: GaussianMap) -> Tensor:
    """The part's own share of a pattern: differences of neighbours, of the same variance.

    A part's values are independent, what the scene leaves in the pattern is mostly smooth.
    """
    own = pattern.mean(part.constant_axes, keepdim=True) if part.constant_axes else pattern
    for axis in {-2, -1} - set(part.constant_axes):
        own = own.diff(dim=axis) / 2**0.5
    return own
