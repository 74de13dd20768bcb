"""Samples that are lost or masked: the frames register by the others."""

import numpy as np
import pytest
import torch
from registered import apart, camera_of_tones

from deepir.arrays.windows import fill_nearest
from deepir.registration import register
from deepir.simulate import simulate
from deepir.simulate.scenes.procedural import procedural

COUNTS = {"counts": True, "read_noise": 0.004, "photons": 0.0}


def registered(sim, valid):
    frames, valid = (torch.from_numpy(np.asarray(each)) for each in (sim.frames.astype(np.float32), valid))
    return register(fill_nearest(frames[:, None] * valid[:, None], valid[:, None])[:, 0], valid=valid)


def lost_bands(shape, seed):
    """Half of the frames lack 10 to 50 of their rows."""
    rng, valid = np.random.default_rng(seed), np.ones(shape, bool)
    for k in range(0, shape[0], 2):
        height = rng.integers(10, 50)
        top = rng.integers(0, shape[1] - height)
        valid[k, top : top + height] = False
    return valid


@pytest.mark.parametrize("camera", [{}, COUNTS], ids=["tones", "counts"])
@pytest.mark.parametrize("n_frames", [3, 5])
@pytest.mark.parametrize("seed", [1, 3, pytest.param(4, marks=pytest.mark.slow)])
def test_frames_that_lack_a_band_register(seed, n_frames, camera):
    sim = simulate(procedural(seed, (430, 500)), camera_of_tones(n_frames=n_frames, **camera), seed=seed)
    found = registered(sim, lost_bands(sim.frames.shape, seed))
    assert found.used.all()
    assert apart(sim, found.motion.numpy()[:, :2, 2]) < 0.25


def test_a_masked_object_does_not_bias_the_motion():
    settings = camera_of_tones(n_frames=5, walker=0.7, walker_contrast=0.5)
    sim = simulate(procedural(2, (430, 500)), settings, seed=61)
    found = registered(sim, ~sim.truth.moving)
    assert apart(sim, found.motion.numpy()[:, :2, 2]) < 0.1


def test_frames_that_show_everything_are_registered_as_they_are():
    sim = simulate(procedural(5, (430, 500)), camera_of_tones(n_frames=3), seed=7)
    frames = torch.from_numpy(sim.frames.astype(np.float32))
    whole = register(frames, valid=torch.ones_like(frames, dtype=torch.bool))
    assert torch.equal(whole.motion, register(frames).motion)
