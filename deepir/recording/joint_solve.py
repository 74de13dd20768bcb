"""The offset and gain of a sensor, with scene, motion and levels of registered frames: one linear Gaussian model.

    frame_k = a_k (gain * scene(motion_k) + offset + level_k) + noise

Each round refines the motion, solves the low-order part exactly (`modes`), and the rest of the offset by conjugate
gradients, in which the scene is eliminated. The strengths of all parts are set by expectation maximisation. A part that
the motion does not determine stays at its prior mean, zero.

Small motions that are over-estimated by a factor fit almost as well, with a share of the scene in the offset. But scene
and pattern are independent: each round takes off what they share, until the low-order part has settled.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from operator import methodcaller
from typing import TYPE_CHECKING

import numpy as np
from scipy import linalg

from deepir.arrays import Array
from deepir.arrays.samples import CHI_SQUARED_MEDIAN
from deepir.kernels.compile import parallel_map
from deepir.multiview.pattern_gradients import gradient_consensus
from deepir.recording.burst import Burst
from deepir.recording.modes import LowOrderModes, NormalEquations, PatternPrior, dct, group_power, idct

if TYPE_CHECKING:
    from deepir.recording.displaced import DisplacedFrames


ROUNDS = 8  # of alternating, at most; in the last two the gain is free
SETTLED = 0.02  # change of the low-order part in a round, relative to it, from which these begin
LOW_ORDER_RADIUS = 16.0  # half periods over the longer side, below which modes are solved exactly
#: px, standard deviation of the error of the motion in each round, the last ever after, in proportion to the scene's
#: gradient. After the second, one burst that registers has at most 0.33, and a misfit of 24; 0.5, or 40, are given up.
MOTION_ERRORS = (0.5, 0.25, 0.1)
FREE_MOTION = (3, 3, 8)  # parameters of the motion in these rounds: a turning camera's, then a homography's
#: Share of the noise of a sample that interpolation and uneven weights leave in a pattern that does not move.
INTERPOLATION_NOISE = 0.05
STEPS = 3  # of conjugate gradients in a round
UPDATES = 4  # of the strengths in a round
SHIFT_ERROR = 0.05  # px, standard deviation of the motion once it is refined
MOTION, GAIN = np.s_[1:9], np.s_[9:]  # of the unknowns of a frame, if they are any; its level is the first
#: px, error of the motion, and variance of the misfit in that of the samples, up to which frames register but for near
#: things: walks of stretches 0.09 to 0.25, pans and flights up to 0.28 and 34, drives 0.3 to 1.6 or 43 and more.
MAX_MOTION_ERROR, MAX_MISFIT = 0.3, 40.0
#: Variance of the misfit up to which frames register as a whole: 1.0 to 1.1 hand-held (bench, seeds 0 and 1), 3 to 10
#: in pans among near things, 12 to 28 in walks.
MAX_INFLATION = 5.0
#: Of stretches: misfit from which they will not register (after a round 53 to 209, drives from 383), and deviation of
#: the part of long periods, relative to it, up to which it counts (right 0.01 to 0.16, worse than raw from 0.3).
HOPELESS_MISFIT, MAX_UNCERTAINTY = 300.0, 0.25
GAIN_DEVIATION = 0.003  # of columns' and pixels' gain from one, to start from


@dataclass(frozen=True)
class SensorSolution:
    """Posterior of a sensor.

    Attributes:
        offset: (h, w), frames' units, mean zero.
        gain: (h, w), around one.
        deviation: (h, w), posterior standard deviation of the offset; None where it is not known.
        low_order: part of long periods of the offset, and its posterior variance, (h, w) each.
        uncertainty: posterior standard deviation of the part of long periods, relative to it; inf if most is open.
        motion_error: of the frames, px; inf where they do not register.
        inflation: variance of the misfit at the scale where it is largest, relative to the samples' noise.
        noise: of a sample, frames' units; NaN where it is not known.
    """

    offset: Array
    gain: Array
    deviation: Array | None
    low_order: tuple[Array, Array]
    uncertainty: float
    motion_error: float
    inflation: float
    noise: float

    @property
    def registers(self) -> bool:
        """Whether frames register but for near things."""
        return self.motion_error <= MAX_MOTION_ERROR and self.inflation <= MAX_MISFIT

    @property
    def is_determined(self) -> bool:
        """Whether stretches register, and tell the part of long periods."""
        return self.motion_error <= MAX_MOTION_ERROR and self.uncertainty <= MAX_UNCERTAINTY

    @classmethod
    def of_offset(cls, offset: Array) -> SensorSolution:
        """An offset whose deviation is not known."""
        low_order = offset, np.zeros_like(offset)
        return cls(offset, np.ones_like(offset), None, low_order, np.inf, np.inf, np.inf, np.nan)


def solve_sensor(bursts: Sequence[Burst], low_order: tuple[Array, Array] | None = None) -> SensorSolution:
    """Estimate offset and gain of a sensor.

    Args:
        bursts: each of one scene; their motions, levels and gains are refined in place.
        low_order: part of long periods, and its variance, (h, w) each, found already; None: they are estimated.
    """
    frames = [burst.frames / burst.gains.astype(np.float32)[:, None, None] for burst in bursts]
    start = gradient_consensus(np.concatenate(frames), np.concatenate([burst.usable > 0 for burst in bursts]))
    size, start = start.shape, start.astype(float)
    modes = LowOrderModes(size, LOW_ORDER_RADIUS, slopes=True)
    prior = PatternPrior(dct(start))
    offset = start - modes.synthesise(modes.analyse(start)) + (low_order[0] if low_order else 0.0)
    gain, extrapolated = np.ones(size), np.zeros(size)
    fine = ~modes.low
    fine[0, 0] = False
    broad = prior.start
    last_stage, rounds = len(MOTION_ERRORS) - 1, 1 if low_order else ROUNDS
    gain_round = max(0, rounds - 2)
    for number in range(rounds):
        stage = last_stage if low_order else min(number, last_stage)
        parallel_map(methodcaller("align", offset, gain, FREE_MOTION[stage]), bursts)
        parallel_map(methodcaller("weigh", offset, gain, MOTION_ERRORS[stage], robust=stage > 0), bursts)
        told, found = np.any([burst.tells for burst in bursts], axis=0), dct(offset)
        prior.start = np.where(told, broad, broad[0, 0])
        of_sensor = np.minimum(1, broad / np.maximum(group_power(found, prior.groups), 1e-30))
        offset = idct(np.where(told, found, of_sensor * found))  # the rest stays, without what is the scene's
        if not low_order:
            step, covariance = low_order_step(bursts, modes, prior, offset, gain)
            offset = offset + step
            if stage == last_stage and np.linalg.norm(step) < SETTLED * np.linalg.norm(modes.analyse(offset)):
                gain_round = min(gain_round, number + 1)
        informations, shares = zip(*map(_information, bursts), strict=True)
        information = np.sum(informations, axis=0)
        trusted = [np.where(fine & burst.tells, each, 0.0) for burst, each in zip(bursts, shares, strict=True)]
        offset = _fine_steps(bursts, offset, gain, prior, information, trusted)
        if len(bursts) == 1:
            offset = _without_scene(bursts[0], offset, found, prior, fine)
        posterior = 1 / (information + 1 / prior.variance)
        prior.variance[fine] = prior.strengths(dct(offset), posterior, fine)
        inflation, motion_error = np.mean([(burst.inflation, burst.motion_error) for burst in bursts], axis=0).tolist()
        loose = inflation > MAX_MISFIT or (inflation > MAX_INFLATION and motion_error > MOTION_ERRORS[0])
        if (number > 0 and loose) if len(bursts) == 1 else inflation > HOPELESS_MISFIT:
            return SensorSolution.of_offset(offset)
        if number >= gain_round:
            offset, gain, extrapolated = _with_gain(bursts, offset, gain)
        if number > gain_round:
            break
    left = np.where(told, 0.0, broad + (dct(start) - dct(offset)) ** 2)  # what may be the scene's, or not
    uncertainty = np.inf
    if not low_order:
        uncertainty = (
            float(np.trace(covariance) ** 0.5 / max(np.linalg.norm(modes.analyse(offset)), 1e-30))
            if told[modes.low].mean() > 0.5
            else np.inf
        )
        covariance = covariance + np.diag(modes.variances(left))
        low_order = modes.synthesise(modes.analyse(offset)), _variance(modes, covariance, size)
    fine_variance = (np.where(told, posterior, 0.0) + left)[fine].sum() / posterior.size + extrapolated
    deviation = np.sqrt(low_order[1] + fine_variance)
    return SensorSolution(
        offset - offset.mean(),
        gain,
        deviation,
        low_order,
        uncertainty,
        motion_error,
        inflation,
        float(np.mean([burst.noise for burst in bursts])),
    )


def low_order_step(
    bursts: Sequence[Burst | DisplacedFrames], modes: LowOrderModes, prior: PatternPrior, offset: Array, gain: Array
) -> tuple[Array, Array]:
    """Change the low-order part of an offset to its posterior mean; sets its strengths, and levels and gains of frames.

    Args:
        bursts: that tell it.
        modes: that make up the low-order part.
        prior: of the pattern; the variances of these modes are estimated anew.
        offset, gain: (h, w), what the bursts' frames are corrected by.

    Returns:
        The change (h, w), and the posterior covariance (K, K) of the coefficients of the modes.
    """
    systems = parallel_map(methodcaller("equations", modes, offset, gain), bursts)
    before = modes.analyse(offset)
    for burst in bursts:
        burst.inflation, burst.frame_prior = 1.0, burst.frame_priors[-1]
    free = _fit(bursts, systems, prior, modes, before)  # the misfit that is left with free levels
    for burst, system, own in zip(bursts, systems, free.reduced, strict=True):
        burst.inflation = system.inflation(np.concatenate([free.change, own.of(free.change)]))

    def evidence(burst: Burst | DisplacedFrames) -> list[float]:
        system, found = [systems[bursts.index(burst)]], []
        for each in burst.frame_priors:
            burst.frame_prior = each
            found.append(_fit([burst], system, prior, modes, before).evidence)
        return found

    if len(bursts[0].frame_priors) > 1:
        found = np.array(parallel_map(evidence, bursts))
        if bursts[0].frame_priors[-1].gain_variance:  # one answer for all bursts
            # Where frames do not register, the evidence on levels is too sure: they are free.
            equal = np.where([burst.inflation <= MAX_INFLATION for burst in bursts], found[:, :-1].max(1), found[:, -2])
            found[:, np.s_[:-1] if found[:, -1].sum() > equal.sum() else -1] = -np.inf
        for burst, each in zip(bursts, found, strict=True):
            burst.frame_prior = burst.frame_priors[int(np.argmax(each))]
    best = _fit(bursts, systems, prior, modes, before)
    if len(bursts) > 1 and all(burst.independent for burst in bursts):
        disagreement = _disagreement(best)
        for burst in bursts:
            burst.inflation *= disagreement
        best = _fit(bursts, systems, prior, modes, before)
    for burst, system, own in zip(bursts, systems, best.reduced, strict=True):
        each = own.of(best.change).reshape(-1, system.per_frame)
        burst.levels = burst.levels + each[:, 0]
        gains = burst.gains * (1 + each[:, GAIN].sum(1))
        burst.gains = gains * np.exp(np.log(burst.frame_prior.gains / gains).mean())
    prior.variance[modes.low] = best.variance[: int(modes.low.sum())]
    return modes.synthesise(best.change), best.covariance


@dataclass(frozen=True)
class _Fit:
    """Low-order modes with the variances that suit them."""

    change: Array
    covariance: Array
    variance: Array
    evidence: float
    reduced: list[_Reduced]


def _fit(
    bursts: Sequence[Burst | DisplacedFrames],
    systems: Sequence[NormalEquations],
    prior: PatternPrior,
    modes: LowOrderModes,
    before: Array,
) -> _Fit:
    """Expectation maximisation of the variances, from a broad prior; the evidence is up to a constant."""
    reduced = [_nuisance(burst, system, modes) for burst, system in zip(bursts, systems, strict=True)]
    data = sum(each.matrix for each in reduced)
    own = sum(each.score for each in reduced)
    score = own + data @ before
    count = int(modes.low.sum())
    open_modes = prior.start == prior.start[0, 0]
    variance = modes.variances(np.where(modes.low | open_modes, prior.start, prior.variance))
    for number in range(UPDATES):
        matrix = data + np.diag(1 / variance)
        covariance = np.linalg.inv(matrix)
        mean = covariance @ score
        if number < UPDATES - 1:
            spread = modes.on_modes(np.diag(covariance))
            variance[:count] = prior.strengths(modes.on_modes(mean), spread, modes.low)
    evidence = 0.5 * (score @ mean + np.linalg.slogdet(covariance)[1] - np.log(variance).sum())
    evidence += sum(each.evidence for each in reduced) - own @ before - 0.5 * (before @ data @ before)
    return _Fit(mean - before, covariance, variance, float(evidence), reduced)


def _disagreement(fit: _Fit) -> float:
    """Variance of what single bursts tell of the modes about what all tell, relative to that expected; at least one.

    Source: Birge, "The calculation of errors by the method of least squares", Phys. Rev. 40, 1932.
    """
    found = expected = 0.0
    for each in fit.reduced:
        rest = each.score - each.matrix @ fit.change
        spread = np.linalg.inv(each.matrix + np.diag(1 / fit.variance))
        found += float(rest @ spread @ rest)
        expected += float((spread * each.matrix).sum())
    return max(1.0, found / max(expected * (1 - 1 / len(fit.reduced)), 1e-30))


@dataclass(frozen=True)
class _Reduced:
    """Normal equations of the modes, unknowns of the frames eliminated; `of` gives these back for a change of modes."""

    matrix: Array
    score: Array
    of: Callable[[Array], Array]
    evidence: float


def _nuisance(burst: Burst | DisplacedFrames, system: NormalEquations, modes: LowOrderModes) -> _Reduced:
    """Eliminate the unknowns of the frames, whose priors are about what they are so far, and errors they share."""
    count, common_error = modes.count, modes.variances(burst.common_error)
    matrix, score = system.matrix / burst.inflation, system.score / burst.inflation
    prior = _frame_prior(burst, system.per_frame)
    of_frames = np.zeros((len(burst.levels), system.per_frame))
    of_frames[:, 0] = burst.levels
    of_frames[:, GAIN] = (1 - burst.frame_prior.gains / burst.gains)[:, None]
    known = of_frames.ravel()
    factor = linalg.cho_factor(matrix[count:, count:] + prior)
    cross, rest = matrix[count:, :count], score[count:] - prior @ known
    free, tied = linalg.cho_solve(factor, rest), linalg.cho_solve(factor, cross)
    evidence = 0.5 * (rest @ free - known @ prior @ known + np.linalg.slogdet(prior)[1])
    evidence -= np.log(np.diag(factor[0])).sum()
    matrix, score = matrix[:count, :count] - cross.T @ tied, score[:count] - cross.T @ free
    # What the frames show is the modes and the common error.
    widening = np.eye(count) + matrix * common_error
    matrix, own = np.linalg.solve(widening, matrix), np.linalg.solve(widening, score)
    evidence += 0.5 * (score @ (common_error * own) - np.linalg.slogdet(widening)[1])

    def of(change: Array) -> Array:
        shown = common_error * own + np.linalg.solve(widening.T, change)
        return np.asarray(free - tied @ shown)

    return _Reduced((matrix + matrix.T) / 2, own, of, float(evidence))


def _frame_prior(burst: Burst | DisplacedFrames, per_frame: int) -> Array:
    """Inverse covariance of the frames' unknowns: levels drift, motions are known."""
    count, level_variance = len(burst.levels), burst.frame_prior.level_variance
    steps = np.diff(np.eye(count), axis=0)
    diagonal = np.zeros(count * per_frame)
    each = diagonal.reshape(count, per_frame)
    each[:, 0] = 1 / (100 * burst.noise**2 + 1e4 * level_variance)
    each[:, MOTION] = 1 / SHIFT_ERROR**2
    each[:, GAIN] = 1 / max(burst.frame_prior.gain_variance, float(np.finfo(np.float32).eps))
    prior = np.diag(diagonal)
    prior[::per_frame, ::per_frame] += steps.T @ steps / level_variance
    return prior


def _information(burst: Burst) -> tuple[Array, Array]:
    """Inverse variance (h, w) that the data give each mode of the offset, without its neighbours: a preconditioner.

    Second, the share (h, w) of the data's weight that errors leave which all frames have in common: those of the
    motion, and of interpolation where modes hardly move.
    """
    weight = float(burst.weights.sum(0).mean()) / burst.inflation * burst.phase_change
    share = 1 / (1 + weight * burst.common_error + INTERPOLATION_NOISE / burst.phase_change)
    return weight * share, share


def _fine_steps(
    bursts: Sequence[Burst],
    offset: Array,
    gain: Array,
    prior: PatternPrior,
    information: Array,
    trusted: Sequence[Array],
) -> Array:
    """The offset after steps of conjugate gradients in its modes outside the low-order part."""
    free = np.any([each > 0 for each in trusted], axis=0)
    inverse = np.where(free, 1 / prior.variance, 0.0)
    precondition = np.where(free, 1 / (information + 1 / prior.variance), 0.0)

    def data(frames: Iterable[Array]) -> Array:
        shown = zip(bursts, trusted, frames, strict=True)
        return np.sum(parallel_map(lambda each: each[1] * dct(each[0].score(each[2]) / gain), list(shown)), axis=0)

    def normal(modes: Array) -> Array:
        frames = (idct(modes) / gain).astype(np.float32)[None]
        return data([frames] * len(bursts)) + inverse * modes

    modes = dct(offset)
    rest = data(burst.corrected(offset, gain) for burst in bursts) - inverse * modes
    return np.asarray(idct(modes + _conjugate_gradient(normal, rest, precondition)))


def _without_scene(burst: Burst, offset: Array, before: Array, prior: PatternPrior, fine: Array) -> Array:
    """The offset (h, w) less the scene in its `fine` modes; `before`: its modes when the scene was found.

    Estimates of independent scene and pattern are correlated by a share of the scene in the offset, in proportion to
    the scene's power, or of the pattern in the scene, to the pattern's. Modes that the motion shifts by much have none.
    """
    free, modes = fine & burst.tells, dct(offset)
    scene, stays, variance = (
        each[free] for each in (burst.scene_modes + before - modes, 1 - burst.phase_change, prior.variance)
    )
    power = np.maximum(burst.scene_power[free], 1e-6 * variance)
    ratio, product = np.sqrt(power / variance), modes[free] * scene / np.sqrt(power * variance)
    share, _ = np.linalg.lstsq((stays * np.stack([ratio, 1 / ratio])).T, product)[0]
    modes[free] -= share * stays * scene
    return idct(modes)


def _conjugate_gradient(normal: Callable[[Array], Array], rest: Array, precondition: Array) -> Array:
    """A few preconditioned steps; exact line searches, as interpolation leaves the operator a little asymmetric."""
    found, direction, before, last = np.zeros_like(rest), np.zeros_like(rest), rest, 1.0
    for number in range(STEPS):
        step = precondition * rest
        now = float((step * rest).sum())
        turn = max(0.0, float((step * (rest - before)).sum()) / last) if number else 0.0
        direction = step + turn * direction
        image = normal(direction)
        curvature, slope = float((direction * image).sum()), float((direction * rest).sum())
        if not (curvature > 0 and slope > 0):
            break
        found = found + slope / curvature * direction
        before, last, rest = rest, now, rest - slope / curvature * image
    return found


def _with_gain(bursts: Sequence[Burst], offset: Array, gain: Array) -> tuple[Array, Array, Array]:
    """Offset and gain after a step by the slope of each pixel's residuals over the scene that it saw.

    Third, the variance (h, w) that the gain's adds to the offset's: a pixel that saw other levels extrapolates.

    The gain is one, a share of the offset, a part of each column, and one of each pixel; the share and the variances
    are those that suit the data.
    """
    sums = np.zeros((5, *offset.shape))
    for burst in bursts:
        frames, seen = burst.compared(offset, gain)
        weighted, missing = burst.weights / burst.inflation, frames - seen
        sums += [(weighted * each).sum(0, dtype=float) for each in (1.0, seen, seen**2, missing, missing * seen)]
    weight, first, second, rest, slope = sums
    middle = first / np.maximum(weight, np.finfo(float).tiny)
    information = np.maximum(second - first * middle, 0.0)
    score = slope - rest * middle + information * (gain - 1)
    shared = _share_of_offset(offset, information, score)
    score = score - information * shared
    of_columns = of_pixels = GAIN_DEVIATION**2
    for _ in range(UPDATES):
        spread = 1 / ((information / (1 + information * of_pixels)).sum(0) + 1 / of_columns)
        columns = spread * (score / (1 + information * of_pixels)).sum(0)
        left = 1 / (information + 1 / of_pixels)
        pixels = left * (score - information * columns)
        # Robust: at edges errors of the motion look like gain.
        of_columns = float(np.median(columns**2 + spread)) / CHI_SQUARED_MEDIAN
        of_pixels = float(np.median(pixels**2 + left)) / CHI_SQUARED_MEDIAN
    change = (1 + shared + columns + pixels) / gain - 1
    return offset - gain * change * middle, gain * (1 + change), middle**2 * (left + spread)


def _share_of_offset(offset: Array, information: Array, score: Array) -> Array:
    """The part of the gain (h, w) in proportion to the offset: far from a camera's zero, gain makes most of it."""
    pattern = offset - offset.mean()
    power = float((information * pattern**2).sum())
    if not power > 0:
        return np.zeros_like(offset)
    slope = float((score * pattern).sum()) / power
    return slope * max(0.0, 1 - 1 / max(slope**2 * power, 1e-30)) * pattern


def _variance(modes: LowOrderModes, covariance: Array, size: Sequence[int]) -> Array:
    """Posterior variance (h, w) of the low-order part of the offset."""
    y, x = (np.arange(side, dtype=float) for side in size)
    low = np.empty(tuple(size))
    for i, row in enumerate(y):
        values = modes.at(np.full(len(x), row), x)
        low[i] = np.einsum("pk,pk->p", values @ covariance, values)
    return np.maximum(low, 0)
