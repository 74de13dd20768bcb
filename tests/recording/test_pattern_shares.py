"""Other frames tell how much of an estimated pattern is the sensor's."""

import numpy as np
import pytest
from scipy import ndimage

from deepir.recording.pattern_shares import PARTS, share_removed, shares, shrink_offset


def detail(scene):
    """What a fine pattern that was estimated from this scene alone would have of it."""
    return scene - ndimage.gaussian_filter(scene, 4.0)


def test_frames_hold_all_of_the_sensors_pattern_and_nothing_of_another_scene(walk):
    frames = (walk.frames[60::8] - 8000) / walk.gain
    parts = np.stack([walk.fine, detail(walk.scenes[0])])

    found = shares(frames, parts, ~walk.bad)

    assert found[0] == pytest.approx(1, abs=0.05)
    assert abs(found[1]) < 0.2


def test_rows_that_no_other_frame_has_are_taken_out(walk):
    false = walk.fine + np.where(np.arange(len(walk.fine)) % 2, 30, -30)[:, None]  # rows that no frame has

    shrunk, found = shrink_offset(false, ~walk.bad, walk.frames[60::8].astype(float))

    assert found["rows"] < 0.2
    assert found["columns"] > 0.9
    assert found["pixels"] > 0.9
    assert list(found) == list(PARTS)
    assert np.std((shrunk - walk.fine)[~walk.bad]) < 0.3 * np.std((false - walk.fine)[~walk.bad])


def test_a_correction_that_does_not_fit_is_known_from_one_frame(walk):
    frame, other = walk.frames[70].astype(float), np.random.default_rng(2).permutation(walk.fine)

    assert share_removed(frame, frame - walk.fine, walk.bad) > 0.8
    assert share_removed(frame, frame - other, walk.bad) < 0.4


def test_a_pattern_of_zero_has_no_share(walk):
    assert np.isfinite(
        shares(walk.frames[:2].astype(float), np.zeros((1, *walk.fine.shape)), ~walk.bad)
    ).all()
