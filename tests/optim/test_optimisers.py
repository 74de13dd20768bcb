"""Every optimiser on plain functions, without a problem's physics; and one of a plugin."""

import itertools
import math
from typing import ClassVar

import pytest
import torch
from torch import nn

import deepir
from deepir import registry
from deepir.errors import ConfigError
from deepir.optim import Optimiser, lbfgs
from deepir.optim.lbfgs import LBFGS
from deepir.registry import components

OPTIMISERS = components("optimiser")

each_method = pytest.mark.parametrize("method", OPTIMISERS)


class Point(nn.Module):
    """Stands in for a problem of one unknown."""

    def __init__(self, start):
        super().__init__()
        field = nn.Module()
        field.x = nn.Parameter(torch.tensor(start, dtype=torch.float64))
        self.fields = nn.ModuleDict({"x": field})
        self.penalties = {}

    @property
    def x(self):
        return self.fields["x"].x


def quadratic(x):
    scale = torch.logspace(0, 3, len(x), dtype=x.dtype)
    return (scale * (x - 1).square()).sum() / 2


def rosenbrock(x):
    return (100 * (x[1:] - x[:-1].square()).square() + (1 - x[:-1]).square()).sum()


def corner(x):
    """Not differentiable at its minimum (1, ..., 1)."""
    return (torch.arange(1, len(x) + 1) * (x - 1).abs()).sum() + (x - 1).square().sum()


FUNCTIONS = {"quadratic": quadratic, "rosenbrock": rosenbrock, "corner": corner}


def make(method, function, start=(-1.2, 1.0), lr=0.05):
    point = Point(list(start))
    return point, OPTIMISERS[method](point, ["x"], lambda group: (function(point.x), {}), lr=lr)


@each_method
@pytest.mark.parametrize("name", FUNCTIONS)
def test_every_optimiser_gets_to_every_minimum(method, name):
    point, optimiser = make(method, FUNCTIONS[name])
    for _ in range(1500 if method == "adam" else 100):
        optimiser.step(fresh=False)
        if optimiser.done:
            break
    assert torch.allclose(point.x.detach(), torch.ones(2, dtype=torch.float64), atol=0.05)
    assert optimiser.value < 0.05


def test_adams_first_step_is_as_long_as_its_rate_says_for_each_unknown():
    point = Point([-1.2, 1.0])
    point.fields["y"] = other = Point([3.0]).fields["x"]

    def both(group):
        return rosenbrock(point.x) + other.x.sum(), {}

    OPTIMISERS["adam"](point, ["x", "y"], both, lr={"x": 0.05, "y": 0.2}).step(fresh=False)
    assert [point.x[0].item(), other.x.item()] == pytest.approx([-1.15, 2.8])


def test_lbfgs_never_goes_up_and_counts_its_evaluations():
    point, optimiser = make("lbfgs", rosenbrock)
    values = [float(rosenbrock(point.x).detach())]
    for _ in range(30):
        optimiser.step(fresh=False)
        values.append(optimiser.value)
    assert all(b <= a for a, b in itertools.pairwise(values))
    assert optimiser.take_count() > 30
    assert optimiser.take_count() == 0
    assert optimiser.value == pytest.approx(float(rosenbrock(point.x).detach()))


def test_lbfgs_is_done_where_nothing_descends():
    point, optimiser = make("lbfgs", quadratic, start=(1.0, 1.0))
    for _ in range(3):
        optimiser.step(fresh=False)
    assert optimiser.done
    assert torch.equal(point.x.detach(), torch.ones(2, dtype=torch.float64))


def test_lbfgs_steps_back_from_where_the_value_or_the_slope_is_not_finite():
    def cliff(x):
        return -x.sum().log() + x.square().sum()  # NaN for negative sums

    def steep(x):
        x = x * 1.0
        x.register_hook(lambda slope: torch.where(x > 3, torch.nan, slope))
        return (x - 2.9).square().sum()  # finite beyond 3, but its slope is not

    for function, start, goal in ((cliff, (0.01, 0.01), 0.5), (steep, (0.0, 0.0), 2.9)):
        point, optimiser = make("lbfgs", function, start=start)
        for _ in range(40):
            optimiser.step(fresh=False)
            assert math.isfinite(optimiser.value)
        assert torch.allclose(point.x.detach(), torch.full((2,), goal, dtype=torch.float64), atol=1e-4)


@each_method
def test_from_a_start_that_is_not_a_number_no_step_is_taken(method):
    for function in (lambda x: (x - 5).sqrt().sum(), lambda x: x.sum() * math.inf):
        point, optimiser = make(method, function, start=(1.0, 2.0))
        optimiser.step(fresh=False)
        assert not math.isfinite(optimiser.value)
        assert point.x.tolist() == [1.0, 2.0]


@each_method
def test_a_resumed_optimiser_takes_the_same_steps_to_the_bit(method):
    point, optimiser = make(method, rosenbrock)
    for _ in range(15):
        optimiser.step(fresh=False)
    other, resumed = make(method, rosenbrock, start=point.x.tolist())
    resumed.load({name: value.clone() for name, value in optimiser.state().items()})
    for _ in range(15):
        optimiser.step(fresh=False)
        resumed.step(fresh=False)
        assert torch.equal(point.x, other.x)
        assert optimiser.value == resumed.value


def test_what_is_fixed_or_empty_is_left_alone():
    point = Point([1.0, 2.0])
    point.fields["x"].fixed = nn.Parameter(torch.ones(3), requires_grad=False)
    point.fields["x"].empty = nn.Parameter(torch.ones(0))
    optimiser = LBFGS(point, ["x"], lambda group: (quadratic(point.x), {}), lr=1.0)
    assert [p is point.x for p in optimiser.parameters] == [True]
    optimiser.step(fresh=False)
    assert torch.equal(point.fields["x"].fixed, torch.ones(3))


def kinked(x):
    """Total variation of a noisy step: its slopes change at once where neighbours become alike."""
    noise = torch.randn(len(x), generator=torch.Generator().manual_seed(0), dtype=x.dtype)
    data = noise + 10 * (torch.arange(len(x)) > len(x) / 2)
    return (x - data).square().sum() / 2 + 3 * (x.diff().square() + 1e-3).sqrt().sum()


class Flat:
    """A curvature that knows nothing of kinks."""

    tensors: ClassVar[dict[str, torch.Tensor]] = {}

    def solve(self, slope):
        return slope.clone()


def test_where_the_curvature_is_too_flat_steps_become_shorter(monkeypatch):
    steps, reached = [], []
    for shorter in (lbfgs.OVERSHOOT_SHRINKAGE, 1.0):
        monkeypatch.setattr(lbfgs, "OVERSHOOT_SHRINKAGE", shorter)
        _, optimiser = make("lbfgs", kinked, start=[0.0] * 300)
        optimiser.preconditioner, evaluations, taken = Flat(), 0, 0
        while evaluations < 60:
            optimiser.step(fresh=False)
            evaluations, taken = evaluations + optimiser.take_count(), taken + 1
        steps.append(taken)
        reached.append(optimiser.value)
    assert steps[0] > 1.5 * steps[1]
    assert reached[0] < reached[1] - 0.3


def test_a_step_that_goes_too_far_is_followed_by_one_to_the_parabola_s_least_point():
    bend = torch.tensor([1.0, 5.0])
    _, optimiser = make("lbfgs", lambda x: (bend * x.square()).sum() / 2, start=[0.0, 1.0])
    optimiser.preconditioner = Flat()
    optimiser.step(fresh=False)
    assert optimiser.take_count() == 3  # the start's, one that is five times too long, and the least point
    assert optimiser.value == pytest.approx(0.0, abs=1e-9)


PLAN = {"plan": [{"name": "mine", "steps": [{"group": ["scene"], "method": "descent", "lr": 1e-3}], "iterations": 30}]}
BARE = {"prior": "tv", "physics": {}, "solver": PLAN, "threads": 1, "noise": {"read": 0.1}}


@pytest.fixture
def descent(own_components):
    @registry.register("optimiser", "descent")
    class Descent(Optimiser):
        """Gradient descent."""

        descends = False

        @torch.no_grad()
        def step(self, *, fresh):
            self.value, slopes = self.gradient()
            for parameter, slope in zip(self.parameters, slopes, strict=True):
                parameter.sub_(slope, alpha=self.lr[self.group[0]])


def test_an_optimiser_of_a_plugin_takes_the_steps_of_a_configuration(descent):
    frames = torch.arange(320.0).reshape(1, 16, 20) % 7
    losses = [row["loss"] for row in deepir.run(BARE, frames=frames).history]
    assert len(losses) == 30
    assert losses[-1] < losses[0]


def test_an_unknown_optimiser_is_refused_with_the_nearest_name():
    with pytest.raises(ConfigError, match=r"stage 'mine': method: no optimiser is called 'descent'; .*lbfgs"):
        deepir.run(BARE, frames=torch.rand(1, 16, 20))
