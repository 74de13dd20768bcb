"""What the recipes of problems share; the problem `generic` has nothing else."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, ClassVar

import torch

from deepir.effects.effect import Effect
from deepir.estimation.cross_validation import SCENE, WeightSearch, fraction_for_weights
from deepir.estimation.prior_weight import penalties_of, weigh_scene, weigh_unknown
from deepir.joint_problem import AnyProblem, JointProblem
from deepir.optim.objective import hold_out
from deepir.optim.solve import Solution, solve
from deepir.problem import Problem
from deepir.problems.initial_estimate import initial_estimate
from deepir.registry import lookup, register
from deepir.schedule import Schedule, Stage, Step

#: Least weight of a penalty, log2 of the default: early stopping is a prior too, and the search would go on to no
#: weight for a fine texture.
MIN_LOG2_WEIGHT = -6.0
TRIAL_ITERATIONS = 40  # of cross-validation: through a blur, detail converges slowly
LONG_TRIAL = 100  # the same of any physics: wide holes fill more slowly still


class Recipe:
    """How a problem is initialised, scheduled and reported.

    A `problem` is a `deepir.problem.Problem`, or a `deepir.joint_problem.JointProblem` where a recipe can solve several
    data sets.

    Args:
        effects: In place of those that `effect_names` names, with their default options.
    """

    frames: ClassVar[int] = 1  # frames that it needs at least
    motion: ClassVar[bool] = False  # whether it cannot work without motion between the frames
    ordered: ClassVar[bool] = False  # whether frames follow each other in time, so that none may be missing in between
    #: Whether gain and offset correct the frames as they are, so that frames beside the burst can judge them.
    judged: ClassVar[bool] = False
    several: ClassVar[bool] = False  # whether it solves several data sets together
    any_data: ClassVar[bool] = False  # whether data need not be pictures, where no motion is registered
    checked_frames: ClassVar[int | None] = None  # frames that are enough to check a configuration; None: all
    #: Weight of the scene's penalties while the sensor is estimated, relative to that of the scene's own stage.
    sensor_weight: ClassVar[float] = 1.0
    operators: ClassVar[tuple[str, ...]] = ()  # operators that the physics must have
    #: Imperfections that it estimates, by their registered names, in the order of their hooks.
    effect_names: ClassVar[tuple[str, ...]] = ()

    def __init__(self, effects: Sequence[Effect] | None = None) -> None:
        self.effects = [lookup("effect", name)() for name in self.effect_names] if effects is None else list(effects)
        #: Whether gain and offset follow the scene in a last stage, so that their uncertainty is in its prior.
        self.sensor_follows = False
        #: Warnings of the initial estimate.
        self.messages: list[str] = []

    def initialise(self, problem: Any, seed: int) -> None:
        """Set starts, masks and hyperparameters from the data."""
        self.start(problem)
        hold_out(problem, seed)

    def solve(self, problem: Any, *, seed: int = 0, callbacks: Sequence[Any] = ()) -> Solution:
        """Initialise a problem and run its plan."""
        self.initialise(problem, seed)
        return solve(problem, self.plan(problem), callbacks=callbacks)

    def join(self, problems: Mapping[str, Problem], seed: int) -> JointProblem:
        """One problem of several data sets, of which each is initialised by itself; the first has the name ""."""
        joint = JointProblem(problems[""], {name: each for name, each in problems.items() if name})
        for k, each in enumerate(each_by_itself(joint)):
            self.initialise(each, seed + k)
        self.weigh(joint, self.sensor_weight)
        return joint

    def plan(self, problem: Any) -> Schedule:
        """The stages of the solve: a function of the problem alone."""
        free, eliminate = self.split(problem)
        return Schedule([Stage("joint", (Step(free), *eliminate), iterations=200)])

    @staticmethod
    def split(problem: Any) -> tuple[tuple[str, ...], tuple[Step, ...]]:
        """Unknowns that an optimiser moves, and the step that eliminates the others; () without any."""
        closed = tuple(problem.closed_form())
        free = tuple(name for name in problem.free() if name not in closed)
        return free, (Step(closed, "eliminate"),) if closed else ()

    def start(self, problem: Any) -> None:
        """The initial estimate, under the sensor's weight of the scene's penalties."""
        for each in each_by_itself(problem):
            initial_estimate(each, self.effects)
        self.weigh(problem, self.sensor_weight)

    @torch.no_grad()
    def restart(self, problem: Any) -> None:
        """Start scene and pattern anew, with the masks and the levels that were found."""
        _forget_pattern(problem)
        self.start(problem)

    def update(self, problem: Any, *, settled: bool = True) -> None:
        """Hyperparameters and masks from the last round; a new start where an effect asks for one."""
        again = [
            effect.update(each, settled=settled)
            for i, each in enumerate(problem.data_sets)
            for effect in self.between_rounds()
            if not (effect.of_sensor and set(each.same_sensor) & set(problem.data_sets[:i]))
        ]
        self.weigh(problem, self.sensor_weight)
        if any(again):
            self.restart(problem)

    def between_rounds(self) -> list[Effect]:
        """The effects that are updated between the rounds."""
        return self.effects

    def first_update(self, problem: Any) -> None:
        """The same after the first round, when scene and pattern have not settled."""
        self.update(problem, settled=False)

    def finish(self, problem: Any) -> None:
        """Hyperparameters and weights for the scene's own stage."""
        for each in problem.data_sets:
            for effect in self.between_rounds():
                effect.finish(each)
        self.weigh(problem)

    @staticmethod
    def weigh(problem: Any, factor: float = 1.0) -> None:
        """Set the weights of the scene's penalties to `factor` times their full strength."""
        weigh_scene(problem, factor)
        for name in penalised(problem):
            weigh_unknown(problem, name)

    def weigh_prior(self, problem: Any) -> None:
        """The same for a prior that is fitted once the sensor is known, see `scene.fit`."""
        penalties = problem.penalties["scene"].values() if "scene" in problem.penalties else ()
        if any(penalty.weighed_by_noise for penalty in penalties):
            weigh_scene(problem)
        else:
            self.weigh(problem)

    def metrics(self, problem: Any) -> dict[str, float]:
        """What `metrics.json` holds of the solved problem, beside what all problems have."""
        return {}

    def warnings(self, problem: Any, *, complete: bool = True) -> list[str]:
        """Warnings once the problem is solved; `complete`: the solve was not cut short."""
        found = [
            line
            for each in problem.data_sets
            for effect in self.effects
            for line in effect.messages(each, complete=complete)
        ]
        return [*self.messages, *dict.fromkeys(found)]


def each_by_itself(problem: Any) -> Iterator[Problem]:
    """The data sets, the first one last: what several show starts as that shows it.

    While one is at hand it knows nothing of the others, nor of the pattern that they found.
    """
    for k, each in enumerate(reversed(problem.data_sets)):
        others, each.same_sensor = each.same_sensor, ()
        if k > 0:
            _forget_pattern(each)
        yield each
        each.same_sensor = others


@torch.no_grad()
def _forget_pattern(problem: Any) -> None:
    for name in problem.closed_form():
        for part in problem.fields[name].parts():
            part.assign(torch.zeros_like(part.values))
            if not part.sigma_is_fixed:
                part.sigma.zero_()


@register("problem", "generic")
class Generic(Recipe):
    """Any operator and any unknowns: all are estimated together; gain and offset in closed form where they have one."""

    several = any_data = True
    effect_names = (
        *("saturation", "bad_pixels", "frame_gain", "frame_offset", "noise"),
        *("sensor_pattern", "shading", "outliers"),
    )

    def initialise(self, problem: AnyProblem, seed: int) -> None:
        """Starts; a part of the samples is held out, to find the weights of penalties that have none."""
        self.start(problem)
        self._start_searches(problem, seed)

    def join(self, problems: Mapping[str, Problem], seed: int) -> JointProblem:
        """As of one data set, with one search for the weights of all."""
        joint = super().join(problems, seed)
        self._start_searches(joint, seed)
        return joint

    def weigh(self, problem: AnyProblem, factor: float = 1.0) -> None:  # type: ignore[override]
        """Set the weights of all penalties to `factor` times those that held-out samples ask for."""
        for search in searches(problem):
            search.weigh(problem, factor)

    def plan(self, problem: AnyProblem) -> Schedule:
        """All unknowns together; one after the other the weights of their penalties; all together again."""
        (joint,) = super().plan(problem)
        trials = [stage for search in searches(problem) for stage in search.stages(problem)]
        last = dataclasses.replace(joint, name="all samples", prepare=self.finish, use_held_out=True)
        if not trials:
            return Schedule([joint, dataclasses.replace(last, iterations=LONG_TRIAL)])
        start = dataclasses.replace(joint, name="start", iterations=LONG_TRIAL)
        return Schedule([start, *trials, last])

    def finish(self, problem: AnyProblem) -> None:
        """The weights that were found, and the unknowns from the start of the search again."""
        self.weigh(problem)
        for search in searches(problem):
            search.reset(problem)

    def _start_searches(self, problem: AnyProblem, seed: int) -> None:
        for search in searches(problem):
            search.start(problem)
        hold_out(problem, seed, fraction_for_weights(problem))


def searches(problem: AnyProblem) -> list[WeightSearch]:
    """Those for the weights of the scenes, and of each other unknown that has penalties."""
    return [
        WeightSearch(name, first=0.0, least=MIN_LOG2_WEIGHT, iterations=LONG_TRIAL, restart=True)
        for name in (SCENE, *penalised(problem))
    ]


def penalised(problem: AnyProblem) -> list[str]:
    """Unknowns beside the scenes that are free and have penalties."""
    return [name for name in problem.free() if name not in problem.scenes and penalties_of(problem, name)]
