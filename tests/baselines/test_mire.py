"""Midway equalisation."""

import numpy as np
import pytest

from deepir.baselines.single_frame.mire import equalise, midway_equalise
from deepir.metrics import scores


@pytest.fixture
def flat():
    """A picture whose columns all hold the same values, each in an order of its own."""
    rng = np.random.default_rng(0)
    values = np.linspace(0, 1, 60)
    return np.stack([np.roll(values, -x // 3) for x in range(80)], 1) + 0 * rng.random()


def test_columns_with_one_histogram_stay(flat):
    assert np.allclose(midway_equalise(flat, 3.0), flat)


def test_any_increasing_response_of_columns_is_undone_if_all_see_the_same_values(flat):
    # Not only gain and offset: the method is blind to what the response is.
    rng = np.random.default_rng(1)
    response = np.exp(0.2 * rng.standard_normal(80)) * flat ** np.exp(0.2 * rng.standard_normal(80))
    before, after = (scores(each, flat)["psnr_aligned"] for each in (response, equalise(response)))
    assert after > before + 10


def test_the_mean_is_kept(flat):
    tilted = flat + np.linspace(0, 3, 80)
    assert midway_equalise(tilted, 8.0).mean() == pytest.approx(tilted.mean(), rel=1e-12)


def test_the_order_within_a_column_is_kept(flat):
    noisy = flat + np.random.default_rng(2).standard_normal(flat.shape)
    assert np.array_equal(midway_equalise(noisy, 2.0).argsort(axis=0), noisy.argsort(axis=0))
