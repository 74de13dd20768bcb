"""Super-resolution."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from deepir.estimation.cross_validation import WeightSearch
from deepir.estimation.prior_weight import weigh_scene
from deepir.messages import Message
from deepir.operators.downsample import Downsample, in_words
from deepir.optim.objective import hold_out
from deepir.problem import Problem
from deepir.problems.initial_estimate import initial_estimate
from deepir.problems.recipe import Recipe
from deepir.registry import register
from deepir.schedule import Schedule, Stage, Step


@register("problem", "sr")
class SR(Recipe):
    """A scene finer than the detector, gain, offset and motion from a jittered burst.

    As in `nuc`, the sensor is estimated under a weak prior on the scene. The motion is not: with few frames a
    scene so free explains any motion. How strong the prior is to be, held-out samples say.
    """

    frames = 2
    motion = True
    sensor_weight = 0.2
    operators = ("warp", "downsample", "sensor")
    effect_names = (
        *("saturation", "bad_pixels", "frame_gain", "frame_offset", "line_noise", "noise"),
        *("sensor_pattern", "outliers", "reference_level"),
    )
    search = WeightSearch()
    weigh = staticmethod(search.weigh)

    def weigh_prior(self, problem: Problem) -> None:
        """By the noise: cross-validation was of another prior."""
        weigh_scene(problem)

    def initialise(self, problem: Problem, seed: int) -> None:
        """Noise and patterns as the raw frames show them; scene: registered average."""
        initial_estimate(problem, self.effects)
        hold_out(problem, seed)
        weigh_scene(problem, self.sensor_weight)
        self.search.start(problem)
        stages = [stage for _, stage in problem.operator.named() if isinstance(stage, Downsample)]
        self.messages = few_frames(len(problem.data), np.prod([(1, 1), *(stage.factor for stage in stages)], axis=0))

    def plan(self, problem: Problem) -> Schedule:
        """Sensor and motion by turns, with the search for the scene's weights between; the scene on all samples."""
        (free, eliminate), motion = self.split(problem), problem.motion_unknown()
        sensor = (Step(tuple(name for name in free if name != motion)), *eliminate)
        moving = (Step(tuple(name for name in ("scene", motion) if name in free)),)
        stages = [
            Stage("sensor 1", sensor, 40),
            Stage("sensor 2", sensor, 40, prepare=self.first_update),
            Stage("motion 1", moving, 20, prepare=self.weigh),
            Stage("sensor 3", sensor, 25, prepare=self.update),
            *self.search.stages(problem),
            Stage("motion 2", moving, 20, prepare=self.weigh),
            Stage("sensor 4", sensor, 25, prepare=self.update),
            Stage("scene", (Step(("scene",)),), 40, prepare=self.finish, use_held_out=True),
        ]
        return Schedule(stages)


def few_frames(count: int, factor: Sequence[float]) -> list[str]:
    """A line if the frames have fewer samples than the scene, finer by a factor down and across, has pixels."""
    finer = math.prod(factor)
    if count >= finer:
        return []
    needed, less = math.ceil(finer), math.isqrt(count)
    return [
        Message(
            "few-frames-for-factor",
            f"{count} frames for factor {in_words(factor)}: the scene has {finer:g} px for each of the detector's, and "
            "each frame shows one sample of them; fine detail is in part the prior's. "
            f"Take {needed} frames{f', or physics.downsample.factor={less}' if less > 1 else ''}",
        )
    ]
