"""A plain scene behind a pattern that is many times the noise."""

import dataclasses

import numpy as np

import deepir
from deepir.metrics import motion_error, scores
from deepir.simulate import Settings, simulate
from deepir.simulate.scenes.procedural import sky


def test_the_motion_is_found_to_hundredths_once_the_pattern_is_known():
    """The registration, which does not know the pattern, is a px off."""
    pattern = {
        "gain_row": 0.05,
        "offset_row": 0.03,
        "offset_column": 0.02,
        "offset_pixel": 0.02,
        "shading": 0.0,
    }
    camera = Settings(n_frames=6, shape=(96, 128), counts=True, gain_pixel=0.01, read_noise=0.0007, **pattern)
    camera = dataclasses.replace(camera, pedestal=3000.0, max_rotation=2.0)
    sim = simulate(sky(4, (430, 500)), camera, seed=87)
    result = deepir.run("nuc", frames=sim.frames, threads=1)
    assert motion_error(result.motion, sim.truth.motion, camera.shape) < 0.05
    assert scores(result.scene, sim.truth.scene)["psnr_aligned"] > 57
    assert np.abs(result.gain - sim.truth.gain).max() < 0.05
