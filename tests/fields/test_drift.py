"""Levels go one way for a while, or walk: a steady change costs next to nothing, levels that jump cost much."""

import numpy as np
import pytest
import torch

from deepir.fields.drift import WALK_SIGMA_RATIO, Drift, level_basis


def drift(levels, sigma=1.0):
    field = Drift((len(levels), 1, 1, 1), sigma=sigma)
    field.init_from(torch.tensor(levels, dtype=torch.float32)[:, None, None, None])
    return field


@pytest.mark.parametrize("levels", [[0.0, 1.0, 2.0, 3.0], [0.5, -1.0, 2.0], [3.0, -3.0]])
def test_levels_are_what_they_were_set_to_less_their_mean(levels):
    found = drift(levels)().detach().flatten().numpy()
    np.testing.assert_allclose(found, np.subtract(levels, np.mean(levels)), atol=1e-5)


def test_a_steady_change_of_sigma_a_frame_costs_half_a_nat_at_most():
    assert 0 < float(drift([*range(8)]).penalty().detach()) < 0.5


def test_levels_that_jump_cost_more_than_a_steady_change_as_large():
    steady, jumps = drift([0.0, 1, 2, 3, 4, 5]), drift([0.0, 5, 0, 5, 0, 5])
    assert float(jumps.penalty().detach()) > 50 * float(steady.penalty().detach())


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
