"""Non-uniformity correction where little is seen."""

import numpy as np

import deepir
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
