"""The detector from its physics."""

import dataclasses

import numpy as np
import pytest

from deepir.simulate import Settings, simulate
from deepir.simulate.detector import bolometer_pixels, housing_flux

CAMERA = Settings(
    n_frames=4, shape=(60, 80), bolometer=True, counts=True, dead_pixels=0.0, tau=10.0, substeps=2
)


def drawn(settings=CAMERA):
    return bolometer_pixels(settings, np.random.default_rng(0))


def test_a_scene_of_the_pixels_own_flux_shows_no_pattern():
    """`y = g (Phi - Phi_fpa)`: where nothing is exchanged, no pixel warms, whatever its gain."""
    gain, offset, _ = drawn()
    own = CAMERA.pedestal + 0.5 * CAMERA.contrast
    np.testing.assert_allclose(gain * own + offset, own, rtol=1e-12)


def test_columns_share_a_bias_current():
    gain, _, _ = drawn()
    single = (gain - gain.mean(0)).std()
    assert gain.mean(0).std() == pytest.approx(0.01, rel=0.3)
    assert single == pytest.approx((2 * 0.01**2 + 0.005**2 + 0.02**2) ** 0.5, rel=0.05)


def test_pixels_that_lose_their_heat_slowly_are_slow_and_sensitive():
    gain, _, slowness = drawn()
    assert slowness.mean() == pytest.approx(1)
    assert np.corrcoef(gain.ravel(), slowness.ravel())[0, 1] > 0.5


def test_gain_offset_and_time_constants_are_in_the_truth():
    truth = simulate(settings=CAMERA, seed=1).truth
    assert truth.gain.mean() == pytest.approx(1)
    assert truth.offset.mean() == pytest.approx(0, abs=1e-9)
    assert np.corrcoef(truth.gain.ravel(), truth.offset.ravel())[0, 1] < -0.999
    assert truth.tau.std() == pytest.approx(0.22, rel=0.15)


def test_a_warming_housing_adds_flux_most_at_the_corners():
    warmth = housing_flux(dataclasses.replace(CAMERA, housing_drift=0.6))
    assert not warmth[0].any()
    np.testing.assert_allclose(np.diff(warmth, axis=0), warmth[1] * np.ones((3, 1, 1)))
    assert warmth[1, 30, 40] == pytest.approx(1500 * 0.6 / 60, rel=1e-3)  # a frame's time, on the axis
    assert 1.03 < warmth[1, 0, 0] / warmth[1, 30, 40] < 1.1


def test_what_the_housing_adds_is_what_the_frames_have_more_of():
    still = dataclasses.replace(
        CAMERA, max_shift=0.0, max_rotation=0.0, counts=False, tau=0.0, read_noise=0.0
    )
    warm = dataclasses.replace(still, housing_drift=3.0)
    cold, hot = (simulate(settings=settings, seed=2) for settings in (still, warm))
    added = hot.truth.gain * hot.truth.housing
    np.testing.assert_allclose(hot.frames - cold.frames, added, atol=1e-5)
