"""A simulated burst whose pixels take their time."""

import dataclasses

import numpy as np
import pytest

from deepir.errors import ConfigError
from deepir.simulate import Settings, render, simulate
from deepir.simulate.detector import smooth_path

IDEAL = Settings(
    n_frames=6, shape=(24, 32), scale=2.0, motion="shift", max_shift=4.0, gain_pixel=0.0, gain_column=0.0,
    offset_pixel=0.0, offset_column=0.0, offset_row=0.0, shading=0.0, read_noise=0.0, dead_pixels=0.0, psf_sigma=0.0,
    tau=10.0,
)  # fmt: skip


def ideal(**changes):
    return dataclasses.replace(IDEAL, **changes)


def picture():
    return np.linspace(0, 1, 100)[:, None] * np.linspace(0, 1, 120)


def test_the_path_is_smooth_starts_at_rest_and_reaches_what_the_settings_allow():
    way = smooth_path(ideal(n_frames=12, tremor=5.0), np.random.default_rng(0))
    assert way.shape == (11 * IDEAL.substeps + 1, 9)
    assert not way[0].any()
    np.testing.assert_allclose(np.abs(way).max(0), 1)
    jerk = np.abs(np.diff(way, n=2, axis=0)).max() / np.abs(np.diff(way, axis=0)).max()
    assert jerk < 0.1  # an instant's change of speed, in its speed


def test_each_frame_is_what_the_camera_sees_drawn_along_its_path():
    """Over a ramp a lag shows where the camera was a while ago: the lagged path itself."""
    y = np.broadcast_to(np.linspace(0, 1, 100)[:, None], (100, 120))
    sim = simulate(y, ideal(), seed=2)
    per_px = np.diff(sim.frames[0].astype(float), axis=0).mean()
    seen = (sim.frames - sim.frames[0]).mean((1, 2)) / per_px  # px along y
    way = 4 * smooth_path(IDEAL, np.random.default_rng(2).spawn(9)[8])[:, 1]
    step = 1000 / (IDEAL.fps * IDEAL.substeps)
    late = np.zeros_like(way)
    for i in range(1, len(way)):  # the mean of both ends of a step
        late[i] = late[i - 1] + (1 - np.exp(-step / 10)) * ((way[i] + way[i - 1]) / 2 - late[i - 1])
    np.testing.assert_allclose(seen, late[:: IDEAL.substeps], atol=0.02)
    np.testing.assert_allclose(sim.truth.motion[:, 1, 2], way[:: IDEAL.substeps], atol=1e-12)


def test_pixels_that_follow_at_once_show_the_scene_where_the_camera_is():
    sim = simulate(picture(), ideal(tau=1e-3), seed=1)
    expected = render(picture(), sim.truth.motion, IDEAL.shape, IDEAL.scale)
    np.testing.assert_allclose(sim.frames, expected, atol=1e-4)


def test_the_first_frame_has_settled():
    sim = simulate(picture(), ideal(), seed=1)
    np.testing.assert_allclose(sim.frames[0], sim.truth.scene, atol=1e-6)


def test_the_truth_holds_each_pixels_time_constant():
    tau = simulate(picture(), ideal(tau_pixel=0.1), seed=1).truth.tau
    assert tau.shape == IDEAL.shape
    assert tau.mean() == pytest.approx(10, rel=0.02)
    assert tau.std() == pytest.approx(1, rel=0.1)
    assert not simulate(picture(), ideal(tau=0.0), seed=1).truth.tau.any()


def test_rows_are_read_one_after_the_other_and_the_last_as_the_frame_ends():
    rolling, at_once = (simulate(picture(), ideal(readout=r), seed=1).frames for r in (0.8, 0.0))
    np.testing.assert_array_equal(rolling[:, -1], at_once[:, -1])
    early, late = (np.abs(rolling[1:, row] - at_once[1:, row]).mean() for row in (2, -3))
    assert early > 3 * late > 0


@pytest.mark.parametrize("changes", [{"fps": 0.0}, {"substeps": 0}, {"readout": 2.0}, {"walker": 0.5}])
def test_what_cannot_be_is_refused(changes):
    with pytest.raises(ConfigError, match="simulate"):
        ideal(**changes)
