"""Weakly textured scenes: the likelihoods of shifts and of rotations, and the integer search."""

import numpy as np
import pytest
import torch
from registered import SHAPE, TONES, TONES_IN_COUNTS, recorded, simulated
from scipy.optimize import check_grad

from deepir.operators.motion_models import transform_points
from deepir.registration import (
    block_likelihood,
    frame_selection,
    motion_search,
    moving_objects,
    register,
    shift_likelihood,
)
from deepir.registration.block_likelihood import RotationLikelihood, likelihood_frames, maximise_rotation_likelihood
from deepir.registration.preprocess import variance_stabilise

STRONG = {"gain_pixel": 0.1, "offset_pixel": 0.1, "offset_row": 0.05}


def off(motion, sim):
    """Largest distance (px) of a motion from the true one, at the corners of the frames."""
    h, w = sim.frames.shape[1:]
    corners = torch.tensor([[-w, w, -w, w], [-h, -h, h, h], [2, 2, 2, 2]], dtype=torch.float64) / 2
    found, true = (transform_points(each, corners) for each in (motion, torch.from_numpy(sim.truth.motion)))
    return float((found - true).norm(dim=1).max())


@pytest.mark.parametrize(("name", "seed", "camera"), [("sky 6", 32, TONES_IN_COUNTS), ("sky 2", 57, TONES)])
def test_clouds_whose_residuals_are_least_at_a_far_place_are_found_by_integer_shifts(name, seed, camera, monkeypatch):
    sim, frames = recorded(name, seed, n_frames=3, **camera)
    assert off(register(frames).motion, sim) < 0.5
    # Without integer shifts they are not found, nor by the search beside moving objects, nor by that of a pan.
    monkeypatch.setattr(block_likelihood, "MAX_INTEGER_FRAMES", 2)
    monkeypatch.setattr(moving_objects, "GOOD_NLL", torch.inf)
    monkeypatch.setattr(frame_selection, "PAN_SHIFT", 1.0)
    assert not off(register(frames).motion, sim) < 0.5


@pytest.mark.parametrize("name", ["camera", "moon", "gravel", "astronaut"])
def test_whole_shifts_are_right_to_a_px_or_so_whatever_the_pattern(name):
    frames, truth = simulated(name, n_frames=4)
    found = shift_likelihood.integer_shifts(variance_stabilise(frames, torch.ones(SHAPE)))
    assert np.abs(found - truth[1:, :2, 2]).max() < 1.5


def test_the_first_harmonic_is_that_of_the_dense_likelihood():
    rng = np.random.default_rng(3)
    spectra = shift_likelihood.ShiftLikelihood(torch.from_numpy(rng.normal(size=(2, 24, 30)).cumsum(1)))
    found = shift_likelihood.first_harmonic(spectra, 1, np.array([True, False]), np.zeros((2, 2), int))[spectra.band]
    turns = np.exp(2j * np.pi * np.arange(64) / 64)
    for wave in ((5, 4), (2, 7), (12, 3)):
        scene, noise = spectra.scene[wave], spectra.noise[wave]
        seen, nats = spectra.frames[:, *wave], []
        for turn in turns:
            of_scene = scene * np.outer([1, turn], [1, turn.conj()])
            covariance = of_scene + spectra.pattern + noise * np.eye(2)
            misfit = (seen.conj() @ np.linalg.solve(covariance, seen)).real
            nats.append(np.linalg.slogdet(covariance)[1] + misfit)
        assert np.isclose(found[wave], np.mean(nats * turns.conj()), rtol=1e-6)


def test_the_slope_of_the_shifts_likelihood_is_that_of_its_differences():
    frames, truth = simulated("moon")
    shifts = truth[1:, :2, 2].ravel() + 0.3
    spectra = shift_likelihood.ShiftLikelihood(variance_stabilise(frames, torch.ones(SHAPE)))
    value, slope = (lambda x, part=part: spectra.negative_log_likelihood(x)[part] for part in (0, 1))
    assert check_grad(value, slope, shifts) < 1e-4 * np.abs(slope(shifts)).max()


def log_likelihood(spectra, shifts):
    """Minus twice that of waves of all frames, by their dense covariances."""
    total, (x, y) = 0.0, np.vstack((np.zeros(2), shifts)).T
    for row, column in np.ndindex(spectra.scene.shape):
        turn = np.exp(1j * (y * spectra.y[row] + x * spectra.x[column]))
        covariance = spectra.scene[row, column] * np.outer(turn, turn.conj()) + spectra.pattern
        covariance += spectra.noise[row, column] * np.eye(len(turn))
        seen = spectra.frames[:, row, column]
        total += np.linalg.slogdet(covariance)[1] + (seen.conj() @ np.linalg.solve(covariance, seen)).real
    return total


def gained(spectra, one, other):
    """Nats by which shifts are likelier than others, and those of the dense covariances."""
    ours = [spectra.negative_log_likelihood(each.ravel())[0] for each in (one, other)]
    return ours[0] - ours[1], log_likelihood(spectra, one) - log_likelihood(spectra, other)


@pytest.mark.parametrize("n_frames", [2, 3, 5])
def test_the_shifts_likelihood_is_that_of_the_dense_covariances(n_frames):
    rng = np.random.default_rng(n_frames)
    frames = torch.from_numpy(rng.normal(size=(n_frames, 20, 27)).cumsum(2))
    one, other = rng.normal(0, 3, (2, n_frames - 1, 2))
    assert np.isclose(*gained(shift_likelihood.ShiftLikelihood(frames), one, other))


def test_frames_at_rest_with_hardly_any_noise_have_a_finite_likelihood():
    rng = np.random.default_rng(0)
    one = torch.from_numpy(rng.normal(size=(1, 20, 400)).cumsum(2))
    spectra = shift_likelihood.ShiftLikelihood(one + 1e-4 * torch.from_numpy(rng.normal(size=(4, 20, 400))))
    still, moved = np.zeros((3, 2)), np.full((3, 2), 0.7)
    spectra.update_powers(still)
    assert np.isclose(*gained(spectra, moved, still), rtol=1e-4)  # of such frames nearly all cancels


def test_with_each_update_the_powers_are_likelier():
    frames, truth = simulated("moon", n_frames=4)
    spectra, shifts = (
        shift_likelihood.ShiftLikelihood(variance_stabilise(frames, torch.ones(SHAPE))[:, 40:80, 50:100]),
        truth[1:, :2, 2],
    )
    found = []
    for _ in range(4):
        found.append(log_likelihood(spectra, shifts))
        spectra.update_powers(shifts)
    assert (np.diff(found) < 0).all()


def test_the_likelihood_of_rotations_has_the_slope_of_its_differences():
    _, frames = recorded("sky 3", 5, **TONES | {"n_frames": 3, "max_rotation": 3.0})
    turns = RotationLikelihood(likelihood_frames(frames, torch.ones(frames.shape[1:]), 100)[0])
    start = np.array([1.0, -0.5, 2.0, 0.3, 2.0, -1.0])
    value, slope = (lambda x, part=part: turns.negative_log_likelihood(x)[part] for part in (0, 1))
    assert check_grad(value, slope, start) < 1e-4 * np.abs(slope(start)).max()


@pytest.mark.parametrize(
    ("name", "seed", "camera"),
    [
        pytest.param("sky 1", 21, TONES, marks=pytest.mark.slow),
        ("sky 1", 21, TONES | STRONG),
        ("sky 3", 43, TONES_IN_COUNTS | STRONG),
        ("sky 8", 50, TONES_IN_COUNTS | STRONG),
    ],
)
def test_clouds_before_which_the_camera_turns_are_found_by_the_likelihood_of_rotations(name, seed, camera, monkeypatch):
    sim, frames = recorded(name, seed, n_frames=6, max_rotation=2.0, max_shift=8.0, **camera)
    result = register(frames)
    assert result.used.all()
    assert off(result.motion, sim) < 0.4
    monkeypatch.setattr(motion_search, "maximise_rotation_likelihood", lambda frames, start: start)
    assert off(register(frames).motion, sim) > 0.7


def test_from_no_rotation_at_all_the_likeliest_is_near():
    sim, frames = recorded("sky 2", 31, n_frames=6, max_rotation=2.0, max_shift=4.0, **TONES)
    still = torch.eye(3, dtype=torch.float64).repeat(6, 1, 1)
    found = maximise_rotation_likelihood(likelihood_frames(frames, torch.ones(frames.shape[1:]))[0], still)
    assert off(found, sim) < 0.3 * off(still, sim)
