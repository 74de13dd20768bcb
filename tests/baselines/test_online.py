"""Online methods: gated least mean squares, and constant statistics."""

import numpy as np

from deepir.baselines.online import last_of
from deepir.baselines.temporal.constant_statistics import equalised_statistics, running_statistics
from deepir.baselines.temporal.galms import learn_correction


def video(n=60, moves=True):
    """A smooth scene that moves, and the offsets of pixels."""
    rng = np.random.default_rng(0)
    offset = 0.05 * rng.standard_normal((32, 40))
    y, x = np.mgrid[:32, :40] / 12
    shifts = np.cumsum(rng.standard_normal((n, 2)), 0) * moves
    scene = np.stack([0.5 + 0.2 * np.sin(x + a) + 0.2 * np.cos(y + b) for a, b in shifts])
    return scene, offset, scene + offset


def error(scene, frames, weight, bias):
    return (weight * frames[-1] + bias - scene[-1]).std()


def test_offsets_of_pixels_go_while_a_smooth_scene_moves():
    scene, _, frames = video()
    assert error(scene, frames, *learn_correction(frames, 0.2, 3.0, 0.01)) < 0.5 * error(scene, frames, 1, 0)


def test_a_scene_that_stands_still_is_learnt_once_and_not_burnt_in():
    # Hardie et al. 2009: without the gate, a still scene turns into a ghost.
    frames = np.repeat([np.kron(np.eye(4), np.ones((8, 10)))], 50, axis=0)
    ungated, gated = (learn_correction(frames, 0.2, 3.0, gate)[1] for gate in (0.0, 0.01))
    once = learn_correction(frames[:1], 0.2, 3.0, 0.01, passes=0)[1]
    assert np.allclose(gated, once, atol=0.02)
    assert np.abs(ungated).max() > 5 * np.abs(gated).max()


def test_edges_lower_the_learning_rate():
    frame = np.kron([[0.0, 1.0]], np.ones((20, 20)))[None]
    _, bias = learn_correction(frame, 0.2, 3.0, 0.0, passes=0)
    assert np.abs(bias).max() < 0.02  # a plain LMS would take a tenth: the rate times half the edge


def test_gain_and_offset_are_found_where_all_pixels_see_the_same_statistics():
    rng = np.random.default_rng(0)
    gain, offset = 1 + 0.1 * rng.standard_normal((8, 9)), 20 * rng.standard_normal((8, 9))
    found_gain, found_offset = equalised_statistics(gain * rng.uniform(0, 100, (4000, 8, 9)) + offset)
    assert np.abs(found_gain - gain / gain.mean()).max() < 0.05
    assert np.corrcoef(found_offset.ravel(), offset.ravel())[0, 1] > 0.98


def test_frames_that_do_not_change_have_no_gain():
    frame = np.random.default_rng(2).random((3, 4))
    gain, offset = equalised_statistics(np.stack([frame, frame]))
    assert np.allclose(gain, 1)
    assert np.allclose(offset, frame - frame.mean())


def test_the_recursion_gives_the_mean():
    frames = np.random.default_rng(1).random((7, 3, 4))
    assert np.allclose(last_of(running_statistics(frames))[0], frames.mean(0))
