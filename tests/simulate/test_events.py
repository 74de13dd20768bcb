"""Effects that are off by default: what each does to a burst, and that it touches nothing else."""

import dataclasses

import numpy as np
import pytest

from deepir.errors import ConfigError
from deepir.simulate import Settings, simulate
from deepir.simulate.scenes.procedural import sky

SMALL = Settings(shape=(48, 56), n_frames=4, max_shift=4.0)
QUIET = dataclasses.replace(
    SMALL, **dict.fromkeys(["gain_pixel", "gain_column", "shading", "read_noise", "dead_pixels"], 0.0),
    offset_pixel=0.0, offset_column=0.0, offset_row=0.0,
)  # fmt: skip
EFFECTS = {
    "gain_shading": 0.1, "stuck_pixels": 0.01, "noisy_pixels": 0.01, "walker": 0.6, "failed_frame": 2,
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
    """Motion, level and scene are the same to the bit; the sensor is, but for its own effects."""
    before, after = having(SMALL, photons=500.0), having(SMALL, photons=500.0, **{effect: EFFECTS[effect]})
    for name in ("motion", "level", "scene", "scale"):
        np.testing.assert_array_equal(getattr(before.truth, name), getattr(after.truth, name))
    if effect in ("walker", "failed_frame"):
        for name in ("gain", "offset", "bad_pixels"):
            np.testing.assert_array_equal(getattr(before.truth, name), getattr(after.truth, name))
    assert (before.truth.bad_pixels <= after.truth.bad_pixels).all()
    assert not np.array_equal(before.frames, after.frames)


# ---- gain ----


def test_the_gains_shading_is_smooth_and_has_mean_one():
    gain = having(QUIET, gain_shading=0.2, shape=(120, 160)).truth.gain
    assert gain.mean() == pytest.approx(1, abs=1e-12)
    assert np.ptp(gain) == pytest.approx(0.2, rel=1e-6)
    y, x = np.mgrid[-1:1:120j, -1:1:160j]
    quadratic = np.stack([np.ones_like(x), x, y, x * y, x**2, y**2], -1).reshape(-1, 6)
    _, rest, *_ = np.linalg.lstsq(quadratic, gain.ravel())
    assert rest[0] < 1e-12


def test_the_two_shadings_know_nothing_of_each_other():
    truth = having(QUIET, gain_shading=0.2, shading=0.3).truth
    assert np.ptp(truth.offset) == pytest.approx(0.3)
    assert abs(np.corrcoef(truth.gain.ravel(), truth.offset.ravel())[0, 1]) < 0.95


# ---- defects ----


@pytest.mark.parametrize("counts", [False, True])
def test_stuck_pixels_hide_in_the_scenes_range(counts):
    found = having(SMALL, stuck_pixels=0.02, dead_pixels=0.0, counts=counts)
    stuck, scene = found.truth.bad_pixels, found.truth.scene
    assert stuck.sum() == round(0.02 * stuck.size)
    assert not np.ptp(found.frames[:, stuck].astype(float), axis=0).any()
    assert scene.min() - 1 <= found.frames[:, stuck].min() < found.frames[:, stuck].max() <= scene.max() + 1


@pytest.mark.parametrize("photons", [0.0, 300.0])
def test_noisy_pixels_have_ten_times_the_noise(photons):
    settings = dataclasses.replace(
        QUIET, read_noise=0.01, photons=photons, noisy_pixels=0.2, n_frames=60, max_shift=0.0
    )
    found = simulate(np.full((200, 220), 0.5), settings)
    noise, noisy = found.frames.std(0), found.truth.bad_pixels
    expected = np.sqrt(0.01**2 + (0.5 / photons if photons else 0))
    assert np.median(noise[noisy]) == pytest.approx(10 * expected, rel=0.05)
    assert np.median(noise[~noisy]) == pytest.approx(expected, rel=0.05)


def test_the_pattern_is_in_the_gauge_of_the_pixels_that_are_good():
    truth = having(SMALL, stuck_pixels=0.05, noisy_pixels=0.05, gain_shading=0.2).truth
    assert truth.gain[~truth.bad_pixels].mean() == pytest.approx(1, abs=1e-12)
    assert truth.offset[~truth.bad_pixels].mean() == pytest.approx(0, abs=1e-12)


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
    """Against the scene, which a camera at rest sees still."""
    settings = dataclasses.replace(QUIET, walker=0.5, walker_speed=5.0, max_shift=0.0)
    sim = simulate(np.full((200, 220), 0.4), settings, seed=2)
    x = np.arange(56)
    centres = [float((moving * x).sum() / moving.sum()) for moving in sim.truth.moving]
    np.testing.assert_allclose(np.abs(np.diff(centres)), 5.0, atol=0.3)
    assert len(set(np.sign(np.diff(centres)))) == 1


def test_the_camera_sees_the_walker_from_where_it_stands():
    """A camera that moves by whole pixels sees a standing walker in the same place of the scene."""
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


@pytest.mark.parametrize("shape", ["smooth", "radial", "ring", "edge"])
def test_stray_flux_is_added_in_front_of_the_sensor(shape):
    """The scene's level holds its mean, so that it has none of its own; the gain acts on both."""
    dark, lit = (having(QUIET, stray=stray, stray_shape=shape, gain_pixel=0.1) for stray in (0.0, 0.7))
    truth = lit.truth
    assert np.ptp(truth.stray) == pytest.approx(0.7)
    assert truth.stray.mean() == pytest.approx(0, abs=1e-12)
    level = truth.scene - dark.truth.scene
    assert np.ptp(level) < 1e-12
    added = np.broadcast_to(truth.gain * (truth.stray + level.mean()), lit.frames.shape)
    np.testing.assert_allclose(lit.frames - dark.frames, added, atol=1e-6)


def test_a_shape_of_stray_flux_that_does_not_exist_is_refused():
    with pytest.raises(ConfigError, match=r"simulate.stray_shape: 'rign' is unknown; did you mean 'ring'"):
        Settings(stray_shape="rign")


def test_a_sky_makes_a_burst():
    sim = simulate(sky(0, (120, 140)), SMALL)
    assert 0 <= sim.truth.scene.min() < sim.truth.scene.max() <= 1.01
