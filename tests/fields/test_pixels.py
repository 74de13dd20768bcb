"""Free values on a grid."""

import torch

from deepir.fields.base import Pixels


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


def test_it_begins_neutral():
    assert torch.equal(Pixels((3, 1, 1, 1), 0.0)(), torch.zeros(3, 1, 1, 1))
