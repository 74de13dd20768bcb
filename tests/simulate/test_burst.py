"""A simulated burst: its seed, what happens in front of the camera, its files, and settings that are refused."""

import dataclasses
import json

import numpy as np
import pytest
from cameras import clean

from deepir.errors import ConfigError, DataError
from deepir.simulate import Settings, simulate
from deepir.simulate.scenes.procedural import load_picture

SMALL = {"shape": (48, 56), "n_frames": 4, "max_shift": 4.0}
QUIET = clean(**SMALL, psf_sigma=0.5)
VIEWS = {"n_frames": 3, "shape": (32, 40), "own_scenes": True}
EFFECTS = {
    "gain_shading": 0.1, "stuck_pixels": 0.01, "noisy_pixels": 0.01, "walker": 0.6, "failed_frame": 2,
    "read_noise": 0.1,
}  # fmt: skip


def having(settings: Settings, **changes: object):
    return simulate(settings=dataclasses.replace(settings, **changes), seed=4)


# ---- what was, stays ----


@pytest.mark.parametrize(
    ("settings", "seed", "mean", "spread", "samples"),
    [
        (Settings(), 0, 0.3297070406, 0.2086442683, [-0.0044836374, -0.0656537712, -0.0079432121]),
        (
            Settings(n_frames=3, shape=(40, 48), counts=True, max_shift=4.0, motion="shift", dead_pixels=0.0),
            3, 8547.321701, 412.3076510, [8650, 8265, 8431],
        ),
        (
            Settings(
                gain_row=0.02, gain_column=0.1, level_drift=0.05, dead_pixels=0.01, shape=(40, 56), photons=200.0,
                gain_distribution="uniform", motion="homography", max_rotation=3.0,
            ),
            7, 0.3522633531, 0.2240349878, [0.1597193480, 0.1199068055, 0.1879653633],
        ),
    ],
)  # fmt: skip
def test_a_seed_gives_the_burst_that_it_gave_in_version_0_1(settings, seed, mean, spread, samples):
    frames = simulate(settings=settings, seed=seed).frames.astype(float)
    assert frames.mean() == pytest.approx(mean, rel=1e-6)
    assert frames.std() == pytest.approx(spread, rel=1e-6)
    np.testing.assert_allclose(frames[-1, 5, 7:10], samples, rtol=1e-4)


@pytest.mark.parametrize("effect", EFFECTS)
def test_an_effect_touches_nothing_but_its_own(effect):
    before, after = (having(Settings(**SMALL, photons=500.0), **changes) for changes in ({}, {effect: EFFECTS[effect]}))
    for name in ("motion", "level", "scene", "scale"):
        np.testing.assert_array_equal(getattr(before.truth, name), getattr(after.truth, name))
    if effect in ("walker", "failed_frame", "read_noise"):
        for name in ("gain", "offset", "bad_pixels"):
            np.testing.assert_array_equal(getattr(before.truth, name), getattr(after.truth, name))
    assert (before.truth.bad_pixels <= after.truth.bad_pixels).all()
    assert not np.array_equal(before.frames, after.frames)


# ---- what happens before the camera ----


def test_moving_are_the_samples_whose_flux_the_walker_changes():
    still, walked = having(QUIET), having(QUIET, walker=0.6)
    changed = np.abs(walked.frames - still.frames)
    moving = walked.truth.moving
    assert changed[~moving].max() <= 1.001e-4
    assert changed[moving].min() >= 0.999e-4
    np.testing.assert_array_equal(walked.truth.scene, still.truth.scene)
    assert not still.truth.moving.any()


def test_the_walker_is_as_large_and_as_warm_as_asked():
    sim = simulate(np.full((200, 220), 0.4), dataclasses.replace(QUIET, walker=0.6, walker_contrast=0.25))
    rows = np.flatnonzero((sim.frames[0] > 0.4 + 0.125).any(1))
    assert len(rows) == pytest.approx(0.6 * 48, abs=1.5)
    assert sim.frames.max() == pytest.approx(0.65, abs=0.01)


def test_the_walker_moves_by_himself_at_his_speed():
    settings = dataclasses.replace(QUIET, walker=0.5, walker_speed=5.0, max_shift=0.0)
    sim = simulate(np.full((200, 220), 0.4), settings, seed=2)
    x = np.arange(56)
    centres = [float((moving * x).sum() / moving.sum()) for moving in sim.truth.moving]
    np.testing.assert_allclose(np.abs(np.diff(centres)), 5.0, atol=0.3)
    assert len(set(np.sign(np.diff(centres)))) == 1


def test_the_camera_sees_the_walker_from_where_it_stands():
    settings = dataclasses.replace(QUIET, walker=0.5, walker_speed=0.0, motion="shift")
    sim = simulate(np.full((200, 220), 0.4), settings, seed=2)
    y, x = np.mgrid[:48, :56]
    cover = sim.frames - 0.4
    inside, whole = cover[0].sum(), 0
    for frame, T in zip(cover, sim.truth.motion, strict=True):
        if abs(frame.sum() - inside) < 0.01 * inside:  # all of him is in the frame
            whole += 1
            centre = [(frame * axis).sum() / frame.sum() for axis in (x, y)]
            first = [(cover[0] * axis).sum() / inside for axis in (x, y)]
            np.testing.assert_allclose(np.add(centre, T[:2, 2]), first, atol=0.05)
    assert whole >= 3


def test_a_failed_frame_is_of_another_place():
    whole, failed = having(QUIET), having(QUIET, failed_frame=2, walker=0.5)
    np.testing.assert_array_equal(failed.truth.failed, [False, False, True, False])
    assert not failed.truth.moving[2].any()
    correlation = np.corrcoef(whole.frames[2].ravel(), failed.frames[2].ravel())[0, 1]
    assert abs(correlation) < 0.8
    same = ~failed.truth.moving & ~failed.truth.failed[:, None, None]
    np.testing.assert_allclose(failed.frames[same], whole.frames[same], atol=1.1e-4)
    assert not whole.truth.failed.any()


# ---- frames of different scenes ----


def test_each_frame_shows_its_own_picture_through_the_same_sensor():
    sim = simulate(load_picture("camera, moon,grass"), Settings(**VIEWS, dead_pixels=0.0), seed=2)
    truth = sim.truth
    assert truth.scene.shape == (3, 32, 40)
    rest = sim.frames - truth.gain * truth.scene - truth.offset
    assert rest.std() == pytest.approx(truth.read_noise, rel=0.05)
    alone = simulate(load_picture("moon"), Settings(n_frames=1, shape=(32, 40), dead_pixels=0.0, max_shift=0.0), seed=2)
    np.testing.assert_allclose(truth.scene[1], alone.truth.scene, atol=1e-12)


def test_the_sensor_and_its_noise_are_those_of_any_burst_of_the_seed_and_the_truth_can_be_finer():
    drawn, burst = (simulate(None, Settings(**VIEWS | own), seed=4) for own in ({"factor": 2}, {"own_scenes": False}))
    assert np.array_equal(drawn.truth.gain, burst.truth.gain)
    assert np.array_equal(drawn.truth.offset, burst.truth.offset)
    assert drawn.truth.scene.shape == (3, 64, 80)
    assert not np.array_equal(drawn.truth.scene[0], drawn.truth.scene[1])
    assert np.array_equal(drawn.truth.motion, np.tile(np.eye(3), (3, 1, 1)))


# ---- files, errors ----


def test_a_saved_burst_reads_without_pickle(tmp_path):
    result = simulate(settings=QUIET, seed=5)
    path, beside = result.save(tmp_path / "burst.npz")
    assert beside == tmp_path / "burst_truth.npz"
    with np.load(path, allow_pickle=False) as data, np.load(beside, allow_pickle=False) as truth:
        np.testing.assert_array_equal(data["frames"], result.frames)
        settings = json.loads(str(data["settings"]))
        assert settings.pop("seed") == 5
        assert Settings(**{**settings, "shape": tuple(settings["shape"])}) == QUIET
        assert set(truth) == {field.name for field in dataclasses.fields(result.truth)}
        np.testing.assert_array_equal(truth["gain"], result.truth.gain)
    with pytest.raises(DataError, match="npz"):
        result.save(tmp_path / "burst.tif")


def test_all_frames_fit_at_the_largest_scale():
    picture = np.full((256, 300), 0.5)
    scale = simulate(picture, clean(shape=(96, 96))).truth.scale
    with pytest.raises(DataError):
        simulate(picture, clean(shape=(96, 96), scale=1.01 * scale))


@pytest.mark.parametrize(
    ("scene", "settings", "message"),
    [
        (np.full((500, 500), 7.0), clean(), r"\[0, 1\]"),
        (np.full((500, 500), np.nan), clean(), r"\[0, 1\]"),
        (np.zeros((3, 500, 500)), clean(), r"\[0, 1\]"),
        (np.full((100, 100), 0.5), clean(shape=(96, 96)), r"100 x 100 px is too small.*need \d+ x \d+ px.*max_shift"),
        ([np.eye(500)] * 2, Settings(**VIEWS), r"2 picture\(s\) for 3 frames"),
        ([np.eye(500)] * 2, Settings(n_frames=2), "2 pictures; for a frame of each, set simulate.own_scenes"),
    ],
)
def test_a_scene_that_does_not_fit_is_refused(scene, settings, message):
    with pytest.raises(DataError, match=message):
        simulate(scene, settings)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"motion": "rigdi"}, "did you mean 'rigid'"),
        ({"stray_shape": "rign"}, r"simulate.stray_shape: 'rign' is unknown; did you mean 'ring'"),
        ({"factor": 0}, "factor"),
        ({"factor": 9}, "factor"),
        ({"factor": 4, "scale": 3.0}, "scale"),
        ({"fps": 0.0}, "fps"),
        ({"substeps": 0}, "substeps"),
        ({"readout": 2.0}, "readout"),
        ({"tau": 10.0, "walker": 0.5}, "not together with simulate.walker"),
        ({"own_scenes": True, "walker": 0.3}, "not together with simulate.walker"),
        ({"jitter": "z"}, "jitter"),
        ({"read_noise": -1.0}, "read_noise"),
        ({"photons": float("nan")}, "photons"),
        ({"n_frames": 0}, "n_frames"),
        ({"scale": 1.0}, "1.2"),
        ({"motion": "shift", "max_rotation": 3.0}, "does not rotate"),
        ({"dead_pixels": 0.9}, "dead_pixels"),
        ({"dead_pixels": 0.2, "stuck_pixels": 0.2, "noisy_pixels": 0.2}, "noisy_pixels = 0.6 together"),
        ({"gain_shading": 1.5}, "gain_shading = 1.5"),
        ({"walker": 2.0}, "walker = 2.0"),
        ({"n_frames": 4, "failed_frame": 4}, "failed_frame = 4.*numbered 1 to 3"),
    ],
)
def test_wrong_settings_are_named(changes, message):
    with pytest.raises(ConfigError, match=message):
        Settings(**changes)
