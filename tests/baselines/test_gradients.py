"""Offsets from gradients: medians over many frames, and polynomials that leave them sparse."""

import numpy as np
import pytest

import deepir
from deepir.baselines.gradients import legendre_products, low_order_bias, multiview_tv, multiview_tv_recursive
from deepir.simulate import Settings, simulate
from deepir.simulate.scenes.procedural import load_picture

NOISE = 0.5  # counts, standard deviation

# ---- many frames ----


@pytest.fixture(scope="module")
def sim():
    """Forty frames of 48 x 64 px, whose sensor has an offset only."""
    offsets = {"gain_pixel": 0.0, "gain_column": 0.0, "shading": 0.0, "dead_pixels": 0.0}
    return simulate(settings=Settings(n_frames=40, shape=(48, 64), own_scenes=True, **offsets), seed=1)


def likeness(first, second):
    return np.corrcoef(first.ravel(), second.ravel())[0, 1]


def test_where_most_frames_are_flat_the_offset_is_exact_and_the_others_do_not_matter():
    rng = np.random.default_rng(0)
    offset = rng.normal(size=(17, 22))
    frames = offset + np.arange(5.0)[:, None, None]
    np.testing.assert_allclose(multiview_tv(frames), offset - offset.mean(), atol=1e-10)
    frames[1], frames[4] = rng.normal(size=(2, 17, 22))
    np.testing.assert_allclose(multiview_tv(frames), offset - offset.mean(), atol=1e-10)


def test_a_frame_at_a_time_comes_closer_with_each(sim):
    found = [likeness(multiview_tv_recursive(sim.frames[:n]), sim.truth.offset) for n in (1, 10, 40)]
    assert found[0] < found[1] < found[2]
    assert found[2] > 0.9


@pytest.mark.parametrize("method", ["multiview_tv", "multiview_tv_recursive"])
def test_scenes_are_the_frames_without_the_offset(sim, method):
    result = deepir.run("multiview_nuc", frames=sim.frames, method=method)
    np.testing.assert_allclose(result.scene, sim.frames - result.offset, atol=1e-5)
    # Slow slopes, which many of the scenes have in common, it takes for the sensor's.
    assert likeness(np.diff(result.offset), np.diff(sim.truth.offset)) > 0.9
    assert np.all(result.gain == 1)


# ---- a polynomial of each frame ----


@pytest.fixture
def scene():
    """Plain rectangles, (96, 128) counts."""
    rng = np.random.default_rng(0)
    frame = np.full((96, 128), 100.0)
    for _ in range(6):
        top, left = rng.integers(0, 70), rng.integers(0, 100)
        frame[top : top + rng.integers(10, 40), left : left + rng.integers(10, 40)] += 30 * rng.standard_normal()
    return frame


@pytest.fixture
def quadratic():
    """A bias of 12 x + 20 x² - 8 y² + 6 x y counts less its mean, for x and y from -1 to 1."""
    y, x = np.linspace(-1, 1, 96)[:, None], np.linspace(-1, 1, 128)
    found = 12 * x + 20 * x**2 - 8 * y**2 + 6 * x * y
    return found - found.mean()


def noise(scene):
    return NOISE * np.random.default_rng(1).standard_normal(scene.shape)


def test_a_quadratic_bias_of_plain_parts_is_found_and_least_squares_take_edges_for_it(scene, quadratic):
    frame = scene + quadratic + noise(scene)
    sparser, sparse, square = ((low_order_bias(frame, exponent=p) - quadratic).std() for p in (0.7, 1.0, 2.0))
    assert max(sparser, sparse) < 0.04 * quadratic.std()
    assert square > 5 * sparse


def test_without_noise_it_is_exact_between_pixels_and_without_bias_a_frame_stays(scene, quadratic):
    assert np.allclose(low_order_bias(scene + quadratic, block=1), quadratic, atol=1e-3 * quadratic.std())
    assert low_order_bias(scene + noise(scene)).std() < NOISE
    assert np.abs(low_order_bias(np.full((96, 128), 7.0))).max() == 0


def test_means_of_blocks_see_a_gradient_below_the_step_of_rounding(scene):
    slope = 4 * np.linspace(-1, 1, 128) * np.ones((96, 1))
    fine, coarse = (low_order_bias(np.round(scene + slope + noise(scene) / 2), block=each) for each in (1, 8))
    assert (coarse - slope).std() < 0.1 * slope.std() < (fine - slope).std()


def test_terms_have_no_constant_and_as_many_as_the_degree_allows_in_small_frames_too():
    terms = legendre_products((20, 30), 3)
    assert terms.shape == (9, 20, 30)
    assert np.allclose(terms.mean((1, 2)), 0)
    frame = np.random.default_rng(2).standard_normal((16, 16))
    assert np.isfinite(low_order_bias(frame, degree=6)).all()


def test_a_bias_that_is_added_to_a_burst_is_added_to_its_offset(quadratic):
    settings = Settings(n_frames=4, shape=(96, 128), counts=True, max_shift=5.0, dead_pixels=0.0)
    frames = simulate(load_picture("camera"), settings, seed=4).frames
    before, after = (deepir.run("nuc", "method=low_order_bias", frames=each) for each in (frames, frames + quadratic))
    assert (after.offset - before.offset - quadratic).std() < 0.02 * quadratic.std()
    assert np.array_equal(after.gain, np.ones_like(after.gain))
