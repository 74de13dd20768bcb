"""Clouds and slopes, weakly textured: the likelihood of shifts, and its integer search."""

import numpy as np
import pytest
import torch
from registered import SHAPE, apart, camera_of_tones, simulated

from deepir.registration import (
    block_likelihood,
    frame_selection,
    moving_objects,
    register,
    shift_likelihood,
)
from deepir.registration.preprocess import variance_stabilise
from deepir.simulate import Settings, simulate
from deepir.simulate.scenes.procedural import load_picture as scene
from deepir.simulate.scenes.procedural import procedural, sky


@pytest.mark.parametrize(("number", "n_frames", "camera"), [(1, 3, {}), (2, 5, {}), (3, 3, {"counts": True})])
def test_clouds_under_a_pattern_stronger_than_they_are_find_their_places(number, n_frames, camera):
    settings = Settings(n_frames=n_frames, shading=0.0, dead_pixels=0.0, **camera)
    found = simulate(sky(number, (430, 500)), settings, seed=12)
    result = register(torch.from_numpy(found.frames.astype(np.float32)))
    assert result.used.all()
    assert np.abs((result.motion.numpy() - found.truth.motion)[:, :2, 2]).max() < 0.5


@pytest.mark.parametrize(("power", "seed"), [(1, 31), (4, 79), (6, 79)])
def test_three_frames_of_which_two_lie_close_do_not_end_where_residuals_are_small(power, seed):
    picture = (
        scene("moon") if power == 1 else procedural(2 * power - 3, (430, 500)) ** power
    )  # dark, few details
    rows = {"photons": 1000.0, "read_noise": 0.002, "gain_row": 0.05, "offset_row": 0.05}
    camera = rows if power == 1 else {"counts": True, "read_noise": 0.003, "offset_pixel": 0.04}
    sim = simulate(picture, Settings(shading=0.0, dead_pixels=0.0, n_frames=3, **camera), seed=seed)
    shifts = register(torch.from_numpy(sim.frames.astype(np.float32))).motion.numpy()[:, :2, 2]
    assert np.abs(shifts - sim.truth.motion[:, :2, 2]).max() < 0.4


@pytest.mark.parametrize("number", [1, 2, 4])
def test_a_bright_slope_with_three_frames_finds_its_places(number):
    sim = simulate(sky(number, (430, 500)), camera_of_tones(n_frames=3), seed=31)
    assert (
        apart(sim, register(torch.from_numpy(sim.frames.astype(np.float32))).motion.numpy()[:, :2, 2]) < 0.35
    )


@pytest.mark.parametrize("seed", [30, 35])
def test_clouds_that_move_are_not_taken_for_still_ones(seed):
    counts = {"counts": True, "read_noise": 0.003, "photons": 0.0}
    sim = simulate(sky(1, (430, 500)), camera_of_tones(n_frames=3, **counts), seed=seed)
    assert (
        apart(sim, register(torch.from_numpy(sim.frames.astype(np.float32))).motion.numpy()[:, :2, 2]) < 0.3
    )


@pytest.mark.parametrize(
    ("number", "seed", "camera"),
    [(6, 32, {"counts": True, "read_noise": 0.003, "photons": 0.0}), (2, 57, {})],
)
def test_clouds_whose_residuals_are_least_at_a_far_place_find_theirs(number, seed, camera, monkeypatch):
    sim = simulate(sky(number, (430, 500)), camera_of_tones(n_frames=3, **camera), seed=seed)
    frames = torch.from_numpy(sim.frames.astype(np.float32))
    assert apart(sim, register(frames).motion.numpy()[:, :2, 2]) < 0.5
    # Without integer shifts they are not found, nor by the search beside moving objects, nor by that of a pan.
    monkeypatch.setattr(block_likelihood, "SELECTION", block_likelihood.ShiftSelection(max_integer_frames=2))
    monkeypatch.setattr(moving_objects, "FIT", moving_objects.FitCriteria(good_nll=torch.inf))
    monkeypatch.setattr(frame_selection, "PAN", frame_selection.PanCriteria(min_shift=1.0))
    assert not apart(sim, register(frames).motion.numpy()[:, :2, 2]) < 0.5


@pytest.mark.parametrize("name", ["camera", "moon", "gravel", "astronaut"])
def test_whole_shifts_are_right_to_a_px_or_so_whatever_the_pattern(name):
    frames, truth = simulated(name, n_frames=4)
    found = shift_likelihood.integer_shifts(variance_stabilise(frames, torch.ones(SHAPE)))
    assert np.abs(found - truth[1:, :2, 2]).max() < 1.5


def test_a_frame_beside_another_is_weighed_by_the_first_harmonic_of_their_likelihood():
    rng = np.random.default_rng(3)
    spectra = shift_likelihood.ShiftLikelihood(torch.from_numpy(rng.normal(size=(2, 24, 30)).cumsum(1)))
    found = shift_likelihood.first_harmonic(spectra, 1, np.array([True, False]), np.zeros((2, 2), int))[
        spectra.band
    ]
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
    around = [
        spectra.negative_log_likelihood(shifts + 1e-5 * way * unit)[0]
        for unit in np.eye(len(shifts))
        for way in (1, -1)
    ]
    np.testing.assert_allclose(
        spectra.negative_log_likelihood(shifts)[1], (np.array(around[::2]) - around[1::2]) / 2e-5, rtol=1e-4
    )


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


@pytest.mark.parametrize("n_frames", [2, 3, 5])
def test_the_shifts_likelihood_is_that_of_the_dense_covariances(n_frames):
    rng = np.random.default_rng(n_frames)
    spectra = shift_likelihood.ShiftLikelihood(
        torch.from_numpy(rng.normal(size=(n_frames, 20, 27)).cumsum(2))
    )
    one, other = rng.normal(0, 3, (2, n_frames - 1, 2))
    gained = (
        spectra.negative_log_likelihood(one.ravel())[0] - spectra.negative_log_likelihood(other.ravel())[0]
    )
    assert np.isclose(gained, log_likelihood(spectra, one) - log_likelihood(spectra, other))


def test_next_to_no_noise_and_no_shift_are_likely_but_not_infinitely():
    rng = np.random.default_rng(0)
    one = torch.from_numpy(rng.normal(size=(1, 20, 400)).cumsum(2))
    spectra = shift_likelihood.ShiftLikelihood(one + 1e-4 * torch.from_numpy(rng.normal(size=(4, 20, 400))))
    still, moved = np.zeros((3, 2)), np.full((3, 2), 0.7)
    spectra.update_powers(still)
    gained = (
        spectra.negative_log_likelihood(moved.ravel())[0] - spectra.negative_log_likelihood(still.ravel())[0]
    )
    wanted = log_likelihood(spectra, moved) - log_likelihood(spectra, still)
    assert np.isclose(gained, wanted, rtol=1e-4)  # of such frames nearly all cancels


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
