"""Parallax in the simulator."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from deepir.errors import ConfigError
from deepir.simulate import Settings, simulate

CAMERA = Settings(
    n_frames=3, shape=(64, 80), max_shift=6.0, gain_pixel=0.0, gain_column=0.0, offset_pixel=0.0, offset_column=0.0,
    offset_row=0.0, shading=0.0, read_noise=0.0, dead_pixels=0.0,
)  # fmt: skip


def test_frames_are_the_scene_where_the_flow_says_they_look():
    sim = simulate(None, replace(CAMERA, parallax=3.0), seed=1)
    y, x = np.mgrid[:64, :80]
    for frame, (along_x, along_y) in zip(sim.frames[1:], sim.truth.flow[1:], strict=True):
        at = np.stack((y + along_y, x + along_x))
        seen = ((at > 3) & (at < np.array([60, 76])[:, None, None])).all(0)
        expected = ndimage.map_coordinates(sim.truth.scene, at, order=3)
        flat = ndimage.map_coordinates(sim.truth.scene, [y + along_y.mean(), x + along_x.mean()], order=3)
        error, without = (np.abs(each - frame)[seen].mean() for each in (expected, flat))
        assert error < 0.003  # a pixel's box is not quite that of a pixel which is moved
        assert error < without / 5


def test_parallax_is_in_proportion_to_the_shift_and_along_it():
    sim = simulate(None, replace(CAMERA, parallax=3.0), seed=1)
    flat = simulate(None, CAMERA, seed=1)
    beside = sim.truth.flow - flat.truth.flow
    shift = flat.truth.motion[:, :2, 2]
    assert not beside[0].any()
    for away, toward in zip(beside[1:], shift[1:], strict=True):
        share = away / (3.0 * toward[:, None, None] / 6.0)  # the nearness
        assert np.allclose(share[0], share[1])
        assert share.min() >= 0
        assert 0.5 < share.max() <= 1.001


def test_without_it_the_flow_is_the_homographies_and_the_frames_are_as_before():
    sim = simulate(None, replace(CAMERA, motion="shift"), seed=1)
    assert np.allclose(sim.truth.flow, sim.truth.motion[:, :2, 2, None, None])


def test_parallax_that_cannot_be_is_refused():
    with pytest.raises(ConfigError, match="hide each other"):
        simulate(None, replace(CAMERA, parallax=4.0))
    with pytest.raises(ConfigError, match="does not shift"):
        simulate(None, replace(CAMERA, parallax=1.0, max_shift=0.0))
