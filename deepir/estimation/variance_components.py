"""Standard deviations of the parts of gain and offset by type-II maximum likelihood.

Each column (or row, or pixel) has gain and offset x of prior variance `V = diag(σ²)` and, all else fixed, a negative
log-likelihood `½ x' A x - s' x`. With x integrated out the negative log marginal likelihood of V is

    ½ Σ log det(1 + A V) - s' V (1 + A V)^-1 s.

(Expectation-maximisation has the same optimum, but needs hundreds of rounds if a standard deviation is zero.)
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from deepir.fields.sensor_maps import GaussianMap

MAX_ELEMENTS = 8_000  # elements of a part that are used, at most
MIN_OUTLIER_SQUARE = 20.0  # squared posterior mean, in prior variances, from which an element may be an outlier
MIN_OUTLIER_RATIO = 12.0  # squared posterior mean, in medians of them, from which an element is an outlier
GAIN_PRIOR_FRACTION = 0.05  # weight of the prior on the variance of gains, as a fraction of the elements
TYPICAL_GAIN_SIGMA = 0.02  # standard deviation of gains that this prior is centred at
N_OUTLIER_ROUNDS = 2  # rounds of outlier selection and maximisation
MIN_SIGMA_RATIO = 1e-3  # smallest ratio of a new standard deviation to the old one
MAX_NEWTON_STEPS = 50  # most Newton steps
MAX_LOG_STEP = 1.0  # longest Newton step, in the logarithm of a standard deviation
LOG_STEP_TOLERANCE = 1e-2  # Newton step at which the search stops, in the logarithm of a standard deviation
#: Largest ratio of a prior standard deviation to that of the average of the frames: where the scene differs between
#: frames (parallax), gain and offset would otherwise grow to explain it and cancel each other.
MAX_SIGMA_RATIO = 2.0

Expansion = tuple[float, np.ndarray, np.ndarray]  # value, gradient (K,) and Hessian (K, K) of a function


def estimate_sigmas(information: Tensor, means: Tensor, sigma: Tensor, most: Tensor, free: list[int]) -> Tensor:
    """Prior standard deviations (gain, offset) of maximum marginal likelihood, (2,).

    Args:
        information: A as (aa, ab, bb), (3, K).
        means: Posterior means of x at `sigma`, (2, K).
        sigma: Present standard deviations (gain, offset), (2,).
        most: Upper bounds, (2,).
        free: Which to estimate: 0 gain, 1 offset.
    """
    free = [i for i in free if sigma[i] > 0]
    if not free:
        return sigma
    values, _, _ = _likelihoods(information, means, sigma)
    found, high = sigma.cpu().numpy().copy(), most.cpu().numpy()
    low = MIN_SIGMA_RATIO * found[free]
    high = high[free].clip(min=low)
    found[free] = found[free].clip(max=high)
    for _ in range(N_OUTLIER_ROUNDS):  # who is an outlier depends on the strengths
        inliers = _inliers(values, *found**2)

        def cost(logarithms: np.ndarray, inliers: Tensor = inliers) -> Expansion:
            found[free] = np.exp(logarithms)
            nats, slope, curvature = _nats(values, inliers, found)
            return nats, slope[free], curvature[free][:, free]

        found[free] = np.exp(_minimise(cost, np.log(found[free]), np.log(low), np.log(high)))
    return torch.from_numpy(found).to(sigma)


def reference_level_nats(information: Tensor, means: Tensor, sigma: Tensor, level: float) -> float:
    """Negative log marginal likelihood of a reference level, maximised over the standard deviations, nats.

    Measured from a level L, the offset is `y + L (x - 1)` and independent of the gain x.

    Args:
        information: A as (aa, ab, bb), (3, K), at the present level.
        means: Posterior means of x at `sigma`, (2, K).
        sigma: Present standard deviations, (2,); positive.
        level: L relative to the present level, data units.
    """
    values, (x, y), step = _likelihoods(information, means, sigma)
    aa, ab, bb, s, t = values
    inliers = _inliers(values, *(sigma.cpu().numpy() ** 2))
    moved = torch.stack((aa - 2 * level * ab + level**2 * bb, ab - level * bb, bb, s - level * t, t))
    offset = float((y + level * x)[inliers].std())
    start = np.log([max(float(sigma[0]), TYPICAL_GAIN_SIGMA / 2), max(offset, float(sigma[1]))])

    def cost(logarithms: np.ndarray) -> Expansion:
        return _nats(moved, inliers, np.exp(logarithms))

    far = np.full(2, np.log(1 / MIN_SIGMA_RATIO))
    best = _minimise(cost, start, start - far, start + far)
    return cost(best)[0] * float(inliers.sum()) * step / 2


def _likelihoods(information: Tensor, means: Tensor, sigma: Tensor) -> tuple[Tensor, Tensor, int]:
    """A and s of every n-th element, (aa, ab, bb, s, t), (5, K), its posterior means (2, K), and n."""
    step = max(information.shape[1] // MAX_ELEMENTS, 1)
    # So few that a GPU would be no faster.
    (aa, ab, bb), (x, y), sigma = (each.cpu() for each in (information[:, ::step], means[:, ::step], sigma))
    u, v = torch.where(sigma > 0, sigma.square().reciprocal(), 0.0)
    values = torch.stack((aa, ab, bb, aa * x + ab * y + u * x, ab * x + bb * y + v * y))
    return values, torch.stack((x, y)), step


def _nats(values: Tensor, inliers: Tensor, sigma: np.ndarray) -> Expansion:
    """Expansion of twice the mean negative log posterior in the logarithms of the standard deviations."""
    from deepir.kernels.compile import parallel_for
    from deepir.kernels.normal_equations import negative_log_likelihood

    sums, (u, v) = torch.empty(6, dtype=torch.float64), sigma**2
    parallel_for(negative_log_likelihood, 1, values, inliers, u, v, sums)
    value, *slope, uu, uv, vv = (sums / inliers.sum()).tolist()
    if u > 0:
        value += GAIN_PRIOR_FRACTION * (math.log(u) + TYPICAL_GAIN_SIGMA**2 / u)
        slope[0] += GAIN_PRIOR_FRACTION * (u - TYPICAL_GAIN_SIGMA**2) / u**2
        uu += GAIN_PRIOR_FRACTION * (2 * TYPICAL_GAIN_SIGMA**2 - u) / u**3
    by = 2 * np.array((u, v))  # of the variances by the logarithms
    return value, by * slope, by[:, None] * by * ((uu, uv), (uv, vv)) + np.diag(2 * by * slope)


def _minimise(
    cost: Callable[[np.ndarray], Expansion], start: np.ndarray, low: np.ndarray, high: np.ndarray
) -> np.ndarray:
    """Minimum between bounds by Newton steps; descent along axes of negative curvature."""
    x, (value, slope, curvature) = start, cost(start)
    for _ in range(MAX_NEWTON_STEPS):
        free = ~((x <= low) & (slope > 0) | (x >= high) & (slope < 0))
        if not (free.any() and np.isfinite(curvature).all()):
            break
        sizes, axes = np.linalg.eigh(curvature[free][:, free])
        step = np.zeros_like(x)
        step[free] = -axes @ ((slope[free] @ axes) / np.abs(sizes).clip(min=1e-9))
        trial = (x + step.clip(-MAX_LOG_STEP, MAX_LOG_STEP)).clip(low, high)
        while not (new := cost(trial))[0] <= value and np.abs(trial - x).max() > LOG_STEP_TOLERANCE:
            trial = x + (trial - x) / 4
        if not new[0] <= value:
            break
        last = np.abs(trial - x).max() < LOG_STEP_TOLERANCE
        x, (value, slope, curvature) = trial, new
        if last:
            break
    return x


def _inliers(values: Tensor, u: float, v: float) -> Tensor:
    """Mask of the elements whose posterior means are not outliers of the prior."""
    aa, ab, bb, s, t = values
    system = 1 + u * aa + v * bb + u * v * (aa * bb - ab * ab)
    x, y = (s + v * (bb * s - ab * t)) / system, (t + u * (aa * t - ab * s)) / system
    squares = u * x * x + v * y * y
    return squares <= max(MIN_OUTLIER_SQUARE, MIN_OUTLIER_RATIO * float(squares.median()))


def high_pass(pattern: Tensor, part: GaussianMap) -> Tensor:
    """High-pass filter that keeps the independent values of a part and its variance, and removes smooth scene.

    Of a pattern (..., h, w); the part defines the axes along which to average and to difference.
    """
    own = pattern.mean(part.constant_axes, keepdim=True) if part.constant_axes else pattern
    for axis in {-2, -1} - set(part.constant_axes):
        own = own.diff(dim=axis) / 2**0.5
    return own
