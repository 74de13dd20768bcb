"""Samples that are cut off at an end of the range are bounds: they cost little elsewhere, and say no more."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.ndimage import binary_dilation
from skimage.data import camera

import deepir
from deepir.io.inspection.samples import saturated_samples
from deepir.result import compare_to_truth
from deepir.simulate import Settings, simulate

CAMERA = Settings(
    n_frames=5, shape=(64, 80), counts=True, shading=0.0, dead_pixels=0.0, gain_pixel=0.005, gain_column=0.0
)


def counts(shape=(4, 40, 48)):
    return np.rint(np.random.default_rng(0).normal(8000, 300, shape))


def run(frames):
    return deepir.run("nuc", frames=frames, threads=1)


def error(result, truth, where):
    """Median of the scene's error after one level."""
    off = (result.scene - truth)[where]
    return np.median(np.abs(off - np.median(off)))


def error_rms(scene, truth, where):
    """Standard deviation of the scene's error after one gain and level."""
    gain, level = np.polyfit(scene[where], truth[where], 1)
    return np.std(gain * scene[where] + level - truth[where])


def test_a_pile_at_the_end_of_the_range_is_cut_off_a_thin_tail_is_not():
    frames = counts()
    assert saturated_samples(frames) is None
    assert np.array_equal(saturated_samples(np.minimum(frames, 8400)) == 1, frames >= 8400)
    assert np.array_equal(saturated_samples(np.maximum(frames, 7600)) == -1, frames <= 7600)


@pytest.mark.parametrize("limit", [1023, 4095, 16383, 65535])
def test_what_no_bits_can_hold_is_cut_off_if_it_is_one_sample(limit):
    frames = counts() * limit / 16383
    frames = np.rint(frames)
    frames[2, 5, 7] = limit
    assert np.argwhere(saturated_samples(frames) == 1).tolist() == [[2, 5, 7]]
    assert saturated_samples(frames + 0.5) is None


def test_pixels_that_are_at_the_end_in_all_frames_do_not_tell():
    frames = counts()
    frames[:, 3:9, 4:10], frames[:, 20] = 16383, 0
    frames[1, 3:9, 4:10] = np.nan
    assert saturated_samples(frames) is None


@pytest.fixture(scope="module")
def hot():
    """A burst with a hot disc, and one with its flux below that of all else; what the range ends at."""
    y, x = np.mgrid[:430, :500]
    scene = 0.4 * camera()[:430, :500] / 255
    scene[(y - 200) ** 2 + (x - 230) ** 2 < 60**2] = 1.0
    return simulate(scene, CAMERA, seed=5), 8000 + 0.6 * CAMERA.contrast


@pytest.fixture(scope="module")
def whole(hot):
    """The result of the burst with the hot disc, of which nothing is cut off."""
    return run(hot[0].frames)


@pytest.mark.parametrize("sign", [1, -1])
def test_what_is_cut_off_costs_little_elsewhere_and_is_a_bound_there(hot, whole, sign):
    sim, end = hot
    frames, truth = sign * sim.frames.astype(np.float64) + 20_000, sign * sim.truth.scene + 20_000
    end = sign * end + 20_000
    cut = run(sign * np.minimum(sign * frames, sign * end))
    away = binary_dilation(sim.truth.scene > 8500, iterations=4)
    assert error(cut, truth, ~away) < 1.4 * error(whole, sim.truth.scene, ~away)
    where = cut.extra["clipped"]
    assert set(np.unique(where)) == {0, sign}
    assert where.astype(bool).sum() > 0.5 * (sim.truth.scene > 8900).sum()
    assert (sim.truth.scene[where != 0] > 8700).all()  # on the disc, or half on its edge
    level = np.median((cut.scene - truth)[~away])
    assert (sign * (cut.scene - level)[where != 0] > sign * end - 100).all()
    assert cut.bad_pixels.mean() < 0.005
    assert sum("are cut off at" in message for message in cut.messages) == 1
    assert "clipped" not in whole.extra
    assert saturated_samples(frames) is None


def test_a_pixel_that_is_stuck_at_the_end_is_distinguished_from_what_is_saturated(hot):
    sim, end = hot
    frames = np.minimum(sim.frames, end)
    frames[:, [5, 50, 20], [60, 9, 15]] = end
    bad = run(frames).bad_pixels
    assert bad[[5, 50, 20], [60, 9, 15]].all()
    assert bad.sum() < 15


def test_pixels_of_a_large_offset_that_are_always_cut_off_do_not_spoil_the_rest():
    burst = simulate(settings=Settings(n_frames=6, shape=(80, 96), counts=True, pedestal=15250.0), seed=31)
    assert (burst.frames >= burst.frames.max()).all(0).mean() > 0.05
    inner = (slice(2, -2), slice(2, -2))
    result = run(burst.frames)
    assert error_rms(result.scene[inner], burst.truth.scene[inner], burst.truth.scene[inner] < 16300) < 6


def test_bounds_are_not_compared_with_the_truth():
    rng = np.random.default_rng(0)
    truth = rng.normal(size=(20, 24))
    scene, where = truth + 0.1 * rng.normal(size=truth.shape), np.zeros(truth.shape, np.int8)
    scene[:5], where[:5] = 0, 1
    burst = SimpleNamespace(truth={"scene": truth}, radiometry=None, size=truth.shape)
    result = SimpleNamespace(scene=scene, extra={"clipped": where}, gain=None, offset=None, motion=truth, messages=[])
    assert compare_to_truth(result, burst)["radiometric_rmse"] == pytest.approx(0.1, rel=0.1)
