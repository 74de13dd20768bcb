"""The detector: gain and offset, bad pixels, noise, bolometers, and their lag."""

import dataclasses

import numpy as np
import pytest
from cameras import clean

from deepir.simulate import ADC_MAX, Settings, render, simulate
from deepir.simulate.detector import bolometer_pixels, housing_flux, smooth_path

PATTERN = Settings(gain_row=0.02, gain_column=0.1, level_drift=0.05, dead_pixels=0.01, shape=(40, 56))
FLAT = np.full((300, 300), 0.4)


def having(**changes: object):
    return simulate(settings=dataclasses.replace(PATTERN, **changes), seed=4)


# ---- pattern, units ----


@pytest.mark.parametrize("distribution", ["normal", "uniform"])
@pytest.mark.parametrize("counts", [False, True])
def test_the_truth_is_in_the_gauge_of_the_pixels_that_are_good(distribution, counts):
    truth = having(
        gain_distribution=distribution, counts=counts, stuck_pixels=0.05, noisy_pixels=0.05, gain_shading=0.2
    ).truth
    good = ~truth.bad_pixels
    assert truth.gain[good].mean() == pytest.approx(1, abs=1e-12)
    assert truth.offset[good].mean() == pytest.approx(0, abs=1e-9)
    assert truth.level.mean() == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize("counts", [False, True])
def test_without_noise_the_reference_is_gain_times_scene_plus_offset_plus_level(counts):
    """In counts the gain acts on the pedestal too, and frames are 14-bit integers."""
    result = having(counts=counts, read_noise=0.0)
    truth, good = result.truth, ~result.truth.bad_pixels
    expected = truth.gain * truth.scene + truth.offset + truth.level[0]
    np.testing.assert_allclose(result.frames[0][good], expected[good], atol=0.5 if counts else 1e-6)
    if counts:
        assert result.frames.dtype == np.uint16
        assert result.frames.max() == ADC_MAX  # stuck high
        assert result.frames.min() == 0  # stuck low
        assert 7900 < truth.scene.min() < truth.scene.max() < 9600


def test_uniform_columns_are_those_of_the_paper():
    gain = simulate(settings=clean(gain_distribution="uniform", gain_column=0.5, shape=(16, 400))).truth.gain
    assert not np.ptp(gain, axis=0).any()
    assert gain.min() / gain.max() == pytest.approx(0.5, abs=0.02)  # U(v, 1) with v = 0.5
    assert gain[0].std() / gain.max() == pytest.approx(0.5 / np.sqrt(12), rel=0.1)


def test_both_shadings_are_quadratic_as_large_as_asked_and_know_nothing_of_each_other():
    truth = simulate(settings=clean(gain_shading=0.2, shading=0.3, shape=(120, 160))).truth
    assert truth.gain.mean() == pytest.approx(1, abs=1e-12)
    assert (np.ptp(truth.gain), np.ptp(truth.offset)) == pytest.approx((0.2, 0.3))
    y, x = np.mgrid[-1:1:120j, -1:1:160j]
    quadratic = np.stack([np.ones_like(x), x, y, x * y, x**2, y**2], -1).reshape(-1, 6)
    _, rest, *_ = np.linalg.lstsq(quadratic, np.stack([truth.gain.ravel(), truth.offset.ravel()], 1))
    assert rest.max() < 1e-12
    assert abs(np.corrcoef(truth.gain.ravel(), truth.offset.ravel())[0, 1]) < 0.95


# ---- bad pixels, noise ----


def test_bad_pixels_are_as_many_as_asked_and_tell_nothing():
    result = having(dead_pixels=0.03)
    assert result.truth.bad_pixels.sum() == round(0.03 * 40 * 56)
    stuck = np.ptp(result.frames, axis=0) == 0
    assert stuck.sum() == pytest.approx(2 / 3 * result.truth.bad_pixels.sum(), abs=1)
    assert not (stuck & ~result.truth.bad_pixels).any()


@pytest.mark.parametrize("counts", [False, True])
def test_stuck_pixels_hide_in_the_scenes_range(counts):
    found = having(stuck_pixels=0.02, dead_pixels=0.0, counts=counts)
    stuck, scene = found.truth.bad_pixels, found.truth.scene
    assert stuck.sum() == round(0.02 * stuck.size)
    assert not np.ptp(found.frames[:, stuck].astype(float), axis=0).any()
    assert scene.min() - 1 <= found.frames[:, stuck].min() < found.frames[:, stuck].max() <= scene.max() + 1


@pytest.mark.parametrize("photons", [0.0, 300.0])
def test_noisy_pixels_have_ten_times_the_noise(photons):
    settings = clean(read_noise=0.01, photons=photons, noisy_pixels=0.2, n_frames=60, max_shift=0.0, shape=(48, 56))
    found = simulate(np.full((200, 220), 0.5), settings)
    noise, noisy = found.frames.std(0), found.truth.bad_pixels
    expected = np.sqrt(0.01**2 + (0.5 / photons if photons else 0))
    assert np.median(noise[noisy]) == pytest.approx(10 * expected, rel=0.05)
    assert np.median(noise[~noisy]) == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize("counts", [False, True])
def test_photon_noise_is_poisson(counts):
    """Mean g x and variance g x / photons_per_unit, on a flat scene."""
    settings = clean(photons=1000.0, counts=counts, n_frames=20, shape=(64, 64))
    result = simulate(FLAT, settings)
    expected = 8000 + 1500 * 0.4 if counts else 0.4
    variance = expected / result.truth.photons_per_unit
    assert result.frames.mean() == pytest.approx(expected, abs=5 * np.sqrt(variance / result.frames.size))
    assert result.frames.var() == pytest.approx(variance, rel=0.03)


def test_read_noise_has_its_sigma_in_the_datas_units():
    result = simulate(FLAT, clean(read_noise=0.004, counts=True, shape=(64, 64)))
    assert result.truth.read_noise == pytest.approx(6.0)
    assert result.frames.std() == pytest.approx(np.sqrt(6.0**2 + 1 / 12), rel=0.03)


def test_the_level_walks_at_random():
    level = simulate(settings=clean(level_drift=0.1, n_frames=200, shape=(8, 8))).truth.level
    assert np.diff(level).std() == pytest.approx(0.1, rel=0.15)


# ---- bolometers ----


BOLOMETERS = Settings(n_frames=4, shape=(60, 80), bolometer=True, counts=True, dead_pixels=0.0, tau=10.0, substeps=2)


def test_bolometers_share_a_current_in_columns_and_those_that_lose_heat_slowly_are_slow_and_sensitive():
    gain, offset, slowness = bolometer_pixels(BOLOMETERS, np.random.default_rng(0))
    # `y = g (Phi - Phi_fpa)`: where nothing is exchanged, no pixel warms, whatever its gain.
    own = BOLOMETERS.pedestal + 0.5 * BOLOMETERS.contrast
    np.testing.assert_allclose(gain * own + offset, own, rtol=1e-12)
    assert gain.mean(0).std() == pytest.approx(0.01, rel=0.3)
    assert (gain - gain.mean(0)).std() == pytest.approx((2 * 0.01**2 + 0.005**2 + 0.02**2) ** 0.5, rel=0.05)
    assert slowness.mean() == pytest.approx(1)
    assert np.corrcoef(gain.ravel(), slowness.ravel())[0, 1] > 0.5


def test_gain_offset_and_time_constants_are_in_the_truth():
    truth = simulate(settings=BOLOMETERS, seed=1).truth
    assert truth.gain.mean() == pytest.approx(1)
    assert truth.offset.mean() == pytest.approx(0, abs=1e-9)
    assert np.corrcoef(truth.gain.ravel(), truth.offset.ravel())[0, 1] < -0.999
    assert truth.tau.std() == pytest.approx(0.22, rel=0.15)


def test_a_warming_housing_adds_flux_to_the_frames_most_at_the_corners():
    still = dataclasses.replace(BOLOMETERS, max_shift=0.0, max_rotation=0.0, counts=False, tau=0.0, read_noise=0.0)
    cold, hot = (simulate(settings=dataclasses.replace(still, housing_drift=d), seed=2) for d in (0.0, 3.0))
    warmth = hot.truth.housing
    in_counts = housing_flux(dataclasses.replace(BOLOMETERS, housing_drift=3.0))
    np.testing.assert_allclose(in_counts, BOLOMETERS.contrast * warmth)
    np.testing.assert_allclose(hot.frames - cold.frames, hot.truth.gain * warmth, atol=1e-5)
    assert not warmth[0].any()
    np.testing.assert_allclose(np.diff(warmth, axis=0), warmth[1] * np.ones((3, 1, 1)))
    assert warmth[1, 30, 40] == pytest.approx(3.0 / 60, rel=1e-3)  # a frame's time, on the axis
    assert 1.03 < warmth[1, 0, 0] / warmth[1, 30, 40] < 1.1


# ---- lag ----


LAGGING = clean(n_frames=6, shape=(24, 32), scale=2.0, motion="shift", max_shift=4.0, tau=10.0)
RAMPS = np.linspace(0, 1, 100)[:, None] * np.linspace(0, 1, 120)


def lagging(**changes: object) -> Settings:
    return dataclasses.replace(LAGGING, **changes)


def test_the_path_is_smooth_starts_at_rest_and_reaches_what_the_settings_allow():
    way = smooth_path(lagging(n_frames=12, tremor=5.0), np.random.default_rng(0))
    assert way.shape == (11 * LAGGING.substeps + 1, 9)
    assert not way[0].any()
    np.testing.assert_allclose(np.abs(way).max(0), 1)
    jerk = np.abs(np.diff(way, n=2, axis=0)).max() / np.abs(np.diff(way, axis=0)).max()
    assert jerk < 0.1  # an instant's change of speed, in its speed


def test_each_frame_is_what_the_camera_sees_drawn_along_its_path():
    """Over a ramp a lag shows where the camera was a while ago: the lagged path itself."""
    y = np.broadcast_to(np.linspace(0, 1, 100)[:, None], (100, 120))
    sim = simulate(y, LAGGING, seed=2)
    per_px = np.diff(sim.frames[0].astype(float), axis=0).mean()
    seen = (sim.frames - sim.frames[0]).mean((1, 2)) / per_px  # px along y
    way = 4 * smooth_path(LAGGING, np.random.default_rng(2).spawn(9)[8])[:, 1]
    step = 1000 / (LAGGING.fps * LAGGING.substeps)
    late = np.zeros_like(way)
    for i in range(1, len(way)):  # the mean of both ends of a step
        late[i] = late[i - 1] + (1 - np.exp(-step / 10)) * ((way[i] + way[i - 1]) / 2 - late[i - 1])
    np.testing.assert_allclose(seen, late[:: LAGGING.substeps], atol=0.02)
    np.testing.assert_allclose(sim.truth.motion[:, 1, 2], way[:: LAGGING.substeps], atol=1e-12)


def test_pixels_that_follow_at_once_show_the_scene_where_the_camera_is():
    sim = simulate(RAMPS, lagging(tau=1e-3), seed=1)
    expected = render(RAMPS, sim.truth.motion, LAGGING.shape, LAGGING.scale)
    np.testing.assert_allclose(sim.frames, expected, atol=1e-4)
    assert not simulate(RAMPS, lagging(tau=0.0), seed=1).truth.tau.any()


def test_the_first_frame_has_settled_and_the_truth_holds_each_pixels_time_constant():
    sim = simulate(RAMPS, lagging(tau_pixel=0.1), seed=1)
    np.testing.assert_allclose(sim.frames[0], sim.truth.scene, atol=1e-6)
    assert sim.truth.tau.shape == LAGGING.shape
    assert sim.truth.tau.mean() == pytest.approx(10, rel=0.02)
    assert sim.truth.tau.std() == pytest.approx(1, rel=0.1)


def test_rows_are_read_one_after_the_other_and_the_last_as_the_frame_ends():
    rolling, at_once = (simulate(RAMPS, lagging(readout=r), seed=1).frames for r in (0.8, 0.0))
    np.testing.assert_array_equal(rolling[:, -1], at_once[:, -1])
    early, late = (np.abs(rolling[1:, row] - at_once[1:, row]).mean() for row in (2, -3))
    assert early > 3 * late > 0
