"""Plans: groups that alternate, closed forms, stopping, saving and resuming."""

import itertools
import math

import pytest
import torch

from deepir.errors import DataError, SolverError
from deepir.fields.base import Pixels
from deepir.operators import Chain, Operator, Sensor
from deepir.optim.objective import held_out_error
from deepir.optim.solve import solve
from deepir.priors.penalties.distance import Ridge
from deepir.problem import Problem
from deepir.registry import components
from deepir.schedule import Stage, Step
from deepir.storage.stored import FileCheckpoint

OPTIMISERS = components("optimiser")

EVERYTHING = ("gain", "offset")
ELIMINATE = Step(EVERYTHING, "eliminate")


@pytest.fixture
def checkpoint(tmp_path):
    return FileCheckpoint(tmp_path / "state.safetensors")


def plan(method="lbfgs", iterations=30, *, groups=(("scene", "motion"),), eliminate=True, **options):
    steps = tuple(Step(group, method, lr=0.02) for group in groups)
    return [Stage("joint", (*steps, *((ELIMINATE,) if eliminate else ())), iterations, **options)]


def state(problem):
    return {name: value.clone() for name, value in problem.state_dict().items() if name != "data"}


def same(a, b):
    return a.keys() == b.keys() and all(torch.equal(a[name], b[name]) for name in a)


class InterruptedSolveError(Exception):
    pass


def stop_after(count):
    """A callback that raises in its `count`-th call."""
    calls = []

    def callback(progress):
        calls.append(progress)
        if len(calls) == count:
            raise InterruptedSolveError

    return callback


def dense_scene(problem):
    """The scene of a quadratic problem with all else held, from its normal equations."""
    shape = problem.fields["scene"].shape
    values = problem.values()
    values["scene"] = torch.zeros_like(values["scene"])
    at_zero = problem.predict(values).detach().flatten()
    units = torch.eye(math.prod(shape), dtype=torch.float64)
    columns = [problem.predict(values | {"scene": u.reshape(shape)}).detach().flatten() - at_zero for u in units]
    a, w = torch.stack(columns, 1), problem.precision.flatten()
    ridge = problem.penalties["scene"]["prior"]
    normal = a.T @ (w[:, None] * a) + float(ridge.weight) * units
    rhs = a.T @ (w * (problem.data.flatten() - at_zero)) + float(ridge.weight) * ridge.center
    return torch.linalg.solve(normal, rhs).reshape(shape)


def test_lbfgs_finds_the_dense_solution_of_a_quadratic_problem(small_nuc):
    problem = small_nuc(quadratic=True)
    solution = solve(problem, plan(groups=(("scene",),), eliminate=False, iterations=200, tolerance=1e-12))
    assert torch.allclose(solution.values["scene"], dense_scene(problem), atol=1e-3)
    assert solution.reason == "converged"


@pytest.mark.parametrize("method", OPTIMISERS)
@pytest.mark.parametrize("quadratic", [True, False])
@pytest.mark.parametrize("eliminate", [True, False])
@pytest.mark.parametrize("groups", [(("scene", "motion"),), (("scene",), ("motion",))])
def test_every_method_improves_every_problem(small_nuc, method, quadratic, eliminate, groups):
    problem = small_nuc(quadratic=quadratic)
    solution = solve(problem, plan(method, groups=groups, eliminate=eliminate, tolerance=0.0))
    losses = [row["loss"] for row in solution.history]
    assert losses[-1] < 0.8 * losses[0] if method == "adam" else losses[-1] <= losses[0]
    terms = problem.losses(problem.values())
    assert sum(float(t.detach()) for t in terms.values()) < 1.1 * losses[-1]
    assert solution.iterations == len(solution.history) <= 30
    assert solution.evaluations >= solution.iterations * len(groups)
    assert torch.equal(solution.values["motion"][0], torch.eye(3, dtype=torch.float64))


def test_unknowns_outside_the_steps_stay_and_stages_follow_each_other(small_nuc):
    problem, seen = small_nuc(), []
    motion = problem.fields["motion"]().detach()
    stages = [
        Stage("first", (Step(("scene",)), ELIMINATE), 4, prepare=lambda p: seen.append("first")),
        Stage("second", (Step(("scene",)),), 3, prepare=lambda p: seen.append(problem.fields["gain"]().detach())),
    ]
    solution = solve(problem, stages)
    assert seen[0] == "first"
    assert torch.equal(seen[1], problem.fields["gain"]())
    assert torch.equal(problem.fields["motion"](), motion)
    assert [(r["stage"], r["iteration"]) for r in solution.history] == [
        *(("first", i) for i in range(1, 5)), *(("second", i) for i in range(1, 4))
    ]  # fmt: skip


@pytest.mark.parametrize("needed", [True, False])
def test_a_stage_that_nothing_needs_is_left_out(small_nuc, needed):
    asked = []
    step = (Step(("scene",)),)
    stages = [
        Stage("first", step, 2),
        Stage("more", step, 2, needed=lambda p: asked.append(p) or needed, prepare=asked.append),
        Stage("last", step, 2),
    ]
    problem = small_nuc()
    history = solve(problem, stages).history
    assert asked == (1 + needed) * [problem]
    assert ("more" in {row["stage"] for row in history}) == needed


def test_the_eliminated_are_at_the_optimum_when_a_stage_ends(small_nuc):
    for method in OPTIMISERS:
        problem = small_nuc()
        solution = solve(problem, plan(method, iterations=5))
        values = dict(solution.values)
        problem.solved(values, EVERYTHING)
        for name in EVERYTHING:
            assert torch.allclose(values[name], solution.values[name], atol=1e-9)


def test_a_stage_of_closed_forms_alone_is_solved_at_once(small_nuc):
    problem = small_nuc()
    solution = solve(problem, [Stage("sensor", (ELIMINATE,), 10)])
    assert (solution.iterations, solution.reason) == (0, "converged")
    assert problem.fields["gain"]().std() > 0


def test_a_group_without_free_parameters_is_left_out(small_nuc):
    problem = small_nuc(n_frames=1)  # one frame has no motion
    solution = solve(problem, plan(groups=(("motion",), ("scene",)), iterations=3))
    assert math.isfinite(solution.history[-1]["loss"])
    problem = small_nuc()
    problem.fields["motion"].requires_grad_(False)
    before = problem.fields["motion"]().clone()
    solve(problem, plan(iterations=3))
    assert torch.equal(problem.fields["motion"](), before)


def test_a_step_is_taken_every_so_many_iterations(small_nuc):
    problem, motions = small_nuc(), []
    steps = (Step(("scene",)), Step(("motion",), every=3), ELIMINATE)
    callback = lambda progress: motions.append(problem.fields["motion"]().detach().clone())  # noqa: E731
    start = problem.fields["motion"]().detach().clone()
    solution = solve(problem, [Stage("joint", steps, 7)], callbacks=[callback])
    moved = [not torch.equal(a, b) for a, b in zip([start, *motions[:-1]], motions, strict=True)]
    assert moved == [True, False, False, True, False, False, True]
    losses = [row["loss"] for row in solution.history]
    assert all(b < a for a, b in itertools.pairwise(losses))  # none is an old one


def test_it_stops_at_the_limit_or_at_rest_and_says_which(small_nuc):
    assert solve(small_nuc(), plan(iterations=3)).reason == "stopped as planned"
    rested = solve(small_nuc(), plan(iterations=500, tolerance=1e-2))
    assert rested.reason == "converged"
    assert 10 < rested.iterations < 200
    longer = solve(small_nuc(), plan(iterations=500, tolerance=1e-4))
    assert longer.iterations > rested.iterations
    assert solve(small_nuc(), plan(iterations=0)).iterations == 0


def test_progress_is_reported(small_nuc):
    seen = []
    solve(small_nuc(), [*plan(iterations=3), *plan(iterations=5)], callbacks=[seen.append])
    assert [round(8 * p.done) for p in seen] == list(range(1, 9))
    assert [p.iteration for p in seen] == [1, 2, 3, 1, 2, 3, 4, 5]
    assert seen[2].iterations == 3
    assert math.isnan(seen[0].held_out())


def test_held_out_samples_are_watched_but_not_fitted(small_nuc):
    problem = small_nuc()
    problem.held_out[:, :, 1::3, 1::3] = True
    solution = solve(problem, plan(iterations=50, tolerance=0.0))
    watched = [row["held_out"] for row in solution.history if "held_out" in row]
    assert len(watched) == 2
    assert watched[-1] == held_out_error(problem)
    values = problem.values()
    error = (problem.predict(values) - problem.data)[problem.held_out].square().mean().sqrt()
    assert held_out_error(problem) == pytest.approx(float(error.detach()))
    assert solution.held_out == watched[-1]
    everything = solve(problem, plan(iterations=20, use_held_out=True))
    assert math.isnan(everything.held_out)
    assert not any("held_out" in row for row in everything.history)
    assert held_out_error(problem) < watched[-1]


class BreaksDown(Operator):
    """Not a number once it was called so many times."""

    linear = affine = False
    calls = 0

    def forward(self, x, **slots):
        type(self).calls += 1
        return x * math.nan if type(self).calls > 12 else x


@pytest.mark.parametrize("method", OPTIMISERS)
def test_nan_ends_the_solve_with_a_reason_and_the_last_good_state(method, checkpoint):
    BreaksDown.calls = 0
    chain = Chain({"breaks": BreaksDown(), "sensor": Sensor()})
    fields, penalties = {"scene": Pixels((1, 1, 6, 7))}, {"scene": {"ridge": Ridge(weight=1.0)}}
    problem = Problem(chain, fields, torch.rand(2, 1, 6, 7), penalties=penalties)
    # Two groups: an alternating one evaluates anew before each step.
    steps = (Step(("scene",), method), Step(("scene",), method))
    with pytest.raises(SolverError, match=r"not a number at iteration .* of stage 'joint'"):
        solve(problem, [Stage("joint", steps, 50, tolerance=0.0)], checkpoint=checkpoint)
    assert problem.fields["scene"]().isfinite().all()
    tensors, _ = checkpoint.load()
    assert torch.equal(tensors["problem.fields.scene.values"], problem.fields["scene"].values)


def test_divergence_ends_the_solve_where_the_stage_began(small_nuc, checkpoint):
    problem = small_nuc()
    before = problem.fields["scene"]().detach().clone()
    stage = Stage("joint", (Step(("scene",), "adam", lr=1e4),), 50)
    with pytest.raises(SolverError, match=r"rose from .* lower the step \(lr\)"):
        solve(problem, [stage], checkpoint=checkpoint)
    assert torch.equal(problem.fields["scene"](), before)


def interrupted(small_nuc, stages, count, checkpoint):
    """A whole solve, and one that is interrupted after `count` iterations and goes on: problems and solutions."""
    problems = []
    for _ in range(3):
        torch.manual_seed(5)
        problems.append(small_nuc())
    whole, broken, fresh = problems
    wanted = solve(whole, stages(whole))
    count = count or wanted.iterations
    with pytest.raises(InterruptedSolveError):
        solve(broken, stages(broken), callbacks=[stop_after(count)], checkpoint=checkpoint)
    return whole, wanted, fresh, solve(fresh, stages(fresh), checkpoint=checkpoint)


@pytest.mark.parametrize("method", OPTIMISERS)
@pytest.mark.parametrize("groups", [(("scene", "motion"),), (("scene",), ("motion",))])
@pytest.mark.parametrize("count", [1, 7, 14])
def test_a_resumed_solve_is_the_uninterrupted_one_to_the_bit(small_nuc, checkpoint, method, groups, count):
    def stages(problem):
        def prepare(p):
            p.penalties["scene"]["prior"].weight *= 1.1  # as estimated strengths do, once

        return [*plan(method, 8, groups=groups), *plan(method, 10, groups=groups, prepare=prepare)]

    whole, wanted, fresh, found = interrupted(small_nuc, stages, count, checkpoint)
    assert same(state(whole), state(fresh))
    assert found.history == wanted.history
    assert (found.iterations, found.evaluations) == (wanted.iterations, wanted.evaluations)
    assert found.reason == wanted.reason


def test_a_solve_interrupted_where_it_came_to_rest_does_not_go_on(small_nuc, checkpoint):
    stages = plan(iterations=500, tolerance=1e-2)
    whole, wanted, fresh, found = interrupted(small_nuc, lambda _: stages, None, checkpoint)
    assert found.history == wanted.history
    assert same(state(whole), state(fresh))


def test_checkpoints_are_written_on_the_way_and_the_state_of_another_problem_is_refused(small_nuc, checkpoint):
    solve(small_nuc(), plan(iterations=3), checkpoint=checkpoint, every=0.0)
    assert checkpoint.load()[1]["iteration"] == 3
    with pytest.raises(DataError, match="another problem"):
        solve(small_nuc(size=(11, 13)), plan(iterations=3), checkpoint=checkpoint)
    checkpoint.path.write_bytes(b"no checkpoint")
    with pytest.raises(DataError, match="cannot be used"):
        solve(small_nuc(), plan(iterations=3), checkpoint=checkpoint)


def test_adam_leaves_the_average_that_predicts_the_held_out_samples_best(small_nuc):
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
