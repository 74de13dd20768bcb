"""What a problem definition is, and the generic one: a problem that is a YAML file only."""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor

from deepir.arrays.fill import nearest_filled
from deepir.arrays.median import robust_std
from deepir.arrays.noise_level import ROUNDED, median_sigma, quantisation_step, sample_noise
from deepir.arrays.subsample import masked_values, subsample
from deepir.effects.bad_pixels import mask_dead_pixels, static_pixels
from deepir.effects.frame_gain import GROSS, normalise_frame_gain
from deepir.effects.frame_offset import start_line_levels
from deepir.effects.saturation import mask_stuck_pixels
from deepir.effects.sensor_pattern import start_parts
from deepir.effects.shading import estimate_low_order
from deepir.estimation.penalty_weights import weigh_scene
from deepir.estimation.residuals import down_weight_outliers, fixed_pattern_residual, temporal_mean
from deepir.optim.low_order_model import polynomials
from deepir.problem import Problem
from deepir.registered_average import RegisteredAverage
from deepir.registry import register
from deepir.schedule import Stage, Step

TURNS = 3  # of the scene's start and the samples' weights
PASSES = 20  # over scene and pattern, at most
SETTLED = 1.0  # of the noise: a change of the pattern that is little
SEEN = 0.1  # frames that must show a pixel of the scene, for it to be known


class Definition:
    """How a problem is initialised, planned and reported; `frames` is the least number that it needs."""

    frames: ClassVar[int] = 1
    messages: tuple[str, ...] | list[str] = ()
    #: Whether it cannot work without motion between the frames.
    motion: ClassVar[bool] = False
    #: Whether frames follow each other in time, so that none may be missing in between.
    ordered: ClassVar[bool] = False
    #: Whether gain and offset correct the frames as they are, so that frames beside the burst can judge them.
    judged: ClassVar[bool] = False
    #: Weight of the scene's penalties while the sensor's pattern is found, to that of the scene's own stage.
    weak: ClassVar[float] = 1.0
    #: Operators that the physics must have.
    operators: ClassVar[tuple[str, ...]] = ()

    @staticmethod
    def weigh(problem: Problem) -> None:
        """Set the weights of the scene's penalties at their full strength; of a prior that is fitted last, too."""
        weigh_scene(problem)

    def initialise(self, problem: Problem, seed: int) -> None:
        """Set starts and strengths from the data."""
        start_precision(problem)
        start_scene_and_parts(problem)
        estimate_low_order(problem, start=True)
        weigh_scene(problem)

    def plan(self, problem: Problem) -> list[Stage]:
        """The stages of the solve."""
        closed = problem.closed_form()
        free = tuple(name for name in problem.free() if name not in closed)
        steps = (Step(free, "lbfgs"), *((Step(tuple(closed), "eliminate"),) if closed else ()))
        return [Stage("joint", steps, iterations=200)]

    def figures(self, problem: Problem) -> dict[str, float]:
        """What `metrics.json` is to hold of the problem once it is solved."""
        return {}

    def remarks(self, problem: Problem) -> list[str]:
        """What is to be said of the problem once it is solved."""
        return list(self.messages)


@register("problem", "generic")
class Generic(Definition):
    """Any operator and any unknowns: all are moved together; gain and offset in closed form where they have one."""


def start_precision(problem: Problem) -> None:
    """Set the precision of usable samples to 1 / variance of the noise that the frames show, if none is given."""
    if problem.noise is not None:
        return
    usable = problem.precision > 0
    sigma = sample_noise(problem.data[:, 0], usable[:, 0])
    data, counts = subsample(problem.data, usable)
    robust_std = float(masked_values(data, counts).std())
    rounded = ROUNDED * quantisation_step(
        problem.data, usable
    )  # in a plain scene differences may be all zero
    # Noiseless data: a solve still wants finite weights.
    sigma = max(sigma, rounded, 1e-4 * robust_std)
    problem.precision.copy_(usable / sigma**2)


def start_scene_and_parts(problem: Problem) -> None:
    """Start the scene, first strengths of the sensor's parts, and the weights of samples that show something else.

    Scene and weights by turns: in an average, who walks through two frames of five is half as far off as he is from
    what the others show.
    """
    noise = median_sigma(problem.precision)
    calm = static_pixels(problem.data, problem.precision > 0, noise)
    start_scene(problem)
    mask_stuck_pixels(problem)
    if problem.stretched:  # contrasts are told by least squares, and not by who walks by
        down_weight_outliers(problem, fixed_pattern_residual(problem))
        start_scene(problem)
    mask_dead_pixels(problem, fixed_pattern_residual(problem), noise, calm)
    start_scene(problem)
    for _ in range(TURNS):
        uneven = normalise_frame_gain(problem, GROSS)
        if not start_line_levels(problem) and not uneven:
            break
        start_scene(problem)
    rest = fixed_pattern_residual(problem)
    start_parts(problem, rest)
    fixed = len(problem.data) > 1 and bool(problem.closed_form())
    strong = fixed and pattern_is_strong(problem, rest)
    taken = torch.zeros_like(rest[:1])
    if strong:
        rest = take_pattern_out(problem, rest, taken, noise, strong=True)
    down_weight_outliers(problem, rest)
    for _ in range(TURNS):
        if strong or (fixed and problem.ends is None):  # what is cut off moves, and is no pattern
            rest = take_pattern_out(problem, rest, taken, noise, strong=strong)
        else:
            start_scene(problem)
            rest = fixed_pattern_residual(problem)
        mask_dead_pixels(problem, rest, noise, calm)
        down_weight_outliers(problem, rest)
    if problem.ends is not None:  # what is given up for its other samples is no bound either
        problem.ends.mul_((problem.precision > 0) | (problem.ends != 0).all(0))


@torch.no_grad()
def pattern_is_strong(problem: Problem, rest: Tensor) -> bool:
    """Whether what stands still is stronger than all that is in the average of the frames."""
    scene, weight = problem.backproject(problem.values())
    pattern = temporal_mean(rest, problem.precision.sign())
    # By the standard deviation: before a black sky the bulk has next to none.
    return robust_std(pattern) > float(scene[weight > SEEN * weight.max()].std())


@torch.no_grad()
def take_pattern_out(problem: Problem, rest: Tensor, taken: Tensor, noise: float, *, strong: bool) -> Tensor:
    """Take out of the scene's start what stands still: the pattern, of frames' `rest`, and the scene by turns.

    A pattern many times stronger than the scene is else all that there is in the average, and no solve gets away from
    there. Of others one turn takes most, so that what changes in a pixel is the scene: beside a smeared pattern a plain
    scene's changes look like noise, which gains that are too small explain. But not what is slow of it: that is the
    scene's, unless shading is found.

    Returned is the new `rest`; `taken` (1, 1, h, w), the pattern that was taken out before, is updated.
    """
    average, weight = (
        RegisteredAverage(problem, problem.values()),
        problem.precision / problem.precision.amax(),
    )
    for _ in range(PASSES if strong else 1):
        pattern = temporal_mean(rest, weight)
        if not strong:
            slow = polynomials(*pattern.shape[-2:], pattern.device)
            pattern -= slow.nearest(pattern.double()).to(pattern)
        change = robust_std(pattern - taken)
        taken.copy_(pattern)
        start_scene(problem, average, pattern)
        rest = fixed_pattern_residual(problem, average)
        if change < SETTLED * noise:
            break
    return rest


@torch.no_grad()
def start_scene(
    problem: Problem, average: RegisteredAverage | None = None, pattern: Tensor | float = 0.0
) -> None:
    """Start the scene at the registered average of the frames; what no frame sees is like its nearest neighbour.

    `average` spares its computation where it is known; `pattern`, in every frame, is no scene.
    """
    average = average or RegisteredAverage(problem, problem.values())
    mean = average((problem.data - average.at_zero).sub_(pattern))
    frames = len(problem.data) / len(mean)  # that show a scene
    known = average.weight > SEEN * average.weight.max() / frames
    problem.fields["scene"].init_from(nearest_filled(mean, known))
