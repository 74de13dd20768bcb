"""A camera's gain, offset and bad pixels from frames of a scene that moves, against the truth."""

import numpy as np
import pytest
from scipy import ndimage
from skimage import data

import deepir
from deepir.correct_recording import correct
from deepir.errors import DataError
from deepir.multiview.pattern_gradients import gradient_consensus
from deepir.recording.burst import Burst
from deepir.recording.defective_pixels import defective_pixels, of_neighbours, rounding_deviation
from deepir.recording.displaced import fine_part
from deepir.recording.joint_solve import low_order_step
from deepir.recording.modes import LowOrderModes, PatternPrior, dct
from deepir.simulate.recording import RecordingSettings, residual_pattern, simulate_recording


def alike(first, second, where):
    return np.corrcoef(first[where], second[where])[0, 1]


def test_shared_gradients_give_the_fine_offset(walk):
    frames = np.where(walk.bad, np.float32(np.nan), walk.frames.astype(np.float32))
    usable = np.broadcast_to(~walk.bad, frames.shape)
    found = gradient_consensus(frames, usable)
    detail, true = (each - ndimage.uniform_filter(each, 5) for each in (found, walk.fine))
    assert alike(detail, true, ~ndimage.binary_dilation(walk.bad, iterations=3)) > 0.97


def test_a_fine_part_is_found_in_frames_smaller_than_a_block(walk):
    # 12 rows, and blocks have 16.
    assert alike(fine_part(walk.fine[:12], walk.fine[:12]), walk.fine[:12], ~walk.bad[:12]) > 0.8


def test_spikes_stay_in_the_fine_part_and_scenes_do_not():
    rng = np.random.default_rng(4)
    pattern, spikes = rng.standard_normal((96, 128)), np.where(rng.random((96, 128)) < 1e-3, 300.0, 0.0)
    scenes = [30 * ndimage.gaussian_filter(rng.standard_normal((96, 128)), 4) for _ in range(2)]
    left = fine_part(*(pattern + spikes + each for each in scenes)) - pattern - spikes
    assert left.std() < 0.5 < 2 * ndimage.gaussian_filter(np.mean(scenes, 0), 2).std()


def judged(frames):
    """Pixels that are defective beside their neighbours, of frames without pattern."""
    return defective_pixels(frames, of_neighbours(frames), rounding_deviation(frames[0]))


def test_a_large_steady_offset_is_no_defect(walk):
    rng = np.random.default_rng(3)
    offset = np.where(rng.random(walk.fine.shape) < 0.002, 800, 0)
    frames = walk.scenes[::5] + offset + 3 * rng.standard_normal(walk.scenes[::5].shape)
    assert not judged(frames.astype(np.float32)).any()


def test_rounding_makes_no_pixel_of_a_corrected_recording_defective(walk):
    # No pattern, no noise, as in a film of eight bits.
    assert judged((walk.scenes[::5] / 8).round().astype(np.float32)).mean() < 1e-3


@pytest.mark.parametrize("change", [1.0, 0.5, 0.3])
def test_a_scene_that_changes_by_less_than_a_step_of_rounding_makes_no_pixel_defective(change):
    rng = np.random.default_rng(0)
    scene, offset = ndimage.gaussian_filter(rng.standard_normal((24, 64, 80)), (3, 8, 8)), rng.standard_normal((64, 80))
    frames = np.round(100 + change * scene / scene.std() + 1.5 * offset).astype(np.float32)
    rounding, corrected = rounding_deviation(frames[0]), frames - 1.5 * offset.astype(np.float32)
    assert defective_pixels(corrected, of_neighbours(corrected), rounding).mean() < 1e-3


def test_the_pattern_of_a_camera_that_moves_is_found(walk, corrected):
    found, good = corrected.estimate, ~walk.bad
    assert found.kept == "gain and offset"
    frames = np.stack([corrected.correct(frame) for frame in walk.frames[::5]])
    raw, left = ((each - walk.scenes[::5]).mean(0)[good].std() for each in (walk.frames[::5], frames))
    assert left < 0.1 * raw
    assert found.bad_pixels[walk.bad].mean() > 0.9
    assert found.bad_pixels[good].mean() < 1e-3
    assert alike(found.gain, walk.gain, good & ~found.bad_pixels) > 0.6
    smooth = ndimage.gaussian_filter(found.offset - walk.fine, 6)  # the low-order part: not that of the scenes
    assert alike(smooth, walk.slow, good) > 0.95
    assert 0.8 < smooth.std() / walk.slow.std() < 1.2


def test_a_person_who_walks_through_is_noted(walk, corrected):
    frames = walk.frames[::2].copy()
    for k, frame in enumerate(frames):
        frame[50:80, 2 * k : 2 * k + 8] += 300
    messages = (corrected.estimate.messages, correct(frames).estimate.messages)
    assert [any("moves by itself" in each for each in some) for some in messages] == [False, True]


def trembling(walk, step=0.1, seed=6):
    """A scene of high contrast; the camera moves by `step` px from frame to frame, at random."""
    places, scene = np.cumsum(np.random.default_rng(seed).normal(0, step, (40, 2)), axis=0), 4 * walk.scenes[0] - 24000
    shown = np.stack([ndimage.shift(scene, place, mode="nearest") for place in places]) + walk.fine + walk.slow
    return shown + 3 * np.random.default_rng(0).standard_normal(shown.shape)


@pytest.mark.parametrize(("step", "seed", "left", "is_said"), [(0.4, 6, 0.35, False), (0.2, 5, 0.5, True)])
def test_a_trembling_camera_leaves_little_of_the_scene_in_the_offset(walk, step, seed, left, is_said):
    found = correct(trembling(walk, step, seed).astype(np.float32)).estimate
    error = ndimage.gaussian_filter(found.offset - walk.fine - walk.slow, 6)
    assert error.std() < left * walk.slow.std()
    assert any("moves by little" in each for each in found.messages) == is_said


@pytest.mark.parametrize("way", ["sideways", pytest.param("tilts", marks=pytest.mark.slow)])
def test_a_camera_that_turns_one_way_separates_the_shading_along_it_and_says_so(walk, way):
    frames = np.stack([np.roll(walk.scenes[0], 3 * k, axis=1) for k in range(40)])
    frames = frames + walk.fine + walk.slow + 3 * np.random.default_rng(0).standard_normal(frames.shape)
    turned = frames.astype(np.float32) if way == "sideways" else frames.astype(np.float32).transpose(0, 2, 1)
    found = correct(turned).estimate
    offset = found.offset if way == "sideways" else found.offset.T
    slow = ndimage.gaussian_filter(offset - walk.fine, 6)
    assert (slow - walk.slow).mean(0)[10:-10].std() < 0.4 * walk.slow.mean(0).std()
    assert slow.mean(1).std() < 0.3 * walk.slow.mean(1).std()
    assert any(way in message for message in found.messages)
    deviation = found.offset_deviation if way == "sideways" else found.offset_deviation.T
    error = offset - walk.fine - walk.slow
    assert np.mean(np.abs(error - error.mean()) < deviation) > 0.5


def test_turns_about_the_line_of_sight_separate_the_shading_across_a_pan(walk):
    picture, rng = 8000 + 4.0 * ndimage.gaussian_filter(data.camera().astype(float), 0.8), np.random.default_rng(0)
    y, x = (each - (side - 1) / 2 for each, side in zip(np.indices(walk.slow.shape), walk.slow.shape, strict=True))
    scenes = np.stack([
        ndimage.map_coordinates(picture, [255 + y + turn * x, 255 + x - turn * y + shift], order=3)
        for turn, shift in zip(0.015 * np.sin(np.arange(40) / 5), np.linspace(-6, 6, 40), strict=True)
    ])  # fmt: skip
    frames = scenes + walk.fine + walk.slow + 3 * rng.standard_normal(scenes.shape)
    found = correct(frames.astype(np.float32)).estimate
    assert ndimage.gaussian_filter(found.offset - walk.fine - walk.slow, 6).std() < 0.1 * walk.slow.std()
    assert not found.messages


def test_a_few_frames_are_corrected_as_nuc_corrects_them(walk):
    frames = walk.frames[::10][:5]
    found, burst = correct(frames), deepir.run("nuc", frames=frames)
    expected = np.where(burst.bad_pixels, found.frames, (frames - burst.offset) / burst.gain)
    np.testing.assert_allclose(found.frames, expected, atol=0.01)


def at_rest(walk):
    return walk.frames[0] + np.random.default_rng(1).integers(-9, 9, (60, *walk.frames.shape[1:]))


def at_rest_under_changing_gains(walk):
    rng, gains = np.random.default_rng(2), 0.12 * (1 + 0.3 * np.sin(np.arange(40) / 4))[:, None, None]
    shown = (walk.scenes[0] - 8000)[None] + walk.fine + 3 * rng.standard_normal((40, *walk.fine.shape))
    return (gains * (shown - shown.mean()) + 120).clip(0, 255)


def at_rest_while_cars_pass(walk):
    return simulate_recording(RecordingSettings(kind="pan", n_frames=100, shape=(96, 128)), seed=100).frames


def one_walks_by(walk):
    y, x = np.indices(walk.fine.shape)
    person = np.stack([np.exp(-((((x + 10 - k) / 7) ** 2 + ((y - 50) / 26) ** 2) ** 4)) for k in range(60)])
    shown = walk.scenes[0] * (1 - person) + 10200 * person + walk.fine + walk.slow
    return shown + 5 * np.random.default_rng(0).standard_normal(shown.shape)


@pytest.mark.parametrize(
    "recording", [at_rest, at_rest_under_changing_gains, at_rest_while_cars_pass, one_walks_by, trembling]
)
def test_a_camera_at_rest_is_refused(walk, recording):
    with pytest.raises(DataError, match="stands still"):
        correct(recording(walk).round().astype(np.uint16))


@pytest.mark.parametrize(
    ("camera", "seed", "most"),
    [
        ({"kind": "drive", "n_frames": 240}, 11, 1.0),  # of which some frames seem to register
        ({"kind": "walk", "n_frames": 60}, 15, 0.1),  # of which short stretches register
        ({"kind": "walk", "n_frames": 60, "shutter_every": 60.0, "drift": 0.01}, 15, 1.0),
    ],
)
def test_a_camera_among_near_things_leaves_less_than_raw_frames_have(camera, seed, most):
    film = simulate_recording(RecordingSettings(shape=(120, 160), **camera), seed=seed)
    assert residual_pattern(correct(film.frames).frames, film) < most * residual_pattern(film.frames, film)


def test_frames_that_are_stretched_one_by_one_show_one_pattern(walk):
    frames = walk.frames[::2].astype(np.float32)
    low, high = np.quantile(frames, (0.01, 0.99), axis=(1, 2), keepdims=True)
    found = correct(np.clip((frames - low) / (high - low), 0, 1)).estimate.offset
    assert alike(found, walk.fine + walk.slow + 450 * (walk.gain - 1), ~walk.bad) > 0.94  # 0.66 of equal gains


def test_one_frame_is_refused(walk):
    with pytest.raises(DataError, match="frames"):
        correct(walk.frames[:1])


def test_a_gain_that_makes_the_offset_is_found_in_a_scene_of_little_contrast():
    """Far from the camera's zero a pixel's gain makes most of its pattern, and the pattern tells the gain."""
    film = simulate_recording(RecordingSettings(kind="walk", n_frames=60, shape=(96, 128), dead_pixels=0.0), seed=23)
    found, truth = correct(film.frames).maps.gain, film.truth.gain
    assert np.std(found / found.mean() - truth / truth.mean()) < 0.5 * truth.std()


def test_a_slope_along_either_axis_is_made_of_modes_exactly():
    modes = LowOrderModes((48, 64), 16.0, slopes=True)
    for slope in np.indices((48, 64)) - np.array([23.5, 31.5])[:, None, None]:
        np.testing.assert_allclose(modes.synthesise(modes.analyse(slope)), slope, atol=1e-10)


def test_the_drift_of_levels_is_found_whatever_offset_is_known_so_far():
    rng, size = np.random.default_rng(4), (48, 64)
    shifts = np.stack([2 * np.arange(16), np.round(12 * np.sin(np.arange(16)))], 1).astype(int)
    levels, fine = np.cumsum(rng.normal(0, 3, 16)), rng.normal(0, 4, size)
    scenes = [data.camera()[200 + y : 248 + y, 200 + x : 264 + x] for y, x in shifts]
    frames = np.stack(scenes) + levels[:, None, None] + fine + rng.normal(0, 1, (16, *size))
    motion = np.tile(np.eye(3), (16, 1, 1))
    motion[:, :2, 2] = shifts[:, ::-1]
    modes = LowOrderModes(size, 16.0, slopes=True)
    for start in (fine, fine + np.linspace(-20, 20, 48)[:, None]):
        burst = Burst(frames.astype(np.float32), np.ones(frames.shape, bool), motion, 0, np.ones(16))
        burst.weigh(start, np.ones(size), 0.1, robust=False)
        low_order_step([burst], modes, PatternPrior(dct(fine)), start, np.ones(size))
        assert 9 / 10 < burst.frame_prior.level_variance < 9 * 10  # decades are tried


METHOD = "method=recording"


def test_a_run_is_what_correct_finds_with_a_report_and_lost_samples_do_not_count(walk, tmp_path, estimated_once):
    frames = walk.frames[::4].astype(np.float32)
    frames[3:6, 40:60, 50:80] = np.nan
    result = deepir.run("recording", METHOD, f"output.dir={tmp_path / 'run'}", frames=frames)
    corrected = deepir.correct(frames)
    assert np.array_equal(result.gain, corrected.maps.gain.astype(np.float32))
    assert np.array_equal(result.offset, corrected.maps.offset.astype(np.float32))
    assert np.array_equal(result.scene, corrected.frames, equal_nan=True)
    assert result.metrics["correction"] == corrected.estimate.kept
    assert (tmp_path / "run" / "report.html").exists()
    assert not result.bad_pixels[40:60, 50:80].all()
    level = 8450  # of the frames: there the pattern is known best
    found = result.offset + (result.gain - 1) * level
    true = walk.fine + walk.slow + (walk.gain - 1) * (level - 8000)
    assert np.corrcoef(found[~walk.bad], true[~walk.bad])[0, 1] > 0.99


@pytest.mark.parametrize("wrong", ["method.correction=offset", "method.gain=1"])
def test_a_wrong_choice_is_refused(walk, wrong):
    with pytest.raises(deepir.DeepIRError, match=r"allowed|unknown"):
        deepir.run("recording", METHOD, wrong, frames=walk.frames[:5])
