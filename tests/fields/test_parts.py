"""Gain and offset as sums of Gaussian parts."""

import pytest
import torch

from deepir.fields.constant import Constant
from deepir.fields.sensor_maps import Column, Pixel, Row, SumField

SHAPE = (1, 1, 6, 7)


def total(**sigma):
    kinds = {"column": Column, "row": Row, "pixel": Pixel}
    return SumField(SHAPE, 1.0, {name: kinds[name](SHAPE, 0.0, sigma=s) for name, s in sigma.items()})


def test_a_column_is_constant_along_columns_and_a_row_along_rows():
    value = torch.rand(SHAPE)
    for part, axis in ((Column(SHAPE, sigma=1), -2), (Row(SHAPE, sigma=1), -1)):
        part.init_from(value)
        assert torch.allclose(part(), value.mean(axis, keepdim=True).expand(SHAPE))


def test_parameters_are_white_and_float64():
    part = Pixel(SHAPE, 1.0, sigma=0.02)
    part.init_from(1 + 0.02 * torch.ones(SHAPE))
    assert part.whitened.dtype == torch.float64
    assert torch.allclose(part.whitened, torch.ones_like(part.whitened), atol=1e-5)
    assert float(part.penalty().detach()) == pytest.approx(42 / 2, rel=1e-5)


def test_a_part_without_sigma_is_zero_until_it_has_one():
    part = Column(SHAPE, 1.0)
    assert not part.sigma_is_fixed
    part.init_from(torch.rand(SHAPE))
    assert torch.equal(part(), torch.ones(SHAPE))
    part.sigma.fill_(0.5)
    part.init_from(torch.full(SHAPE, 1.25))
    assert torch.allclose(part(), torch.full(SHAPE, 1.25))


@pytest.mark.parametrize("sigma", [-1.0, float("nan"), float("inf")])
def test_a_sigma_must_be_a_number(sigma):
    with pytest.raises(ValueError, match="sigma"):
        Pixel(SHAPE, sigma=sigma)


def test_a_sum_splits_a_value_without_loss():
    field = total(column=0.1, row=0.1, pixel=0.1)
    value = torch.rand(SHAPE)
    field.init_from(value)
    assert torch.allclose(field(), value, atol=1e-6)
    column, row, pixel = (part.values for part in field.parts())
    assert torch.allclose(column, value.double().mean(-2, keepdim=True) - 1)
    assert torch.allclose((column + row + pixel + 1).float(), value)


def test_a_sum_adds_the_members_priors():
    field = total(column=0.1, row=0.2)
    field.init_from(torch.rand(SHAPE))
    column, row = field.parts()
    assert float((field.penalty() - column.penalty() - row.penalty()).detach()) == pytest.approx(0)


def test_a_sum_with_another_field_has_no_closed_form():
    field = SumField(SHAPE, 1.0, {"column": Column(SHAPE, sigma=0.1), "constant": Constant(SHAPE, value=0.5)})
    assert field.parts() == ()
    assert torch.allclose(field(), torch.full(SHAPE, 1.5))
