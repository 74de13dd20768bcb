"""What every registered field keeps to."""

import pytest
import torch

from deepir.registry import components

FIELDS = components("field")


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
