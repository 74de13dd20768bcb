"""A closure of the shutter gives a recording another fixed pattern: each part gets maps of its own."""

import numpy as np
import pytest

from deepir.correct_recording import correct
from deepir.errors import ConfigError, DataError
from deepir.recording.segments import Segment, pattern_jumps, segment_at
from deepir.simulate.recording import RecordingSettings, simulate_recording

JUMP = 62  # first frame with the second pattern


@pytest.fixture(scope="module")
def jumping(walk):
    """The walk, with another pattern from a frame on; and that pattern."""
    change = 40 * np.random.default_rng(1).standard_normal(walk.gain.shape)
    frames = walk.frames.astype(np.float32)
    frames[JUMP:] += change
    return frames, change


def test_a_pattern_jumps_only_where_it_changes_at_once(walk):
    frames = walk.frames.astype(np.float32)
    assert pattern_jumps(frames) == []
    drift = np.random.default_rng(2).standard_normal(walk.gain.shape)
    assert pattern_jumps(frames + np.arange(len(frames))[:, None, None] * drift) == []
    frames[:40, 10:20] = np.nan  # lost for long
    assert pattern_jumps(frames) == []
    assert pattern_jumps(np.full((60, 40, 40), 7.0, np.float32)) == []


def test_a_jump_is_found_at_its_frame(jumping):
    frames, _ = jumping
    (found,) = pattern_jumps(frames)
    assert abs(found - JUMP) <= 1


def test_a_camera_that_stands_at_the_ends_of_a_pan_does_not_change_its_pattern():
    recording = simulate_recording(RecordingSettings(kind="pan", n_frames=100, shape=(96, 128)), seed=22)
    corrected = correct(recording.frames)
    assert len(corrected.segments) == 1
    good, scenes = ~recording.truth.bad_pixels, recording.truth.scene
    for number in (0, 50, 99):
        raw, left = recording.frames[number], corrected.correct(recording.frames[number], number)
        assert np.std((left - scenes[number])[good]) < 0.4 * np.std((raw - scenes[number])[good])


def test_a_part_at_rest_is_corrected_with_the_maps_of_its_neighbour_if_they_fit(walk):
    rest = walk.frames[40:41] + np.random.default_rng(6).integers(-5, 6, (60, *walk.gain.shape))
    frames = np.concatenate([walk.frames[:40], rest]).astype(np.float32)
    another = 40 * np.random.default_rng(1).standard_normal(walk.gain.shape)
    changed = np.concatenate([frames[:40], frames[40:] - walk.fine + another]).astype(np.float32)
    good = ~walk.bad
    left, untouched = (correct(each).correct(each[70], 70) for each in (frames, changed))
    assert np.std((left - walk.scenes[40])[good]) < 0.6 * np.std((frames[70] - walk.scenes[40])[good])
    assert np.array_equal(untouched, changed[70])


def test_each_part_is_corrected_with_its_own_pattern(walk, jumping, tmp_path):
    frames, change = jumping
    corrected = correct(frames)
    assert len(corrected.segments) == 2
    first, second = (each.estimate.offset for each in corrected.segments)
    assert np.corrcoef((second - first)[~walk.bad], change[~walk.bad])[0, 1] > 0.9
    errors = np.stack(list(corrected))[::5] - walk.scenes[::5]
    assert np.std(errors.mean(0)[~walk.bad]) < 0.1 * np.std((frames - walk.scenes).mean(0)[~walk.bad])
    corrected.save_maps(tmp_path / "maps.npz")
    with np.load(tmp_path / "maps.npz") as maps:
        assert maps["offsets"].shape == (2, *walk.gain.shape)
        assert np.array_equal(maps["offset"], maps["offsets"][-1])


def test_between_two_keyframes_the_pattern_that_fits_is_taken(walk, corrected):
    estimate = corrected.segments[0].estimate
    parts = [Segment(0, 40, estimate), Segment(50, 119, None, "few frames")]
    assert segment_at(parts, 45, walk.frames[45]) is parts[0]
    assert segment_at(parts, 45, corrected.correct(walk.frames[45], 45)) is parts[1]
    assert segment_at(parts, 39, walk.frames[39]) is parts[0]
    assert np.array_equal(parts[1].correct(walk.frames[60]), walk.frames[60])


def test_a_recording_without_any_part_to_correct_is_refused(walk):
    still = np.repeat(walk.frames[:1].astype(np.float32), 80, 0)
    still += np.random.default_rng(3).standard_normal(still.shape)
    still[40:] += 50 * np.random.default_rng(4).standard_normal(still.shape[1:])
    with pytest.raises(DataError, match="stands still"):
        correct(still)


def test_a_turned_or_raw_recording_is_corrected_from_python(walk, tmp_path, estimated_once):
    frames = walk.frames[:12, :64, :80]
    turned = np.ascontiguousarray(frames.transpose(1, 2, 0))
    wanted = correct(frames).frames
    assert np.array_equal(correct(turned, axes="hwn").frames, wanted)
    path = tmp_path / "walk.raw"
    path.write_bytes(frames.astype(">u2").tobytes())
    raw = {"width": wanted.shape[2], "height": wanted.shape[1]}
    assert np.array_equal(correct(path, raw=raw, swap_bytes=True).frames, wanted)
    with pytest.raises(ConfigError, match=r"no option 'raw\.widht'"):
        correct(path, raw={"widht": 8, "height": 8})
    with pytest.raises(ConfigError, match="'swap_bytes' is for a file"):
        correct(walk.frames, swap_bytes=True)
