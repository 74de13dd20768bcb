"""Simulated recordings, against geometry and statistics that are computed here."""

import dataclasses
import json
import sys

import numpy as np
import pytest

from deepir.errors import ConfigError, DataError
from deepir.simulate.detector import lagged
from deepir.simulate.paths import camera_path, rotations
from deepir.simulate.planes import Surface, World, render_view, texture
from deepir.simulate.recording import RecordingSettings, drifting_offsets, residual_pattern, simulate_recording

SMALL = RecordingSettings(kind="tripod", n_frames=12, shape=(48, 64), objects=0)
X, Y, Z = np.eye(3)
BLACK = texture(np.zeros((8, 8)), 0.1)


def small(**changes):
    return dataclasses.replace(SMALL, **changes)


def alone(surface):
    return World([surface], BLACK, 0.0, 0.0)


def wall(picture, depth, texel, size, left=0.0):
    corner = np.array([left - size[0] / 2, -size[1] / 2, depth])
    return Surface((texture(picture, texel),), corner, X, Y, size)


@pytest.fixture(scope="module")
def crowd():
    return simulate_recording(small(objects=5, n_frames=40), seed=3)


@pytest.fixture(scope="module")
def drive():
    return simulate_recording(small(kind="drive", n_frames=9, objects=2, agc=True, shutter_every=0.2), seed=1)


# ---- geometry ----


@pytest.mark.parametrize("kind", ["drive", "walk", "drone"])
def test_a_point_of_the_ground_moves_as_a_pinhole_projects_it(kind):
    settings = small(kind=kind, n_frames=40, shape=(96, 128))
    path = camera_path(settings, np.random.default_rng(4))
    first = path.rotation[0] @ (0.03, 0.1, 1)  # a ray that meets the ground below the middle
    point = path.position[0] + first * (-path.position[0, 1] / first[1])
    at = (np.arange(256) + 0.5) * 0.05 - 6.4
    spot = np.exp(-(at**2 + at[:, None] ** 2) / (2 * (0.012 * np.linalg.norm(point - path.position[0])) ** 2))
    ground = Surface((texture(spot, 0.05),), point - (6.4, 0, 6.4), X, Z, (12.8, 12.8))
    for k in (0, 4, 8):
        seen, _ = render_view(alone(ground), path.position[k], path.rotation[k], settings.focal, settings.shape)
        x, y, z = path.rotation[k].T @ (point - path.position[k])
        row, column = np.unravel_index(seen.argmax(), seen.shape)
        assert settings.focal * x / z + 63.5 == pytest.approx(column, abs=0.75)
        assert settings.focal * y / z + 47.5 == pytest.approx(row, abs=0.75)


def test_a_spot_is_seen_where_it_is_to_a_hundredth_of_a_px():
    at = (np.arange(128) + 0.5) * 0.02 - 1.28
    spot = wall(np.exp(-(at**2 + at[:, None] ** 2) / (2 * 0.15**2)), 10.0, 0.02, (2.56, 2.56))
    rotation = rotations(np.array([2.0]), np.array([-1.0]), np.array([30.0]))[0]
    position = np.array([0.3, -0.2, 1.0])
    seen, _ = render_view(alone(spot), position, rotation, 120.0, (48, 64))
    x, y, z = rotation.T @ (np.array([0, 0, 10.0]) - position)
    rows, columns = np.indices(seen.shape)
    assert (seen * columns).sum() / seen.sum() - 31.5 == pytest.approx(120 * x / z, abs=0.02)
    assert (seen * rows).sum() / seen.sum() - 23.5 == pytest.approx(120 * y / z, abs=0.02)


def test_a_camera_that_turns_right_and_up_sees_things_move_left_and_down():
    rotation = rotations(np.array([5.0]), np.array([3.0]), np.zeros(1))[0]
    x, y, _ = rotation.T @ Z
    assert x < 0 < y
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)


def test_the_nearer_hides_the_farther_in_any_order():
    near, far = (wall(np.full((8, 8), 0.8), 5.0, 0.25, (2, 2)), wall(np.full((64, 64), 0.3), 9.0, 0.25, (16, 16)))
    for both in ([near, far], [far, near]):
        seen, _ = render_view(World(both, BLACK, 0.0, 0.0), np.zeros(3), np.eye(3), 60.0, (48, 64))
        assert seen[24, 32] == pytest.approx(0.8)
        assert seen[24, 50] == pytest.approx(0.3)


def test_a_pixel_integrates_a_ramp_and_averages_what_is_finer():
    ramp = wall(np.broadcast_to(np.arange(256) / 256, (256, 256)), 8.0, 0.05, (12.8, 12.8))
    seen, _ = render_view(alone(ramp), np.zeros(3), np.eye(3), 60.0, (32, 40))
    u = np.arange(40) - 19.5
    np.testing.assert_allclose(seen[16], 0.5 + (8 * u / 60 - 0.025) / 12.8, atol=1e-4)
    board = wall(np.indices((256, 256)).sum(0) % 2, 8.0, 0.05, (12.8, 12.8))
    seen, _ = render_view(alone(board), np.zeros(3), np.eye(3), 20.0, (16, 16))
    np.testing.assert_allclose(seen, 0.5, atol=0.02)


def test_only_what_is_marked_as_moving_changes_before_a_still_camera(crowd):
    scene, moving = crowd.truth.scene, crowd.truth.moving
    known = ~moving.all(0)
    background = np.nanmedian(np.where(moving & known, np.nan, scene), axis=0)
    change = np.abs(scene - background)
    assert known.mean() > 0.8
    assert np.where(moving, 0, change).max() < 0.03 * crowd.settings.contrast
    assert change[moving & known].max() > 0.2 * crowd.settings.contrast


# ---- the sensor ----


def test_frames_are_the_truth_under_its_pattern_and_noise():
    recording = simulate_recording(small(drift=0.05, tau_ms=10.0, kind="pan", substeps=2), seed=5)
    truth = recording.truth
    rest = recording.frames - truth.gain * truth.scene - truth.offset
    assert rest[:, ~truth.bad_pixels].std() == pytest.approx(truth.noise, rel=0.02)
    assert truth.gain[~truth.bad_pixels].mean() == pytest.approx(1, abs=1e-12)
    np.testing.assert_allclose(truth.offset[:, ~truth.bad_pixels].mean(1), 0, atol=1e-3)


def test_a_frame_of_the_shutter_is_flat_up_to_the_pattern(drive):
    truth, settings = drive.truth, drive.settings
    closed = np.flatnonzero(truth.shutter)
    np.testing.assert_array_equal(closed, [6, 7, 8])
    np.testing.assert_array_equal(truth.scene[closed], settings.pedestal + settings.contrast / 2)
    assert truth.scene[:6].std() > 0.05 * settings.contrast


def test_a_closure_takes_off_what_is_seen_of_the_shutter():
    settings = small(n_frames=30, shutter_every=0.5, drift=0.2, shutter_residual=0.0, frame_rate=30.0)
    truth = simulate_recording(settings, seed=2).truth
    shown = ((truth.gain - 1) * settings.flat + truth.offset)[:, ~truth.bad_pixels].std(1)
    np.testing.assert_array_equal(np.flatnonzero(truth.shutter), [15, 16, 17])
    assert shown[0] < 1e-3 > shown[18]
    assert shown[17] == pytest.approx(0.2 * 1500 * np.sqrt(17 / 30), rel=0.25)


@pytest.mark.parametrize("time", [0.0, 0.2])
def test_the_drift_is_a_random_walk_or_an_ornstein_uhlenbeck_process(time):
    settings = small(n_frames=61, drift=0.1, drift_time=time, offset_column=0.0, offset_row=0.0)
    zero = np.zeros(settings.shape)
    found = drifting_offsets(settings, zero + 1, zero, np.zeros(61, bool), np.random.default_rng(0))
    expected = 150**2 * (time / 2 * (1 - np.exp(-2 * 2.0 / time)) if time else 2.0)
    assert found[-1].var() == pytest.approx(expected, rel=0.1)


@pytest.mark.parametrize("substeps", [1, 4])
def test_the_step_response_of_a_pixel_is_exponential(substeps):
    flux = [np.float64(k > 0) for k in range(7 * substeps + 1)]
    found = list(lagged(flux, 1000 / 30 / substeps / 20.0))[::substeps]
    rise = 1000 / 30 / substeps  # ms of the flux, from zero to one
    shown, steps = 0.0, 2000
    expected = [0.0]
    for _ in range(7):
        for i in range(steps):
            now = (len(expected) - 1) * 1000 / 30 + (i + 0.5) * 1000 / 30 / steps
            shown += (min(1.0, now / rise) - shown) * 1000 / 30 / steps / 20
        expected.append(shown)
    np.testing.assert_allclose(found, expected, atol=1e-3)


# ---- how frames are stored ----


def test_the_gain_control_is_affine_smooth_and_holds_while_the_shutter_is_closed(drive):
    truth = drive.truth
    assert drive.frames.dtype == np.uint8
    counts = truth.gain * truth.scene + truth.offset
    shown = truth.agc_gain[:, None, None] * counts + truth.agc_offset[:, None, None]
    valid = ~truth.bad_pixels & (drive.frames > 0) & (drive.frames < 255)
    noise = np.hypot(truth.agc_gain.max() * truth.noise, np.sqrt(1 / 12))
    assert (drive.frames - shown)[valid].std() < 1.2 * noise
    assert np.abs(np.diff(np.log(truth.agc_gain))).max() < 0.1
    assert np.ptp(truth.agc_gain[5:]) == 0


@pytest.mark.parametrize("codec", ["mpeg4", "h264"])
def test_a_codec_loses_little_at_a_high_bit_rate_and_more_at_a_low_one(codec):
    pytest.importorskip("av")
    plain = simulate_recording(small(agc=True, shape=(47, 65)), seed=1)
    errors = []
    for bits in (6.0, 0.2):
        film = simulate_recording(dataclasses.replace(plain.settings, compression=codec, bits_per_pixel=bits), seed=1)
        assert film.frames.dtype == np.uint8
        assert film.frames.shape == plain.frames.shape
        errors.append((film.frames.astype(float) - plain.frames)[1:].std())
    assert 0 < errors[0] < errors[1]
    assert errors[0] < 8


def test_without_pyav_a_message_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(DataError, match=r"deepir\[video\]"):
        simulate_recording(small(n_frames=1, agc=True, compression="h264"))


def test_the_same_seed_gives_the_same_recording_and_noise_does_not_change_the_path():
    first, second, noisier, other = (
        simulate_recording(small(kind="pan", n_frames=3, **changes), seed=seed)
        for changes, seed in (({}, 7), ({}, 7), ({"read_noise": 0.01}, 7), ({}, 8))
    )
    np.testing.assert_array_equal(first.frames, second.frames)
    np.testing.assert_array_equal(first.truth.scene, noisier.truth.scene)
    assert (other.truth.rotation != first.truth.rotation).any()


def test_counts_are_of_16_bits_and_saved_with_their_times(tmp_path, crowd):
    path, beside = crowd.save(tmp_path / "crowd.npz")
    with np.load(path) as saved, np.load(beside) as truth:
        assert saved["frames"].dtype == np.uint16
        np.testing.assert_allclose(np.diff(saved["times"]), 1 / 30)
        assert json.loads(str(saved["settings"]))["kind"] == "tripod"
        np.testing.assert_array_equal(truth["moving"], crowd.truth.moving)


# ---- its judge ----


def test_what_is_left_of_a_known_pattern_is_its_rms_in_sigmas_of_the_noise(crowd):
    truth = crowd.truth
    perfect = (crowd.frames - truth.offset) / truth.gain
    assert residual_pattern(perfect, crowd) == pytest.approx(1 / np.sqrt(40), rel=0.1)
    wrong = 7 * truth.noise * np.random.default_rng(0).standard_normal(truth.gain.shape)
    levels = np.arange(40)[:, None, None]
    assert residual_pattern(perfect + wrong + levels, crowd) == pytest.approx(7, rel=0.05)


def test_a_gain_of_each_frame_is_no_pattern_where_there_is_a_gain_control(drive):
    truth = drive.truth
    grey = truth.agc_gain[:, None, None] * truth.scene + truth.agc_offset[:, None, None]
    assert residual_pattern(grey * np.linspace(0.5, 2, 9)[:, None, None], drive) < 1e-3
    with pytest.raises(DataError, match="corrected"):
        residual_pattern(grey[1:], drive)


@pytest.mark.parametrize(
    "changes",
    [
        {"kind": "swim"}, {"n_frames": 0}, {"shape": (8, 64)}, {"frame_rate": 0.0}, {"field_of_view": 170.0},
        {"substeps": 4}, {"compression": "h264"}, {"compression": "zip"}, {"drift": -1.0}, {"dead_pixels": 0.9},
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused(changes):
    with pytest.raises(ConfigError, match="recording"):
        small(**changes)
