"""What every registered field keeps to; free values, between bounds or not."""

import pytest
import torch

from deepir.assembly import make_field
from deepir.errors import ConfigError
from deepir.fields.base import Bounded, Pixels
from deepir.registry import components

FIELDS = components("field")
SHAPE = (1, 1, 5, 6)


@pytest.fixture(params=FIELDS)
def field(request):
    return FIELDS[request.param].example()


def nudge(field):
    """Some value that the field can represent."""
    with torch.no_grad():
        for parameter in field.parameters():
            parameter.add_(0.3 * torch.randn_like(parameter))


def test_the_value_has_the_shape_and_the_type(field):
    assert field().dtype == torch.float32
    nudge(field)
    before = field().detach()
    value = field.to(torch.float64)()
    assert value.shape == field.shape
    assert value.dtype == torch.float64
    assert value.isfinite().all()
    assert torch.allclose(value.detach(), before.double(), atol=1e-5)


def test_a_value_that_it_represents_is_taken_over(field):
    nudge(field)
    value = field().detach().clone()
    if not field.can_represent:
        pytest.skip("a network")
    other = type(field).example()
    other.init_from(value)
    assert torch.allclose(other(), value, atol=1e-5)
    field.init_from(value)
    assert torch.allclose(field(), value, atol=1e-5)


def test_every_parameter_has_a_gradient_and_its_own_penalty_is_a_number_that_is_not_negative(field):
    nudge(field)
    total = (field() * torch.rand(field.shape)).sum()
    if (own := field.penalty()) is not None:
        assert own.shape == ()
        assert own >= 0
        total = total + own
    for parameter in field.parameters():
        (gradient,) = torch.autograd.grad(total, parameter, retain_graph=True)
        assert gradient.isfinite().all()
        assert gradient.any()


def test_its_state_restores_it(field):
    nudge(field)
    other = type(field).example()
    other.load_state_dict(field.state_dict())
    assert torch.equal(other(), field())


def test_its_parts_add_up_to_it(field):
    nudge(field)
    if parts := field.parts():
        assert torch.allclose(field.neutral + sum(part.values for part in parts), field().double(), atol=1e-5)


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


@pytest.mark.parametrize("shape", [SHAPE, (1, 1, 1, 1)])
def test_a_constant_and_a_single_value_are_represented_too(shape):
    field = Pixels(shape)
    assert torch.equal(field(), torch.zeros(shape))  # neutral
    field.init_from(torch.tensor(5.0))
    assert torch.equal(field(), torch.full(shape, 5.0))
