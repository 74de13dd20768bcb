"""Statistics of patterns that are known."""

import numpy as np
import pytest
from scipy import ndimage

from deepir.analysis import flat_statistics, map_statistics
from deepir.analysis.burst_assessment import correlation_length
from deepir.simulate import Settings, simulate

SIZE = (160, 192)


def blurred(sigma, seed=0):
    """White noise under a Gaussian: its autocorrelation is exp(-lag^2 / 4 sigma^2)."""
    noise = np.random.default_rng(seed).standard_normal(SIZE)
    found = ndimage.gaussian_filter(noise, sigma, mode="wrap")
    return found / found.std()


@pytest.mark.parametrize("sigma", [(1.0, 1.0), (2.0, 2.0), (1.0, 3.0), (2.5, 0.5)])
def test_correlation_lengths_are_found_within_a_pixel(sigma):
    y, x = (2 * each * np.sqrt(np.log(10)) for each in sigma)
    found = map_statistics(blurred(sigma))
    assert found.lengths == pytest.approx((x, y), abs=1)


@pytest.mark.parametrize("decay", [0.3, 0.6, 0.8])
def test_lengths_of_columns_are_those_along_x(decay):
    # A pattern of columns, each like the one before it.
    rng, columns = np.random.default_rng(1), [0.0]
    for _ in range(5 * SIZE[1]):
        columns.append(decay * columns[-1] + rng.standard_normal())
    found = map_statistics(np.tile(columns[-4 * SIZE[1] :], (120, 1)))
    assert found.columns > 0.9
    assert found.lengths[0] == pytest.approx(np.log(0.1) / np.log(decay), abs=1)


def test_white_noise_asks_for_a_pixel_and_is_no_lines():
    found = map_statistics(np.random.default_rng(2).standard_normal(SIZE))
    assert max(found.lengths) <= 1
    assert max(found.rows, found.columns, found.shading) < 0.02


def test_the_shares_of_lines_and_shading_are_found():
    rng = np.random.default_rng(3)
    y, x = np.meshgrid(*(np.linspace(-1, 1, side) for side in SIZE), indexing="ij")
    parts = {
        "rows": rng.standard_normal((SIZE[0], 1)) + 0 * x,
        "columns": 1.5 * rng.standard_normal((1, SIZE[1])) + 0 * x,
        "shading": 2 * (x + y * y),
    }
    pattern = sum(parts.values()) + rng.standard_normal(SIZE)
    found = map_statistics(pattern)
    for name, part in parts.items():
        assert getattr(found, name) == pytest.approx(part.var() / pattern.var(), abs=0.08)


def test_bad_pixels_do_not_count():
    pattern, good = blurred(2.0), np.ones(SIZE, bool)
    good[10:20, 30:60] = False
    spoilt = np.where(good, pattern, 1e4)
    assert map_statistics(spoilt, good).lengths == pytest.approx(map_statistics(pattern).lengths, abs=0.5)


@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_noise_of_a_flat_stack_makes_the_pattern_no_shorter(noise):
    rng = np.random.default_rng(4)
    frames = blurred(1.5) + noise * rng.standard_normal((8, *SIZE))
    assert flat_statistics(frames).lengths == pytest.approx((4.55, 4.55), abs=0.7)


@pytest.mark.parametrize("decay", [0.9, 0.97, 0.99])
def test_for_how_long_a_drifting_pattern_holds_is_found(decay):
    rng, frames = np.random.default_rng(5), [np.random.default_rng(6).standard_normal((60, 80))]
    for _ in range(60):
        frames.append(decay * frames[-1] + np.sqrt(1 - decay**2) * rng.standard_normal((60, 80)))
    noisy = np.array(frames) + 0.5 * rng.standard_normal((61, 60, 80))
    assert flat_statistics(noisy).stable_frames == pytest.approx(np.log(0.8) / np.log(decay), rel=0.15)


def test_a_pattern_that_stays_holds_for_ever():
    frames = blurred(1.0) + 0.3 * np.random.default_rng(7).standard_normal((20, *SIZE))
    assert flat_statistics(frames).stable_frames == np.inf


def test_the_simulators_camera_has_lines_and_pixels():
    settings = Settings(n_frames=1, shading=0.0, dead_pixels=0.0, gain_pixel=0.0, gain_column=0.0)
    truth = simulate(None, settings, seed=0).truth
    found = map_statistics(truth.offset)
    total = 0.027**2 + 0.04**2 + 0.027**2
    assert found.columns == pytest.approx(0.04**2 / total, abs=0.1)
    assert found.rows == pytest.approx(0.027**2 / total, abs=0.1)


def test_a_length_lies_between_lags():
    assert correlation_length(np.array([1.0, 0.2, 0.0])) == 1.5
    assert correlation_length(np.ones(5)) == np.inf
