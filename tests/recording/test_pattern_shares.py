"""Other frames tell how much of an estimated pattern is the sensor's."""

import numpy as np
import pytest
from scipy import ndimage

from deepir.multiview.pattern_gradients import contains_pattern, removes_more, shares


def detail(scene):
    """What a fine pattern that was estimated from this scene alone would have of it."""
    return scene - ndimage.gaussian_filter(scene, 4.0)


def test_frames_hold_all_of_the_sensors_pattern_and_nothing_of_another_scene(walk):
    parts = np.stack([walk.fine, detail(walk.scenes[0]), 0 * walk.fine])
    found, errors = shares((walk.frames[60::8] - 8000) / walk.gain, parts, ~walk.bad)
    assert found[0] == pytest.approx(1, abs=0.05)
    assert abs(found[1]) < 0.2
    assert (errors[:2] < 0.05).all()
    assert found[2] == 0 < 100 < errors[2]  # of a pattern of zero


def test_a_correction_that_does_not_fit_is_known_from_one_frame(walk):
    frame, other = walk.frames[70].astype(float), np.random.default_rng(2).permutation(walk.fine)
    assert contains_pattern(frame, frame - walk.fine, walk.bad)
    assert not contains_pattern(frame, frame - other, walk.bad)
    assert removes_more(frame - other, frame - walk.fine, walk.bad)
    assert not removes_more(frame - walk.fine, frame - 0.7 * walk.fine, walk.bad)


def test_a_pattern_that_one_frame_does_not_tell_is_kept(walk):
    frame, faint = walk.frames[70].astype(float), 1e-3 * np.random.default_rng(2).permutation(walk.fine)
    assert contains_pattern(frame, frame - faint, walk.bad)
