"""What a plan is made of: stages, and the steps that alternate in each."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from deepir.problem import Problem


@dataclass(frozen=True)
class Step:
    """How a group of unknowns moves: `lbfgs`, `adam`, or `eliminate` (closed form, at every evaluation)."""

    group: tuple[str, ...]
    method: str = "lbfgs"
    lr: float = 1e-2  # adam only
    rates: Mapping[str, float] = field(default_factory=dict)  # in its place, for unknowns of the group
    every: int = 1  # the step is taken at every n-th iteration
    average: float = 0.0  # adam only: decay of the average of the iterates, see `deepir.optim.adam`


@dataclass(frozen=True)
class Stage:
    """Steps that alternate until the objective rests, or `iterations` are reached; what is in none is fixed.

    `prepare` is called when the stage is entered, to set strengths from what the stages before it found: it
    may change buffers of the problem, nothing else. `use_held_out`: fit the held-out samples too.
    """

    name: str
    steps: tuple[Step, ...]
    iterations: int = 100
    prepare: Callable[[Problem], None] | None = None
    use_held_out: bool = False
    #: What is slow of the scene stays as it was found; see `deepir.optim.preconditioner`.
    fine: bool = False
    tolerance: float = 1e-5  # stop when ten iterations gain less than this, in nats for each sample
    #: Asked when the stage comes, before all else: it is left out if there is no need.
    needed: Callable[[Problem], bool] | None = None
    #: Called before `prepare` to put a field in another's place; and again when a later solve goes on from here.
    change: Callable[[Problem], None] | None = None
