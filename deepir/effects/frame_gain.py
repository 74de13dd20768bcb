"""Gains and levels of whole frames: of a gain control (AGC), of exposures that differ, of a camera that drifts."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import torch
from torch import Tensor

from deepir.arrays.statistics import masked_values, median_sigma, subsample
from deepir.effects.effect import Effect, Rounds
from deepir.estimation.low_order_evidence import GainOffsetEvidence, frame_level_offsets
from deepir.estimation.residuals import fixed_pattern_residual, temporal_mean
from deepir.fields.drift import Drift
from deepir.fields.line_noise import LineNoise
from deepir.messages import Message
from deepir.problem import Problem
from deepir.registry import register
from deepir.schedule import Schedule

#: Degree of the low-order part of a frame, which shading has too, and of a block.
FRAME_DEGREE, BLOCK_DEGREE = 4, 2
MAX_CONTRAST = 3.0  # ratio of an AGC frame's gain to the mean, either way, at most
#: Least deviation of such gains that the initial estimate corrects, and largest that is called equal after a round.
START_CONTRAST, EQUAL_CONTRAST = 0.02, 0.002
#: Deviation of gains that is reported: of AGC frames, of others.
REPORTED_AGC, REPORTED_DRIFT = 0.02, 0.001
#: Blocks along each axis of a frame, and samples of a frame that are used.
GRID, MAX_SAMPLES = 3, 40_000
#: Standard errors by which the blocks' gains differ from frame to frame if the response drifts. A camera that does not
#: drift has 5.6 at most, mostly 1 to 3.
MIN_DEVIATION = 6.0
MIN_AGREED_DEVIATION = 2.0  # the same, where the frames' levels say so, too
MIN_DRIFT = 2e-4  # relative change of the gain that is a drift
MIN_BLOCKS = 2  # effective number of blocks, less one
#: Relative deviation of a frame's level and contrast, and of its contrast alone, from which frames have exposures of
#: their own: a strong pattern that is not found yet makes contrasts differ by 0.04.
MIN_EXPOSURE, MIN_CONTRAST = 0.03, 0.1
#: Difference of exposures by level and by contrast, over their deviation from one, up to which they agree.
MAX_DISAGREEMENT = 0.5
EXPOSURE_TOLERANCE = 1e-4  # relative change of exposures that ends the turns
#: Level of a frame, in standard deviations of a sample's noise, that is reported as a drift: 0.1 where all is modelled.
REPORTED_LEVEL = 0.25
CHANCE_DRIFT = 4.0  # the same, in standard deviations of the mean of lines that jump independently
START_LEVEL = 2.0  # level, in standard deviations of what the average leaves, that the initial estimate corrects


@register("effect", "frame_gain")
@dataclass(frozen=True)
class FrameGain(Effect):
    """The gain of each frame, as an automatic gain control sets it."""

    def equalise(self, problem: Problem) -> bool:
        return normalise_frame_gain(problem, START_CONTRAST)

    def update(self, problem: Problem, *, settled: bool) -> bool:
        normalise_frame_gain(problem)
        return False

    def finish(self, problem: Problem) -> None:
        normalise_frame_gain(problem)

    def messages(self, problem: Problem, *, complete: bool) -> Iterator[str]:
        apart = float((problem.contrast / problem.contrast.mean() - 1).abs().max())
        if not (complete and apart >= (REPORTED_AGC if problem.agc else REPORTED_DRIFT)):
            return
        if problem.agc:
            yield Message(
                "contrast-varies",
                f"the contrast of the frames differs by up to {apart:.0%}, as an automatic gain makes it: it is "
                "evened out. Record with a fixed gain, 14 or 16 bits, to measure",
            )
        else:
            yield Message(
                "response-drift",
                f"the camera's response drifts, by up to {apart:.1%} from frame to frame: it is evened out",
            )


@torch.no_grad()
def normalise_frame_gain(problem: Problem, least: float = 0.0) -> bool:
    """Divide AGC frames by their gains, of mean one, estimated by regression on the prediction; whether any was.

    Once a round has found all gains equal, none is. In the initial estimate gains that all deviate by less than `least`
    are left; the fixed pattern, which is not in the prediction yet, is added to it.
    """
    if not problem.agc or problem.gains_are_equal:
        return False
    expected = problem.predict(problem.values())
    if least:
        expected = expected + temporal_mean(fixed_pattern_residual(problem), problem.precision.sign())
    frames = zip(problem.data, expected, problem.precision, strict=True)
    contrast = torch.cat([contrast_slopes(*each, FRAME_DEGREE)[0] for each in frames])
    contrast = (contrast / contrast.mean()).clamp(1 / MAX_CONTRAST, MAX_CONTRAST)
    if not (contrast - 1).abs().max() > least:
        return False
    whole = contrast * problem.contrast.flatten()
    if not least and (whole / whole.mean() - 1).abs().max() < EQUAL_CONTRAST:
        contrast = 1 / problem.contrast.flatten()
        problem.gains_are_equal.fill_(True)
    problem.divide_frames(contrast)
    return True


def contrast_slopes(frames: Tensor, expected: Tensor, weight: Tensor, degree: int) -> tuple[Tensor, Tensor]:
    """Least-squares slopes of frames (N, h, w) on their prediction, low-order parts aside; and their information."""
    y, x = (torch.linspace(-1, 1, side).to(frames).double() for side in frames.shape[1:])
    low_order = torch.stack([(y**i)[:, None] * x**j for i in range(degree + 1) for j in range(degree + 1 - i)])
    design = torch.cat((expected[:, None].double(), low_order.expand(len(frames), -1, -1, -1)), 1).flatten(2)
    weighted = design * weight.double().flatten(1)[:, None]
    normal = weighted @ design.mT
    normal.diagonal(dim1=1, dim2=2).mul_(1 + 1e-9)
    inverse, failed = torch.linalg.inv_ex(normal)
    slope = (inverse @ (weighted @ frames.double().flatten(1)[..., None]))[:, 0, 0]
    known = (failed == 0) & (inverse[:, 0, 0] > 0)
    return slope.where(known, 1.0), (1 / inverse[:, 0, 0]).where(known, 0.0)


@register("effect", "gain_drift")
@dataclass(frozen=True)
class GainDrift(Effect):
    """A response that drifts from frame to frame, as a camera that warms up has it; or exposures that differ."""

    @torch.no_grad()
    def equalise(self, problem: Problem) -> bool:
        """Divide frames by their exposures where these differ.

        The fixed pattern, which is not in the prediction yet, is added to it. An exposure acts on all of the signal:
        where level and contrast of the frames agree on it, they are divided about zero, which leaves no levels to be
        found.
        """
        if len(problem.data) < 2 or problem.agc:
            return False
        pattern = temporal_mean(fixed_pattern_residual(problem), problem.precision.sign())
        expected, zero = problem.predict(problem.values()) + pattern, -float(problem.reference)
        levels = frame_level_offsets(problem)
        exposures = _exposures(problem, expected - levels, zero)
        if has_exposures(problem):  # of the turn before
            again = not levels.any() and (exposures - 1).abs().max() > EXPOSURE_TOLERANCE
            if again:
                problem.divide_frames(exposures, zero)
            return bool(again)
        gains, deviation = _frame_gains(problem, expected)
        if (exposures - gains).norm() > MAX_DISAGREEMENT * (gains - 1).norm():
            differ = deviation > MIN_DEVIATION and bool((gains - 1).abs().max() > MIN_CONTRAST)
            if differ:
                problem.divide_frames(gains)
            return differ
        if deviation < MIN_AGREED_DEVIATION or not (exposures - 1).abs().max() > MIN_EXPOSURE:
            return False
        problem.divide_frames(exposures, zero)
        for each in problem.modules():
            if isinstance(each, Drift):
                each.level_offsets.zero_()
        return True

    def plan(self, problem: Problem, schedule: Schedule, rounds: Rounds) -> Schedule:
        def corrected(then: Callable[[Problem], None], problem: Problem) -> None:
            correct_gain_drift(problem)
            then(problem)

        last = schedule("sensor 3")
        prepared = (partial(corrected, then) for then in (rounds.restart, rounds.update, rounds.update))
        stages = (
            replace(last, name=f"response {i}", needed=detect_gain_drift, prepare=prepare)
            for i, prepare in enumerate(prepared, 1)
        )
        return schedule.after(last.name, *stages)


def has_exposures(problem: Problem) -> bool:
    """Whether frames were divided by exposures that differ."""
    return not problem.agc and bool((problem.contrast - 1).abs().max() > MIN_EXPOSURE)


def _exposures(problem: Problem, expected: Tensor, zero: float) -> Tensor:
    """Factors between the frames and their prediction, (N,), of mean one: slopes of a regression through `zero`."""
    shown = expected - zero
    weighted = (shown * problem.precision.sign()).double()
    found = (weighted * (problem.data - zero)).sum((1, 2, 3)) / (weighted * shown).sum((1, 2, 3))
    return found / found.mean()


@torch.no_grad()
def detect_gain_drift(problem: Problem) -> bool:
    """Whether the gain drifts from frame to frame; valid where scene and pattern have converged."""
    if problem.agc:
        return False
    gains, deviation = _frame_gains(problem, problem.predict(problem.values()))
    return deviation > MIN_DEVIATION and bool((gains - 1).abs().max() > MIN_DRIFT)


@torch.no_grad()
def correct_gain_drift(problem: Problem) -> None:
    """Divide the frames by the estimated gains."""
    problem.divide_frames(GainOffsetEvidence(problem, frame_gains=True).frame_gains())


def _frame_gains(problem: Problem, expected: Tensor) -> tuple[Tensor, float]:
    """Gains of the frames, (N,), of mean one, and their deviation from one in standard errors over the blocks.

    Each block's gains are its slopes on the prediction. The deviation is zero where few blocks count. A moving object
    is in one block or two.
    """
    h, w = problem.data.shape[-2:]
    step = max(round((h * w / MAX_SAMPLES) ** 0.5), 1)
    rows, columns = ([slice(side * i // GRID, side * (i + 1) // GRID, step) for i in range(GRID)] for side in (h, w))
    given = problem.data, expected, problem.precision
    parts = [[each[:, 0, y, x] for each in given] for y in rows for x in columns]
    blocks = [contrast_slopes(frames, shown, weight, BLOCK_DEGREE) for frames, shown, weight in parts]
    slopes, information = (torch.stack(each, 1) for each in zip(*blocks, strict=True))
    weights = information.mean(0)
    each = slopes / slopes.mean(0) - 1
    found = (weights * each).sum(1) / weights.sum()
    spread = (weights * (each - found[:, None]).square()).sum(1) / weights.sum()
    free = weights.sum().square() / weights.square().sum() - 1  # of as many blocks as count
    apart = (found.square() * free / spread).mean().sqrt()
    return 1 + found, float(apart) if free > MIN_BLOCKS else 0.0


@torch.no_grad()
def frame_levels(problem: Problem) -> tuple[Tensor, float]:
    """Levels of the frames above their prediction, by medians, mean zero, (N, 1, 1, 1); the deviation of the rest."""
    data, precision, expected = subsample(problem.data, problem.precision, problem.predict(problem.values()))
    rest, known = data - expected, precision > 0
    level = rest.where(known, torch.nan).nanmedian(1, keepdim=True).values.nan_to_num()
    level -= level.mean()
    return level[..., None, None], float(masked_values(rest - level, known).std())


@register("effect", "frame_offset")
@dataclass(frozen=True)
class FrameOffset(Effect):
    """The level of each frame, where it stands out of all that the average of the frames leaves."""

    @torch.no_grad()
    def equalise(self, problem: Problem) -> bool:
        """Add levels that exceed `START_LEVEL` residual standard deviations to the known drift.

        Levels that differ much between frames leave the borders of the frames as edges in their registered average.
        """
        name = problem.sensor_unknowns().get("level", "")
        fields = problem.fields[name].modules() if name in problem.free() else ()
        drift = next((each for each in fields if isinstance(each, Drift) and not each.sigma_is_fixed), None)
        if drift is None:
            return False
        level, spread = frame_levels(problem)
        if not float(level.abs().max()) > START_LEVEL * spread:
            return False
        drift.level_offsets.add_(level)
        return True

    def messages(self, problem: Problem, *, complete: bool) -> Iterator[str]:
        """Say so if the frames' levels drift, whether the problem knows it or not."""
        least = REPORTED_LEVEL * median_sigma(problem.precision)
        name = problem.sensor_unknowns().get("level", "")
        if not (complete and name):
            return
        if name in problem.free():
            found = problem.fields[name]().detach().mean((1, 2, 3))
            chance = sum(each.frame_mean_variance for each in problem.modules() if isinstance(each, LineNoise))
            if float((found - found.mean()).abs().max()) > least + CHANCE_DRIFT * chance**0.5:
                yield Message(
                    "level-drift",
                    f"the level of whole frames drifts, by {found.std():.3g}: "
                    "a slope across the scene is separated from that only in part",
                )
        elif (drift := float(frame_levels(problem)[0].abs().max())) >= least:
            yield Message(
                "level-drift-ignored",
                f"the level of whole frames drifts, by {drift:.3g} or more: estimate it, with "
                "physics.sensor.level=drift",
            )
