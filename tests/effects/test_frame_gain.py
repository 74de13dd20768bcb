"""A camera whose response drifts: each frame is brighter or darker throughout, and it shows in its contrast."""

import numpy as np
import pytest
import torch

import deepir
from deepir.effects.frame_gain import contrast_slopes
from deepir.metrics import scores
from deepir.simulate import Settings, simulate

CAMERA = Settings(n_frames=6, shape=(96, 128), counts=True, shading=0.0, dead_pixels=0.0)


def burst(drift, seed):
    """Frames whose response is a share higher than in the one before, and the scene."""
    sim = simulate(None, CAMERA, seed=seed)
    response = 1 + drift * np.arange(CAMERA.n_frames)[:, None, None]
    return np.rint(sim.frames * response), sim.truth.scene


def said(result):
    return any("response drifts" in message for message in result.messages)


@pytest.mark.parametrize(("seed", "least"), [(2, 30), pytest.param(7, 30, marks=pytest.mark.slow)])
def test_a_response_that_drifts_is_evened_out(seed, least):
    """By half a per cent a frame, beside a pedestal of five times the scene's range."""
    frames, scene = burst(0.005, seed)
    result = deepir.run("nuc", frames=frames, threads=1)
    assert said(result)
    assert scores(result.scene, scene)["psnr_aligned"] > least


@pytest.mark.parametrize("seed", [2, pytest.param(7, marks=pytest.mark.slow)])
def test_a_steady_response_is_left_as_it_is(seed):
    frames, _ = burst(0.0, seed)
    assert not said(deepir.run("nuc", frames=frames, threads=1))


def test_a_frames_contrast_is_its_slope_on_what_is_expected_and_nothing_slow_counts():
    expected = torch.randn(3, 20, 24, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    y, x = torch.linspace(-1, 1, 20)[:, None], torch.linspace(-1, 1, 24)
    contrast = torch.tensor([0.9, 1.0, 1.2], dtype=torch.float64)
    frames = contrast[:, None, None] * expected + 50 * x * y - 30 * y**2 + 7
    found, information = contrast_slopes(frames, expected, torch.ones_like(frames), 2)
    torch.testing.assert_close(found, contrast)
    assert (information > 300).all()  # next to as many as there are samples
