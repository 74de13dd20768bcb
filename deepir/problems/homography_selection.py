"""Whether the frames of a burst bend: homographies where a camera that only turns and shifts does not do."""

from __future__ import annotations

import copy
from dataclasses import replace

from deepir.fields.motion import Auto
from deepir.optim.solve import solve
from deepir.problem import Problem
from deepir.problems.motion_step import motion_of
from deepir.schedule import Stage

FEWEST, BENDS = 3, 1200.0  # frames that may bend, and nats by which that is the likelier


def select_homography(half: Problem, last: Stage) -> Problem | None:
    """The half with homographies, solved, if its frames bend; None if they do not, or did already.

    Both go on with the `last` round, at its strengths, to see how much likelier homographies are.
    """
    bends = copy.deepcopy(half)
    field = motion_of(bends)
    if not isinstance(field, Auto) or field.bends or len(half.data) < FEWEST:
        return None
    field.bend()
    going_on = replace(last, prepare=None)
    rigid, free = (solve(each, [going_on]).history[-1]["loss"] for each in (half, bends))
    if rigid - free < BENDS:
        return None
    solve(bends, [last])
    return bends
