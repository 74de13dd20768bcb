"""Frames of exposures that differ are brought to one, level and contrast together."""

import numpy as np
import pytest

import deepir
from deepir.metrics import scores
from deepir.simulate import Settings, simulate


@pytest.mark.parametrize("counts", [False, True])
@pytest.mark.parametrize("ratio", [1.1, pytest.param(2.0, marks=pytest.mark.slow)])
def test_an_exposure_that_alternates_is_evened_out(ratio, counts):
    """Levels that alternate with the camera's motion would else stand in the scene as a slope: 17 to 25 dB."""
    sim = simulate(None, Settings(n_frames=5, shape=(80, 96), counts=counts), seed=1)
    frames = sim.frames * np.where(np.arange(5) % 2, ratio, 1.0)[:, None, None]
    result = deepir.run("nuc", frames=frames, threads=1)
    assert scores(result.scene, sim.truth.scene)["psnr_aligned"] > 28
    assert any("response drifts" in message for message in result.messages)
