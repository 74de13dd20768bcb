"""Frames of different scenes: one sensor, no motion."""

import numpy as np
import pytest

from deepir.errors import ConfigError, DataError
from deepir.simulate import Settings, simulate
from deepir.simulate.scenes.procedural import load_picture

VIEWS = Settings(n_frames=3, shape=(32, 40), own_scenes=True, dead_pixels=0.0)


def test_each_frame_shows_its_own_picture_through_the_same_sensor():
    sim = simulate(load_picture("camera, moon,grass"), VIEWS, seed=2)
    truth = sim.truth
    assert truth.scene.shape == (3, 32, 40)
    rest = sim.frames - truth.gain * truth.scene - truth.offset
    assert rest.std() == pytest.approx(truth.read_noise, rel=0.05)
    alone = simulate(
        load_picture("moon"), Settings(n_frames=1, shape=(32, 40), dead_pixels=0.0, max_shift=0.0), seed=2
    )
    np.testing.assert_allclose(truth.scene[1], alone.truth.scene, atol=1e-12)


def test_the_sensor_and_its_noise_are_those_of_any_burst_of_the_seed():
    drawn, burst = (
        simulate(None, Settings(n_frames=3, shape=(32, 40), own_scenes=own), seed=4) for own in (True, False)
    )
    assert np.array_equal(drawn.truth.gain, burst.truth.gain)
    assert np.array_equal(drawn.truth.offset, burst.truth.offset)
    assert not np.array_equal(drawn.truth.scene[0], drawn.truth.scene[1])
    assert np.array_equal(drawn.truth.motion, np.tile(np.eye(3), (3, 1, 1)))


def test_the_truth_can_be_finer_than_the_detector():
    settings = Settings(n_frames=2, shape=(16, 20), own_scenes=True, factor=2, psf_sigma=0.0)
    scene = simulate(None, settings, seed=1).truth.scene
    assert scene.shape == (2, 32, 40)


def test_pictures_and_frames_have_to_fit():
    with pytest.raises(DataError, match=r"2 picture\(s\) for 3 frames"):
        simulate(load_picture("camera,moon"), VIEWS)
    with pytest.raises(DataError, match=r"2 pictures; for a frame of each, set simulate.own_scenes"):
        simulate(load_picture("camera,moon"), Settings(n_frames=2))
    with pytest.raises(ConfigError, match=r"not together with simulate\.walker"):
        simulate(None, Settings(n_frames=2, own_scenes=True, walker=0.3))
