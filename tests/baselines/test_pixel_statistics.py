"""Gain and offset from statistics of each pixel: over time, of a sparse rest, and over the registered scene."""

import numpy as np
import pytest
from scipy import ndimage

import deepir
from deepir.baselines.pixel_statistics import (
    basic,
    constant_statistics,
    fit_lines,
    running_statistics,
    trajectory_means,
)
from deepir.baselines.rival import last_of
from deepir.metrics import scores
from deepir.simulate import Settings, simulate

# ---- constant statistics ----


def test_gain_and_offset_are_found_where_all_pixels_see_the_same_statistics():
    rng = np.random.default_rng(0)
    gain, offset = 1 + 0.1 * rng.standard_normal((8, 9)), 20 * rng.standard_normal((8, 9))
    found_gain, found_offset = constant_statistics(gain * rng.uniform(0, 100, (4000, 8, 9)) + offset)
    assert np.abs(found_gain - gain / gain.mean()).max() < 0.05
    assert np.corrcoef(found_offset.ravel(), offset.ravel())[0, 1] > 0.98


def test_frames_that_do_not_change_have_no_gain_and_the_recursion_gives_the_mean():
    frames = np.random.default_rng(1).random((7, 3, 4))
    gain, offset = constant_statistics(frames[[0, 0]])
    assert np.allclose(gain, 1)
    assert np.allclose(offset, frames[0] - frames[0].mean())
    assert np.allclose(last_of(running_statistics(frames))[0], frames.mean(0))


# ---- BaSiC ----


@pytest.fixture(scope="module")
def microscope():
    """Forty exposures of few bright cells under shading: frames and their flat field."""
    rng = np.random.default_rng(0)
    y, x = np.mgrid[-1:1:40j, -1:1:48j]
    flat = 1 - 0.3 * (x**2 + y**2) + 0.1 * x
    cells = ndimage.gaussian_filter(rng.normal(size=(40, 40, 48)), (0, 3, 3)) > 0.1
    exposures = rng.uniform(0.6, 1.4, (40, 1, 1))
    frames = 100 * (exposures + cells * rng.uniform(0.3, 1.0, (40, 1, 1))) * flat
    return frames + rng.normal(size=frames.shape), flat / flat.mean()


def error(found, flat):
    return np.std(found / found.mean() - flat) / np.std(flat)


def test_sparse_scenes_stay_out_of_the_flat_field(microscope):
    frames, flat = microscope
    found, dark = basic(frames)
    assert error(found, flat) < 0.8 * error(frames.mean(0), flat)
    assert error(found, flat) < 0.2
    assert found.mean() == pytest.approx(1)
    assert dark.mean() == pytest.approx(0, abs=1e-9)


def test_another_unit_scales_the_dark_field_alone(microscope):
    frames, _ = microscope
    found, again = basic(frames), basic(8 * frames)
    np.testing.assert_allclose(again[0], found[0], rtol=1e-6)
    np.testing.assert_allclose(again[1], 8 * found[1], atol=1e-6)


# ---- regression on the registered scene ----


def test_lines_are_found_and_a_pixel_that_sees_one_value_has_an_offset_only():
    rng = np.random.default_rng(0)
    gain, bias, scene = 1 + 0.1 * rng.random((4, 5)), rng.random((4, 5)), rng.random((6, 4, 5))
    found = fit_lines(scene, gain * scene + bias)
    assert np.allclose(found[0], gain)
    assert np.allclose(found[1], bias)
    assert fit_lines(np.full((3, 1, 1), 2.0), np.full((3, 1, 1), 2.5)) == (1, 0.5)


def test_the_scene_along_the_motion_is_that_of_each_frame():
    # Whole shifts without pattern: what is averaged is always the same scene.
    scene = np.random.default_rng(1).random((40, 48)).cumsum(0).cumsum(1)
    shifts = [(0, 0), (3, -2), (-4, 1)]
    frames = np.stack([scene[8 + y : 32 + y, 8 + x : 40 + x] for x, y in shifts])
    motion = np.tile(np.eye(3), (3, 1, 1))
    motion[:, :2, 2] = shifts
    assert np.allclose(trajectory_means(frames, np.ones(frames.shape, bool), motion), frames)


def test_many_frames_give_the_offset_back():
    camera = Settings(n_frames=24, shape=(48, 64), gain_pixel=0.0, gain_column=0.0, shading=0.0, dead_pixels=0.0)
    sim = simulate(None, camera, seed=1)
    result = deepir.run("nuc", frames=sim.frames, method="hardie2000")
    assert np.corrcoef(result.offset.ravel(), sim.truth.offset.ravel())[0, 1] > 0.9
    before, after = (scores(each, sim.truth.scene)["psnr_aligned"] for each in (sim.frames[0], result.scene))
    assert after > before + 8
