"""Free values between bounds."""

import pytest
import torch

from deepir.assembly.problem import make_field
from deepir.errors import ConfigError
from deepir.fields.bounded import Bounded

SHAPE = (1, 1, 5, 6)


@pytest.mark.parametrize(("low", "high"), [(0.0, None), (-1.0, 3.0), (2.0, None)])
def test_no_step_leaves_the_bounds(low, high):
    field = Bounded(SHAPE, low=low, high=high)
    with torch.no_grad():
        field.values.copy_(50 * torch.randn(SHAPE))
    assert field().min() >= low
    assert high is None or field().max() <= high


@pytest.mark.parametrize(("low", "high"), [(0.0, None), (-1.0, 3.0)])
def test_what_lies_between_is_taken_over(low, high):
    field = Bounded(SHAPE, low=low, high=high)
    value = torch.rand(SHAPE) + 0.5
    field.init_from(value)
    assert torch.allclose(field(), value, atol=1e-5)


def test_a_start_on_a_bound_can_leave_it():
    field = Bounded(SHAPE, 0.0)
    field().sum().backward()
    assert field.values.grad.min() > 0


def test_bounds_that_cross_are_refused():
    with pytest.raises(ConfigError, match="high above low"):
        make_field({"type": "bounded", "low": 2, "high": 1}, SHAPE, 0.0, (5, 6), 1.0, "scene", SHAPE.__eq__)
