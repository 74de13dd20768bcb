"""Free values on a grid, and free values between bounds."""

import pytest
import torch

from deepir.assembly.problem import make_field
from deepir.errors import ConfigError
from deepir.fields.base import Bounded, Pixels

SHAPE = (1, 1, 5, 6)


@pytest.mark.parametrize(("low", "high"), [(0.0, None), (-1.0, 3.0), (2.0, None)])
def test_no_step_leaves_the_bounds(low, high):
    field = Bounded(SHAPE, low=low, high=high)
    with torch.no_grad():
        field.values.copy_(50 * torch.randn(SHAPE))
    assert field().min() >= low
    assert high is None or field().max() <= high


def test_a_start_on_a_bound_can_leave_it():
    field = Bounded(SHAPE, 0.0)
    field().sum().backward()
    assert field.values.grad.min() > 0


def test_bounds_that_cross_are_refused():
    with pytest.raises(ConfigError, match="high above low"):
        make_field({"type": "bounded", "low": 2, "high": 1}, SHAPE, 0.0, (5, 6), 1.0, "scene", SHAPE.__eq__)


def test_any_value_is_represented_with_its_pedestal():
    value = 8000 + 100 * torch.rand(1, 1, 6, 7)
    field = Pixels((1, 1, 6, 7))
    field.init_from(value)
    assert torch.allclose(field(), value, atol=1e-3)
    assert field.values.detach().std() < 2  # a parameter of one is a deviation of the scene


def test_a_constant_and_a_single_value_are_represented_too():
    for shape in ((1, 1, 6, 7), (1, 1, 1, 1)):
        field = Pixels(shape)
        field.init_from(torch.tensor(5.0))
        assert torch.equal(field(), torch.full(shape, 5.0))
        assert torch.equal(Pixels(shape, 0.0)(), torch.zeros(shape))  # before: neutral
