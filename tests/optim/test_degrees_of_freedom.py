"""Noise does not draw the motion to whole pixels."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import BSpline

import deepir
import deepir.optim.objective
from deepir.optim.fourier_hessian import GRADIENT_WEIGHT, degrees_of_freedom
from deepir.simulate import Settings, simulate
from deepir.simulate.scenes.procedural import sky

SIDE = 16  # px of a scene that goes round
CUBIC = BSpline.basis_element(np.arange(-2.0, 3.0), extrapolate=False)


def shifts(*by):
    motion = torch.eye(3, dtype=torch.float64).repeat(len(by), 1, 1)
    motion[:, :2, 2] = torch.tensor(by, dtype=torch.float64)
    return motion


def sampled(shift):
    """Of coefficients on a ring, (SIDE, SIDE): the spline at all pixels plus a shift."""
    apart = np.arange(SIDE)[:, None] + shift - np.arange(SIDE)
    return np.nan_to_num(CUBIC((apart + SIDE / 2) % SIDE - SIDE / 2))


def explained(by):
    """Half of the noise's sum of squares that least squares explain, expected: half the trace of the projection."""
    frames = np.concatenate([np.kron(sampled(y), sampled(x)) for x, y in by])
    step = np.eye(SIDE) - np.roll(np.eye(SIDE), 1, 0)
    along_x, along_y = np.kron(np.eye(SIDE), step), np.kron(step, np.eye(SIDE))
    normal, gradients = frames.T @ frames, along_x.T @ along_x + along_y.T @ along_y
    return np.trace(np.linalg.solve(normal + len(by) * GRADIENT_WEIGHT * gradients, normal)) / 2


@pytest.mark.parametrize("by", [((0, 0), (2.5, 0.5)), ((0, 0), (0.3, -1.2), (0.8, 0.6)), ((0, 0), (0.5, 3.0))])
def test_degrees_of_freedom_are_the_noise_that_least_squares_explain(by):
    lost = explained(((0, 0),)) - explained(by)
    ours = degrees_of_freedom(shifts((0, 0)), (SIDE, SIDE)) - degrees_of_freedom(shifts(*by), (SIDE, SIDE))
    assert float(ours) == pytest.approx(lost, rel=0.05)
    assert lost > 1


@given(st.floats(0.05, 0.45), st.integers(-20, 20))
def test_shifts_by_half_a_pixel_explain_least_and_whole_pixels_do_not_count(part, whole):
    def gained(shift):
        return float(degrees_of_freedom(shifts((0, 0), (0, shift)), (40, 50)))

    assert gained(part + whole) == pytest.approx(gained(part))
    assert gained(1 - part) == pytest.approx(gained(part))
    assert gained(part + 0.05) < gained(part)


@pytest.mark.slow
def test_a_plain_noisy_sky_is_not_drawn_to_whole_pixels(monkeypatch):
    def drawn(seed):
        """How much nearer to whole pixels than the truth the shifts of a sky are found, in px, in the mean."""
        camera = Settings(3, photons=1000.0, read_noise=0.002, shading=0.0, dead_pixels=0.0)
        sim = simulate(sky(seed, (430, 500)), camera, seed=seed)
        true = sim.truth.motion[1:, :2, 2]
        found = deepir.run("nuc", frames=sim.frames).motion[1:, :2, 2]
        return np.mean((found - true) * np.sign(np.round(true) - true))

    with_it = np.median([drawn(seed) for seed in range(41, 47)])
    monkeypatch.setattr(deepir.optim.objective, "is_joint_with_motion", lambda *_: False)
    without = np.median([drawn(seed) for seed in range(41, 47)])
    assert without > 0.04
    assert abs(with_it) < without / 3
