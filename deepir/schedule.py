"""The schedule of a solve: stages, and the steps that alternate in each."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Step:
    """How a group of unknowns moves: by a registered optimiser, or `eliminate` (closed form, at every evaluation)."""

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
    prepare: Callable[[Any], None] | None = None
    use_held_out: bool = False
    fine: bool = False  # what is slow of the scene stays as it was found; see `deepir.optim.preconditioner`
    tolerance: float = 1e-5  # stop when ten iterations gain less than this, in nats for each sample
    #: Asked when the stage comes, before all else: it is left out if there is no need.
    needed: Callable[[Any], bool] | None = None
    #: Called before `prepare` to put a field in another's place; and again when a later solve goes on from here.
    change: Callable[[Any], None] | None = None


class Schedule(list[Stage]):
    """Stages in order, edited by name."""

    def __call__(self, name: str) -> Stage:
        """The stage of a name; `KeyError` if there is none."""
        return self[self.position(name)]

    def position(self, name: str) -> int:
        """Where the first stage of a name stands; `KeyError` if there is none."""
        for i, stage in enumerate(self):
            if stage.name == name:
                return i
        raise KeyError(f"no stage '{name}'; stages are {[stage.name for stage in self]}")

    def replaced(self, name: str, *stages: Stage) -> Schedule:
        """With these stages in place of one."""
        at = self.position(name)
        return Schedule([*self[:at], *stages, *self[at + 1 :]])

    def before(self, name: str, *stages: Stage) -> Schedule:
        """With these stages before one."""
        return self.replaced(name, *stages, self(name))

    def after(self, name: str, *stages: Stage) -> Schedule:
        """With these stages after one."""
        return self.replaced(name, self(name), *stages)
