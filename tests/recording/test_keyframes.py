"""Frames that are chosen of a recording while it is read once."""

import numpy as np
from scipy import ndimage
from skimage import data

from deepir.recording.keyframes import MAX_GROUPS, SHORT, choose_keyframes, coarse, motion_spacing, spread

SIZE = (48, 64)


def pan(count: int, speed: float, seed: int = 0) -> np.ndarray:
    """Frames (count, 48, 64) of a camera that pans over random hills at `speed` px a frame."""
    rng = np.random.default_rng(seed)
    waves = rng.standard_normal((2, 20))
    x = np.arange(SIZE[1])[None, None] + speed * np.arange(count)[:, None, None]
    y = np.arange(SIZE[0])[None, :, None]
    frames = sum(np.sin(0.3 * a * x + 0.3 * b * y) for a, b in waves.T)
    return (1000 + 100 * frames).astype(np.uint16)


def test_a_short_recording_is_kept_whole_but_for_repeats():
    frames = np.repeat(pan(20, 2.0), 3, axis=0)
    found = choose_keyframes(iter(frames))
    assert found.length == 60
    np.testing.assert_array_equal(found.numbers, np.arange(0, 60, 3))


def test_a_long_recording_is_spread_over_its_length_within_bounds():
    frames = pan(3 * SHORT, 2.0)
    found = choose_keyframes(iter(frames))
    assert len(found.frames) <= 4 * MAX_GROUPS
    assert found.numbers[0] < 0.1 * len(frames)
    assert found.numbers[-1] > 0.85 * len(frames)
    np.testing.assert_array_equal(found.frames, frames[found.numbers])


def test_no_keyframes_are_taken_while_the_camera_rests():
    moving = pan(SHORT, 2.0)
    rest = np.repeat(moving[-1:], 2 * SHORT, axis=0) + np.random.default_rng(1).integers(0, 3, (2 * SHORT, *SIZE))
    found = choose_keyframes(iter(np.concatenate([moving, rest.astype(np.uint16)])))
    assert (found.numbers < SHORT).mean() > 0.8


def test_the_spacing_follows_the_motion():
    spacings = [motion_spacing(np.stack([coarse(f) for f in pan(65, speed)]))[0] for speed in (0.25, 1.0)]
    assert spacings[0] > 2 * spacings[1]


def test_pairs_are_spread_evenly():
    pairs = [(k, k + 1) for k in range(100)]
    assert spread(pairs, 3) == [(0, 1), (49, 50), (99, 100)]
    assert spread(pairs[:2], 3) == pairs[:2]


def test_frames_of_numbers_are_no_keyframes(caplog):
    frames = pan(40, 2.0) + np.random.default_rng(1).normal(0, 3, (40, 48, 64))
    frames[:4] = np.random.default_rng(2).uniform(0, 16383, (4, 48, 64))
    chosen = choose_keyframes(iter(frames))
    assert chosen.numbers.tolist() == list(range(4, 40))
    assert "frame(s) 0, 1, 2, 3 are no pictures" in caplog.text


def test_grass_after_the_plain_sky_is_a_picture(caplog):
    grass = 6 * np.tile(ndimage.gaussian_filter(data.grass()[:48].astype(float), 0.6), (1, 2))
    walk = 8000 + np.random.default_rng(0).normal(0, 4, (460, 48, 64))
    walk[400:] += [grass[:, 8 * k : 8 * k + 64] for k in range(60)]
    assert choose_keyframes(iter(walk)).numbers[-1] > 440
    assert "no pictures" not in caplog.text
