"""Adam's average of its iterates."""

import torch

from deepir.optim.objective import held_out_error
from deepir.optim.solve import solve
from deepir.schedule import Stage, Step


def test_the_average_that_adam_leaves_is_the_one_that_tells_the_held_out_samples_best(small_nuc):
    problem = small_nuc(noise=0.3)
    problem.held_out.copy_(torch.rand(problem.data.shape) < 0.1)
    stage = Stage("x", (Step(("scene",), "adam", lr=0.02, average=0.8),), iterations=60)
    before = held_out_error(problem)
    errors = []
    found = solve(problem, [stage], callbacks=[lambda progress: errors.append(progress.held_out())])
    assert found.iterations == 60  # no rest: the best is chosen afterwards
    after = held_out_error(problem)
    assert after < before
    assert after < errors[-1]


def test_without_held_out_samples_adam_leaves_the_last_average(small_nuc):
    values = {}
    for average in (0.0, 0.9):
        torch.manual_seed(0)
        problem = small_nuc()
        solve(problem, [Stage("x", (Step(("scene",), "adam", lr=0.002, average=average),), iterations=30)])
        values[average] = problem.values()["scene"].detach()
    assert not torch.equal(values[0.0], values[0.9])
    assert (values[0.0] - values[0.9]).abs().max() < 1
