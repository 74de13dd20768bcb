"""Residuals that are not noise are reported."""

import numpy as np
import pytest
import torch

import deepir
from deepir.diagnostics.fit import lag_correlation, residual_correlation
from tests.effects.solved import burst, solved

CAMERA = {"n_frames": 6, "shape": (96, 128)}


def said(result):
    return [each.name for each in result.messages if each.name in {"correlated-residuals", "thermal-lag"}]


@pytest.mark.parametrize("seed", [3, 4])
def test_noise_is_no_message(seed):
    assert said(solved(seed=seed, **CAMERA)[0]) == []


def test_a_cloud_that_moves_by_itself_is_reported():
    frames = burst(**CAMERA).frames.astype(float)
    y, x = np.mgrid[:96, :128]
    for k in range(len(frames)):
        frames[k] += 60 * np.exp(-((x - 20 - 12 * k) ** 2 + (y - 40) ** 2) / 800)
    assert said(deepir.run("nuc", frames=frames, threads=1)) == ["correlated-residuals"]


def test_slow_pixels_are_reported_as_such():
    frames = burst(**CAMERA).frames.astype(float)
    for k in range(1, len(frames)):
        frames[k] = 0.75 * frames[k] + 0.25 * frames[k - 1]
    assert said(deepir.run("nuc", frames=frames, threads=1)) == ["thermal-lag"]


def test_white_noise_is_not_alike_and_a_wave_is():
    generator = torch.Generator().manual_seed(0)
    noise = torch.randn(4, 1, 90, 120, generator=generator)
    precision = torch.ones_like(noise)
    precision[:, :, ::7] = 0
    assert abs(residual_correlation(noise * precision, precision)) < 0.01
    wave = (torch.arange(120) * (2 * torch.pi / 60)).sin().expand_as(noise)
    assert residual_correlation(wave * precision, precision) > 0.8


def test_a_tail_is_the_frame_before():
    generator = torch.Generator().manual_seed(0)
    flux = torch.randn(4, 1, 90, 120, generator=generator)
    noise = torch.randn(4, 1, 90, 120, generator=generator)
    late = torch.cat([torch.zeros(1, 1, 90, 120), 0.5 * (flux[:-1] - flux[1:])])
    assert abs(lag_correlation(noise, flux, torch.ones_like(flux))) < 0.03
    # A tail of half the difference has the power of half the noise's: a correlation of 1 / sqrt(3).
    assert lag_correlation(noise + late, flux, torch.ones_like(flux)) == pytest.approx(3**-0.5, abs=0.02)
