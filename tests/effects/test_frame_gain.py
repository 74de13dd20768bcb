"""Gains of whole frames: a response that drifts, and exposures that differ, are evened out, level and contrast."""

import numpy as np
import pytest
import torch

import deepir
from deepir.effects.frame_gain import contrast_slopes
from tests.effects.solved import burst, psnr


def drifting(drift, seed):
    """The result of frames whose response is a share higher than in the one before, and the burst."""
    sim = burst(seed, n_frames=6, shape=(96, 128))
    response = 1 + drift * np.arange(6)[:, None, None]
    return deepir.run("nuc", frames=np.rint(sim.frames * response), threads=1), sim


def said(result):
    return any("response drifts" in message for message in result.messages)


@pytest.mark.parametrize("seed", [2, pytest.param(7, marks=pytest.mark.slow)])
def test_a_response_that_drifts_is_evened_out(seed):
    """By half a per cent a frame, beside a pedestal of five times the scene's range."""
    result, sim = drifting(0.005, seed)
    assert said(result)
    assert psnr(result, sim) > 30


@pytest.mark.parametrize("counts", [False, True])
@pytest.mark.parametrize("ratio", [1.1, pytest.param(2.0, marks=pytest.mark.slow)])
def test_an_exposure_that_alternates_is_evened_out(ratio, counts):
    sim = burst(1, counts=counts, shading=0.1, dead_pixels=0.002)
    frames = sim.frames * np.where(np.arange(5) % 2, ratio, 1.0)[:, None, None]
    result = deepir.run("nuc", frames=frames, threads=1)
    assert psnr(result, sim) > 28
    assert said(result)


def test_a_frames_contrast_is_its_slope_on_what_is_expected_and_nothing_slow_counts():
    expected = torch.randn(3, 20, 24, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    y, x = torch.linspace(-1, 1, 20)[:, None], torch.linspace(-1, 1, 24)
    contrast = torch.tensor([0.9, 1.0, 1.2], dtype=torch.float64)
    frames = contrast[:, None, None] * expected + 50 * x * y - 30 * y**2 + 7
    found, information = contrast_slopes(frames, expected, torch.ones_like(frames), 2)
    torch.testing.assert_close(found, contrast)
    assert (information > 300).all()  # next to as many as there are samples
