"""Least mean squares: gated towards a smoothed frame, and between registered frames."""

import numpy as np

from deepir.baselines.least_mean_squares import (
    corrections_over_time,
    frame_sequence,
    gain_and_offset,
    learn_correction,
    warp_bilinear,
)
from deepir.baselines.rival import last_of, normalise
from deepir.simulate import render
from deepir.simulate.scenes.procedural import load_picture

FULL = 16383  # of 14 bits

# ---- towards a smoothed frame ----


def learnt(frames, gate=0.01, passes=1):
    """Weight and bias by gated least mean squares."""
    return last_of(corrections_over_time(frames, frame_sequence(len(frames), passes), 0.2, 3.0, gate))


def test_offsets_of_pixels_go_while_a_smooth_scene_moves():
    rng = np.random.default_rng(0)
    offset = 0.05 * rng.standard_normal((32, 40))
    y, x = np.mgrid[:32, :40] / 12
    shifts = np.cumsum(rng.standard_normal((60, 2)), 0)
    scene = np.stack([0.5 + 0.2 * np.sin(x + a) + 0.2 * np.cos(y + b) for a, b in shifts])
    weight, bias = learnt(scene + offset)
    assert (weight * (scene[-1] + offset) + bias - scene[-1]).std() < 0.5 * offset.std()


def test_a_scene_that_stands_still_is_learnt_once_and_not_burnt_in():
    # Hardie et al. 2009: without the gate, a still scene turns into a ghost.
    frames = np.repeat([np.kron(np.eye(4), np.ones((8, 10)))], 50, axis=0)
    ungated, gated = (learnt(frames, gate)[1] for gate in (0.0, 0.01))
    once = learnt(frames[:1], passes=0)[1]
    assert np.allclose(gated, once, atol=0.02)
    assert np.abs(ungated).max() > 5 * np.abs(gated).max()


def test_edges_are_learnt_less_from():
    frame = np.kron([[0.0, 1.0]], np.ones((20, 20)))[None]
    _, bias = learnt(frame, 0.0, passes=0)
    assert np.abs(bias).max() < 0.02  # a plain LMS would take a tenth: the rate times half the edge


# ---- between registered frames ----


def video(n=50, shape=(96, 128), contrast=12_000):
    """A scene in counts that wanders by a few px from frame to frame, and its motion."""
    rng = np.random.default_rng(0)
    at = np.zeros((n, 2))
    for k in np.arange(1, n):
        step = rng.uniform(-5, 5, 2)
        at[k] = at[k - 1] + np.where(np.abs(at[k - 1] + step) > 18, -step, step)
    motion = np.tile(np.eye(3), (n, 1, 1))
    motion[:, :2, 2] = at
    return 2000 + contrast * render(load_picture("moon"), motion, shape, 2.8, 0.5), motion


def test_a_pattern_of_14_bits_is_gone_after_50_frames():
    # Zuo et al. 2011: gain sigma 0.2, offset sigma 40: above 35 dB after 50 frames.
    scene, motion = video()
    rng = np.random.default_rng(1)
    gain, offset = 1 + 0.2 * rng.standard_normal(scene.shape[1:]), 40 * rng.standard_normal(scene.shape[1:])
    frames = np.clip(np.rint(gain * scene + offset), 0, FULL)
    inside, low, span = normalise(frames)
    weight, bias = learn_correction(inside, motion, rate=0.1)
    result = low + span * (weight * inside[-1] + bias)

    def psnr(found):
        return 20 * np.log10(FULL / (found - scene[-1]).std())

    assert psnr(frames[-1]) < 22
    assert psnr(result) > 35


def test_a_scene_without_pattern_teaches_nothing():
    weight, bias = learn_correction(np.full((4, 10, 12), 0.5), np.tile(np.eye(3), (4, 1, 1)), 0.1, 5)
    assert (weight == 1).all()
    assert (bias == 0).all()


def test_a_stuck_pixel_does_not_spread():
    scene, motion = video(n=6)
    frames, _, _ = normalise(scene)
    clean = learn_correction(frames, motion, 0.1, 100)
    frames[:, 40, 50] = 6.0
    spoilt = learn_correction(frames, motion, 0.1, 100)
    for each, other in zip(clean, spoilt, strict=True):
        assert np.isfinite(other).all()
        assert np.abs(other - each)[:15].max() < 0.02


def test_a_frame_moves_as_the_motion_says():
    frame = np.random.default_rng(2).random((9, 11))
    found = warp_bilinear(frame, np.array([[1, 0, 2], [0, 1, -1], [0, 0, 1.0]]))  # a pull: +x right, +y down
    assert np.allclose(found[1:, :-2], frame[:-1, 2:])
    assert np.isnan(found[0]).all()


def test_correction_and_sensor_are_inverse_and_frames_are_played_forth_and_back():
    rng = np.random.default_rng(3)
    weight, bias, frame = 1 + 0.1 * rng.random((4, 5)), rng.random((4, 5)), 100 + 50 * rng.random((4, 5))
    gain, offset = gain_and_offset(weight, bias, 100.0, 50.0)
    clean = 100 + 50 * (weight * (frame - 100) / 50 + bias)
    assert np.allclose((frame - offset) / gain, clean)
    assert list(frame_sequence(4, 2)) == [0, 1, 2, 3, 2, 1, 0]
    assert list(frame_sequence(1, 3)) == [0]
