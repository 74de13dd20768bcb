"""Whole frames: a response that drifts and exposures that differ are evened out; tilts tell drift from shading."""

import numpy as np
import pytest
import torch

import deepir
from deepir.effects.frame_gain import contrast_slopes
from deepir.metrics import scores
from deepir.simulate import render
from deepir.simulate.scenes.procedural import procedural
from tests.effects.solved import burst, error, psnr, solved


def drifting(drift, seed):
    """The result of frames whose response is a share higher than in the one before, and the burst."""
    sim = burst(seed, n_frames=6, shape=(96, 128))
    response = 1 + drift * np.arange(6)[:, None, None]
    return deepir.run("nuc", frames=np.rint(sim.frames * response), threads=1), sim


@pytest.mark.parametrize("seed", [2, pytest.param(7, marks=pytest.mark.slow)])
def test_a_response_that_drifts_is_evened_out(seed):
    """By half a per cent a frame, beside a pedestal of five times the scene's range."""
    result, sim = drifting(0.005, seed)
    assert any("response drifts" in message for message in result.messages)
    assert psnr(result, sim) > 30


@pytest.mark.parametrize("counts", [False, True])
@pytest.mark.parametrize("ratio", [1.1, pytest.param(2.0, marks=pytest.mark.slow)])
def test_an_exposure_that_alternates_is_evened_out(ratio, counts):
    sim = burst(1, counts=counts, shading=0.1, dead_pixels=0.002)
    frames = sim.frames * np.where(np.arange(5) % 2, ratio, 1.0)[:, None, None]
    result = deepir.run("nuc", frames=frames, threads=1)
    assert psnr(result, sim) > 28
    assert any("response drifts" in message for message in result.messages)


def test_a_frames_contrast_is_its_slope_on_what_is_expected_and_nothing_slow_counts():
    expected = torch.randn(3, 20, 24, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    y, x = torch.linspace(-1, 1, 20)[:, None], torch.linspace(-1, 1, 24)
    contrast = torch.tensor([0.9, 1.0, 1.2], dtype=torch.float64)
    frames = contrast[:, None, None] * expected + 50 * x * y - 30 * y**2 + 7
    found, information = contrast_slopes(frames, expected, torch.ones_like(frames), 2)
    torch.testing.assert_close(found, contrast)
    assert (information > 300).all()  # next to as many as there are samples


@pytest.mark.parametrize(("n_frames", "share"), [(3, 0.4), (6, 0.2)])
def test_a_drift_is_found_but_for_a_slope_that_looks_the_same(n_frames, share):
    result, sim = solved(n_frames=n_frames, level_drift=0.03)
    apart = result.level - sim.truth.level
    assert np.abs(apart).max() < share * np.ptp(sim.truth.level)


@pytest.mark.parametrize("seed", [1, 3])
def test_a_small_drift_is_found_beside_strong_columns(seed):
    result, sim = solved(seed=seed, n_frames=6, level_drift=0.004, gain_column=0.03, offset_column=0.1)
    apart = result.level - (sim.truth.level - sim.truth.level.mean())
    assert np.abs(apart).max() < 0.2 * np.ptp(sim.truth.level)


def test_a_jump_of_the_level_by_twice_the_scene_is_taken_out():
    sim = burst(n_frames=6)
    jump = 2 * sim.settings.contrast * (np.arange(6) > 2)
    result = deepir.run("nuc", frames=sim.frames + jump[:, None, None], threads=1)
    assert np.abs(result.level - (jump - jump.mean())).max() < 0.01 * sim.settings.contrast
    assert error(result, sim) < 0.02 * sim.settings.contrast


@pytest.mark.parametrize("shading", [0.0, 0.5])
@pytest.mark.parametrize("n_frames", [3, 6])
def test_a_burst_without_drift_has_none_shaded_or_not(n_frames, shading):
    result, _ = solved(n_frames=n_frames, shading=shading)
    assert not result.level.any()


def test_shading_stronger_than_the_pixels_pattern_is_taken_out():
    result, sim = solved(shading=1.0, gain_pixel=0.005, gain_column=0.005)
    assert np.ptp(sim.truth.offset) > 1000
    assert error(result, sim) < 0.02 * sim.settings.contrast


@pytest.mark.parametrize(
    ("n_frames", "seed"),
    [(3, 2), pytest.param(3, 6, marks=pytest.mark.slow), (5, 2), pytest.param(5, 5, marks=pytest.mark.slow)],
)
def test_a_slope_of_the_sensor_is_separated_from_a_drift_and_from_the_scene(n_frames, seed):
    tones = {"counts": False, "photons": 1000.0, "read_noise": 0.002}
    result, sim = solved(seed=seed, n_frames=n_frames, shading=0.2, **tones)
    assert not result.level.any()
    assert error(result, sim) < 0.015


@pytest.mark.parametrize(("seed", "counts"), [(3, True), pytest.param(4, False, marks=pytest.mark.slow)])
def test_frames_that_are_smoothly_wrong_each_by_itself_are_not_shaded(seed, counts):
    sim = burst(seed, n_frames=6, shape=(96, 128), counts=counts)
    rng, (y, x) = np.random.default_rng(seed), np.mgrid[-1:1:96j, -1:1:128j]
    wrong = sum(rng.normal(size=(6, 1, 1)) * each for each in (x, y, x * y, x**2 - 1 / 3))
    frames = sim.frames + 0.01 * sim.frames[0].std() * wrong
    result = deepir.run("nuc", frames=frames, threads=1)
    assert psnr(result, sim) > 42


@pytest.mark.parametrize(("slope", "kind"), [pytest.param(0.0, 0, marks=pytest.mark.slow), (60.0, 0), (0.0, 2)])
def test_a_pan_over_which_the_level_rises_steadily_is_no_slope_of_the_scene(slope, kind):
    """A slope of the scene, the opposite one of the offset and a steady drift are the same frames: the least it is."""
    rng = np.random.default_rng(0)
    motion = np.repeat(np.eye(3)[None], 8, 0)
    motion[:, 0, 2], motion[:, 1, 2] = 2.5 * np.arange(8), 2.0 * (np.arange(8) % 3)
    flux = render(procedural(kind, (240, 300)), motion, (96, 128), 2.0, 0.5)
    scene, gain = 8000 + 1500 * flux, rng.normal(1, 0.02, (96, 128))
    offset = rng.normal(0, 40, (96, 128)) + rng.normal(0, 60, 128) + slope * np.linspace(-1, 1, 128) ** 2
    rise = 5.0 * np.arange(8)
    frames = gain * scene + offset + rise[:, None, None] + rng.normal(0, 5, scene.shape)
    result = deepir.run("nuc", frames=frames, threads=1)
    assert np.abs(result.level - (rise - rise.mean())).max() < 0.2 * np.ptp(rise)
    assert scores(result.scene, scene[0])["psnr_aligned"] > 40
