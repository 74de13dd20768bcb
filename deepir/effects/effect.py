"""What an effect is: one imperfection of a camera or of a burst, detected, corrected and reported in one file."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar, Protocol

from torch import Tensor

from deepir.problem import Problem
from deepir.schedule import Schedule


@dataclass
class InitialEstimate:
    """State of the initial estimate at one of its steps; see `deepir.problems.initial_estimate`.

    Args:
        problem: Its scene is the registered average of the frames.
        noise: Standard deviation of a sample's noise, in the data's units.
        static: Pixels whose samples vary by less than that, (1, 1, h, w), bool.
        still: Pixels whose samples vary by no more, same shape.
        step: 0: registered average of the raw frames; 1: of frames of equal level and gain; 2 and more: without the
            fixed pattern.
        residual: Frames less their prediction, (N, 1, h, w), fixed pattern included.
    """

    problem: Problem
    noise: float
    static: Tensor
    still: Tensor
    step: int
    residual: Tensor


class Rounds(Protocol):
    """What a recipe does between its stages."""

    def update(self, problem: Problem, *, settled: bool = True) -> None:
        """Estimate hyperparameters and masks from the last round."""

    def restart(self, problem: Problem) -> None:
        """Start scene and pattern anew, with the masks and hyperparameters found so far."""


class Effect:
    """Base class: every hook does nothing.

    A problem lists its effects; each hook is called for all of them, in that order. An effect is a frozen dataclass:
    its fields are the options that `effects.NAME` takes in YAML. What it finds it keeps in the problem.
    """

    #: Whether it compares frames at one place of the scene: not where each pixel has a motion of its own.
    compares_frames: ClassVar[bool] = False
    #: Whether it updates what data sets of one sensor have in common, so that the first of them will do.
    of_sensor: ClassVar[bool] = False

    def prepare(self, problem: Problem) -> None:
        """Before the scene has a start: what the frames alone show."""

    def equalise(self, problem: Problem) -> bool:
        """Bring the frames to one level and gain; True if they changed, and the scene is to be started anew."""
        return False

    def reject(self, estimate: InitialEstimate) -> None:
        """Mask or down-weight samples, and set first hyperparameters, by the residual of the initial estimate."""

    def initialise(self, problem: Problem) -> None:
        """Once the initial estimate is done."""

    def detect(self, problem: Problem) -> bool:
        """Once all effects are initialised; True if the initial estimate is to be repeated with what was found."""
        return False

    def update(self, problem: Problem, *, settled: bool) -> bool:
        """Between rounds; `settled`: scene and pattern are near their optimum. True: start scene and pattern anew."""
        return False

    def finish(self, problem: Problem) -> None:
        """Before the scene's own stage."""

    def plan(self, problem: Problem, schedule: Schedule, rounds: Rounds) -> Schedule:
        """The schedule with the stages of this effect."""
        return schedule

    def messages(self, problem: Problem, *, complete: bool) -> Iterable[str]:
        """Warnings once all is solved; `complete`: the solve was not cut short, which leaves drift and residuals."""
        return ()
