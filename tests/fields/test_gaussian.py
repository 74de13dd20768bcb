"""Gaussian fields: gain and offset as sums of parts, levels that go one way or walk, maps of few terms."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import fft

from deepir.fields.basis_expansion import DCT, Radial
from deepir.fields.constant import Constant
from deepir.fields.drift import WALK_SIGMA_RATIO, Drift, level_basis
from deepir.fields.sensor_maps import Column, Pixel, Row, SumField

SHAPE, SIZE = (1, 1, 6, 7), (24, 30)


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


def drift(levels, sigma=1.0):
    field = Drift((len(levels), 1, 1, 1), sigma=sigma)
    field.init_from(torch.tensor(levels, dtype=torch.float32)[:, None, None, None])
    return field


@pytest.mark.parametrize("levels", [[0.0, 1.0, 2.0, 3.0], [0.5, -1.0, 2.0], [3.0, -3.0]])
def test_levels_are_what_they_were_set_to_less_their_mean(levels):
    found = drift(levels)().detach().flatten().numpy()
    np.testing.assert_allclose(found, np.subtract(levels, np.mean(levels)), atol=1e-5)


def test_a_steady_change_of_sigma_a_frame_costs_half_a_nat_at_most_and_levels_that_jump_much_more():
    costs = [[*range(8)], [0.0, 1, 2, 3, 4, 5], [0.0, 5, 0, 5, 0, 5]]
    long, steady, jumps = (float(drift(levels).penalty().detach()) for levels in costs)
    assert 0 < long < 0.5
    assert jumps > 50 * steady


def test_the_prior_is_that_of_a_steady_change_and_a_random_walk():
    made = level_basis(5, torch.device("cpu"))
    after = np.arange(5)
    walk = np.minimum.outer(after, after)  # of independent steps, between frames
    centre = np.eye(5) - 1 / 5
    expected = centre @ (np.outer(after, after) + WALK_SIGMA_RATIO**2 * walk) @ centre
    np.testing.assert_allclose((made @ made.T).numpy(), expected, atol=1e-12)


def test_without_strength_there_is_none():
    field = drift([0.0, 1.0, 2.0])
    field.sigma.zero_()
    assert not field().any()
    assert field.penalty() is None


@pytest.mark.parametrize(
    "field",
    [DCT((1, 1, *SIZE), order=6, sigma=1.0), Radial((1, 1, *SIZE), order=6, centre=(2.0, -3.5), sigma=1.0)],
    ids=["dct", "radial"],
)
def test_each_term_has_mean_zero_and_without_strength_none_shows(field):
    assert torch.allclose(field.sample_basis().mean((1, 2)), torch.zeros(len(field.values)), atol=1e-6)
    other = type(field)((1, 1, *SIZE))
    other.values.data.fill_(3.0)
    assert not other().any()


def test_a_map_is_the_inverse_cosine_transform_of_its_coefficients():
    field = DCT((1, 1, *SIZE), order=5, sigma=1.0)
    with torch.no_grad():
        field.values.copy_(torch.randn(len(field.values)))
    table = fft.dctn(field()[0, 0].detach().double().numpy(), norm="ortho") / np.sqrt(SIZE[0] * SIZE[1])
    found = table[field.order_y, field.order_x] * field.frequency.square().numpy()
    np.testing.assert_allclose(found, field.values.detach(), atol=1e-5)
    table[field.order_y, field.order_x] = 0
    assert np.abs(table).max() < 1e-6


@settings(max_examples=20, deadline=None)
@given(st.integers(8, 40), st.integers(8, 40), st.integers(1, 12))
def test_the_prior_is_the_energy_of_a_bent_plate(height, width, order):
    """`½ Σ |Δ s|²` of continuous waves: the mean over the frame, in units of its longer side."""
    field = DCT((1, 1, height, width), order=order, sigma=1.0)
    per_side = torch.pi / max(height, width)
    assert torch.allclose(
        (field.basis_y[field.order_y].square().mean(1) * field.basis_x[field.order_x].square().mean(1)).sqrt(),
        torch.ones(len(field.values)),
        atol=1e-5,
    )
    ky, kx = torch.pi * field.order_y / height, torch.pi * field.order_x / width
    bent = (ky.square() + kx.square()) / field.frequency.square()  # |Δ| of each term
    assert torch.allclose(bent, torch.full_like(bent, per_side**2), rtol=1e-5)


def test_a_radial_map_depends_on_the_distance_from_its_axis_alone():
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    distance = np.hypot(y - (SIZE[0] - 1) / 2 - 2.0, x - (SIZE[1] - 1) / 2 + 3.5)
    truth = np.cos(distance / 6)
    field = Radial((1, 1, *SIZE), order=20, centre=(2.0, -3.5), sigma=1.0)
    field.init_from(torch.from_numpy(truth)[None, None].float())
    error = field()[0, 0].detach().numpy() - (truth - truth.mean())
    assert np.abs(error).max() < 0.02
