"""Non-uniformity correction where little is seen."""

import numpy as np
import pytest
from scipy import ndimage

import deepir
from deepir.operators.warp import NOISE_GAIN
from deepir.penalties.tv import TV
from deepir.scenes import procedural
from deepir.simulate import Settings, simulate


def test_a_corner_that_one_frame_alone_shows_is_what_it_shows():
    camera = Settings(
        n_frames=10, counts=True, read_noise=0.003, shading=0.0, dead_pixels=0.0,
        offset_column=0.1, offset_pixel=0.1, max_rotation=3.0,
    )  # fmt: skip
    sim = simulate(procedural(6, (430, 500)), camera, seed=13)
    error = deepir.run("nuc", frames=sim.frames, threads=1).scene - sim.truth.scene
    # The pattern is some 300 counts a pixel; a corner that was made up had been off by 750.
    assert np.abs(error - np.median(error)).max() < 100


@pytest.mark.parametrize(("blur", "least", "most"), [(5.0, 2.5, 9.0), (0.0, 1.0, 2.0)])
def test_a_plain_scene_bears_a_stronger_prior_than_a_rich_one(blur, least, most):
    camera = Settings(n_frames=5, shape=(96, 120), photons=200.0, shading=0.0, dead_pixels=0.0)
    sim = simulate(ndimage.gaussian_filter(procedural(6, (260, 300)), blur), camera, seed=14)
    result = deepir.run("nuc", frames=sim.frames, threads=1)
    by_noise = TV().natural(NOISE_GAIN * result.metrics["noise_sigma"] / 5**0.5)
    assert least < result.metrics["strengths"]["scene.tv.weight"] / by_noise < most
