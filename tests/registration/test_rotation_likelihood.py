"""Weakly textured scenes before which the camera rotates: the block-wise likelihood of rotations."""

import numpy as np
import pytest
import torch
from registered import camera_of_tones
from scipy.optimize import check_grad

from deepir.operators.motion_models import transform_points
from deepir.registration import motion_search, register
from deepir.registration.block_likelihood import (
    RotationLikelihood,
    likelihood_frames,
    maximise_rotation_likelihood,
)
from deepir.simulate import simulate
from deepir.simulate.scenes.procedural import sky

COUNTS = {"counts": True, "read_noise": 0.003, "photons": 0.0}
STRONG = {"gain_pixel": 0.1, "offset_pixel": 0.1, "offset_row": 0.05}


def turning(number, seed, **settings):
    """Frames of a sky before which the camera shifts and turns, and how far motions are off at their corners, px."""
    sim = simulate(sky(number, (430, 500)), camera_of_tones(**settings), seed=seed)
    h, w = sim.frames.shape[1:]
    corners = torch.tensor([[-w, w, -w, w], [-h, -h, h, h], [2, 2, 2, 2]], dtype=torch.float64) / 2
    true = transform_points(torch.from_numpy(sim.truth.motion), corners)

    def off(motion):
        return float((transform_points(motion, corners) - true).norm(dim=1).max())

    return torch.from_numpy(sim.frames.astype(np.float32)), off


def test_the_likelihood_of_turns_has_the_slope_that_it_says():
    frames, _ = turning(3, 5, n_frames=3, max_rotation=3.0)
    turns = RotationLikelihood(likelihood_frames(frames, torch.ones(frames.shape[1:]), 100)[0])
    start = np.array([1.0, -0.5, 2.0, 0.3, 2.0, -1.0])
    slope = np.abs(turns.negative_log_likelihood(start)[1]).max()
    assert (
        check_grad(
            lambda x: turns.negative_log_likelihood(x)[0],
            lambda x: turns.negative_log_likelihood(x)[1],
            start,
        )
        < 1e-4 * slope
    )


@pytest.mark.parametrize(
    ("number", "seed", "settings"),
    [
        pytest.param(1, 21, {}, marks=pytest.mark.slow),
        (1, 21, STRONG),
        (3, 43, COUNTS | STRONG),
        (8, 50, COUNTS | STRONG),
    ],
)
def test_clouds_before_which_the_camera_turns_are_found(number, seed, settings, monkeypatch):
    frames, off = turning(number, seed, n_frames=6, max_rotation=2.0, max_shift=8.0, **settings)
    result = register(frames)
    assert result.used.all()
    assert off(result.motion) < 0.4
    monkeypatch.setattr(motion_search, "maximise_rotation_likelihood", lambda frames, start: start)
    assert off(register(frames).motion) > 0.7


def test_from_no_turn_at_all_the_likeliest_is_near():
    frames, off = turning(2, 31, n_frames=6, max_rotation=2.0, max_shift=4.0)
    still = torch.eye(3, dtype=torch.float64).repeat(6, 1, 1)
    found = maximise_rotation_likelihood(likelihood_frames(frames, torch.ones(frames.shape[1:]))[0], still)
    assert off(found) < 0.3 * off(still)
