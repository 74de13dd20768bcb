"""Maps of few terms: what they can be, and what is expected of them."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import fft

from deepir.fields.basis_expansion import DCT, Radial

SIZE = (24, 30)
FIELDS = [
    DCT((1, 1, *SIZE), order=6, sigma=1.0),
    Radial((1, 1, *SIZE), order=6, centre=(2.0, -3.5), sigma=1.0),
]


@pytest.mark.parametrize("field", FIELDS, ids=["dct", "radial"])
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
