"""What no frame sees of the scene: it is to go on smoothly from where some frame does."""

from __future__ import annotations

import torch

from deepir.arrays.fill import pull_push_filled
from deepir.optim.preconditioner import MIN_FRAMES_SEEN
from deepir.problem import Problem


@torch.no_grad()
def fill_unobserved(problem: Problem) -> None:
    """Let the scene go on smoothly where no frame sees it.

    No data hold it there. Left alone it keeps the pattern that the scene once had at its edge, and a solve spends most
    of its iterations on what the penalties make of that.
    """
    values = problem.values()
    slots = {slot: values[name] for slot, name in problem.slots.items()}
    usable = (problem.precision > 0).to(problem.data)
    weight = problem.operator.adjoint(usable, tuple(values["scene"].shape), **slots)
    known = weight > MIN_FRAMES_SEEN * weight.max() / len(problem.data)
    if not known.all():
        problem.fields["scene"].init_from(pull_push_filled(values["scene"], known))
