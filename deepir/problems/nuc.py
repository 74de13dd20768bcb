"""Non-uniformity correction: of one burst, and of several of one sensor."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import torch

from deepir.diagnostics.fit import misses_bending
from deepir.estimation.prior_weight import adapt_weight_map, pattern_cost_db, store_reference_misfit
from deepir.fields.motion import Auto
from deepir.optim.fourier_hessian import has_fourier_model
from deepir.optim.objective import hold_out
from deepir.optim.solve import solve
from deepir.problem import Problem
from deepir.problems.recipe import Recipe, each_by_itself
from deepir.registration.motion_search import MIN_FRAMES
from deepir.registry import register
from deepir.schedule import Schedule, Stage, Step

ROUND_TOLERANCE = 2e-3  # nats per sample that ten iterations gain, in the first rounds
LAST_TOLERANCE = 3e-4  # the same in the last round
SCENE_TOLERANCE = 0.1  # the same in the scene's own stage, per scene pixel
#: Of the first rounds, the last round and the scene: with a Fourier model of the Hessian, and without.
ITERATIONS = {True: (30, 60, 30), False: (25, 30, 35)}


@register("problem", "nuc")
class NUC(Recipe):
    """Scene, gain, offset and motion from a burst of a moving camera.

    Three rounds estimate the sensor under a twentieth of the scene's prior: at full weight the joint optimum is biased,
    for contrast of the scene leaks into the gain. Then the scene is estimated, the sensor fixed, from all samples.
    After the first round, frames whose residuals show that they bend are given homographies for their rigid motion.
    """

    frames = 2
    judged = True
    motion = True
    sensor_weight = 0.05
    operators: ClassVar[tuple[str, ...]] = ("warp", "sensor")
    effect_names: ClassVar[tuple[str, ...]] = (
        *("saturation", "bad_pixels", "frame_gain", "frame_offset", "line_noise", "noise"),
        *("sensor_pattern", "shading", "outliers", "unobserved", "moving_objects", "reference_level"),
        *("gain_drift", "vignetting"),
    )

    def initialise(self, problem: Problem, seed: int) -> None:
        """Noise and pattern of the raw frames; scene: registered average."""
        self.start(problem)
        found = [effect.detect(problem) for effect in self.effects]
        if any(found):
            self.restart(problem)
        hold_out(problem, seed)

    def plan(self, problem: Any) -> Schedule:
        """Three rounds for the sensor, those that effects ask for, and the scene on all samples."""
        free, eliminate = self.split(problem)
        fourier = all(map(has_fourier_model, problem.data_sets))
        frames = min(len(each.data) for each in problem.data_sets)
        short, long, last = ITERATIONS[fourier]
        rough, fine, scene = (ROUND_TOLERANCE, LAST_TOLERANCE, SCENE_TOLERANCE / frames) if fourier else (1e-5,) * 3
        steps, alone = (Step(free), *eliminate), (Step(tuple(problem.scenes)),)
        waiting = self.waiting(problem)
        first = (Step(tuple(name for name in free if name not in waiting)), *eliminate)
        schedule = Schedule(
            [
                Stage("sensor 1", first, short, tolerance=rough),
                Stage(
                    "homography",
                    steps,
                    short,
                    tolerance=rough,
                    needed=lambda problem: any(misses_bending(each) for each, _ in _rigid(problem)),
                    change=_bend,
                ),
                Stage("sensor 2", steps, short, prepare=self.first_update, tolerance=rough),
                Stage("sensor 3", steps, long, prepare=self.update, tolerance=fine),
                Stage("scene", alone, last, prepare=self.finish, use_held_out=True, tolerance=scene),
            ]
        )
        for effect in self.effects:
            schedule = effect.plan(problem, schedule, self)
        return schedule

    def waiting(self, problem: Any) -> Sequence[str]:
        """Unknowns that are fixed in the first round: the motion where samples are cut off, whose bounds it finds."""
        cut_off = (each for each in problem.data_sets if each.saturation is not None)
        return [problem.names_in(each)[each.motion_unknown()] for each in cut_off]

    @torch.no_grad()
    def finish(self, problem: Any) -> None:
        """Also the weights of places: weaker where the scene has texture, stronger where it is smooth."""
        super().finish(problem)
        for each in problem.data_sets:
            adapt_weight_map(each, 0.0 if self.sensor_follows else pattern_cost_db(each, self.sensor_weight))
            store_reference_misfit(each)


def _rigid(problem: Any) -> list[tuple[Problem, Auto]]:
    """Data sets whose motion is rigid unless their frames bend."""
    return [
        (each, field)
        for each in problem.data_sets
        if each.motion_unknown() and len(each.data) >= MIN_FRAMES
        if isinstance(field := each.fields[each.motion_unknown()], Auto) and not field.uses_homography
    ]


def _bend(problem: Any) -> None:
    for _, field in _rigid(problem):
        field.switch_to_homography()


@register("problem", "recording")
class Recording(NUC):
    """Gain and offset from several bursts of a recording; a scene, a motion and levels for each of them.

    Its rounds are those of `nuc`. Each burst takes the first one by itself, so that scenes are near the truth when
    they meet; from then on all bursts share the sensor, see `deepir.joint_problem`.
    """

    several = True
    checked_frames = 8
    effect_names: ClassVar[tuple[str, ...]] = tuple(
        name for name in NUC.effect_names if name not in ("line_noise", "gain_drift", "vignetting")
    )

    def initialise(self, problem: Problem, seed: int) -> None:
        """Also the first round."""
        super().initialise(problem, seed)
        self._first_round(problem)

    def restart(self, problem: Any) -> None:
        """Each burst by itself, the first round included."""
        for each in each_by_itself(problem):
            super().restart(each)
            self._first_round(each)
        self.weigh(problem, self.sensor_weight)

    def _first_round(self, problem: Problem) -> None:
        solve(problem, [super().plan(problem)("sensor 1")])

    def plan(self, problem: Any) -> Schedule:
        """The rounds of `nuc` but the first."""
        return Schedule(super().plan(problem)[1:])
