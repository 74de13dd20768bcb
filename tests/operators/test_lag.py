"""Thermal inertia: `tau dy/dt = x - y`, against its solutions, and the camera's path between frames."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from deepir.operators import Chain, Lag, Sensor, Warp
from deepir.operators.base import Trajectory
from deepir.testing import check_operator

FPS = 60.0
FRAME = 1000 / FPS  # ms
REST, MOVING = (torch.full((1, 1, 1, 1), share, dtype=torch.float64) for share in (0.0, 1.0))


def shown(flux, tau, substeps=4, n_frames=9):
    """Frames of a pixel that sees `flux`, a function of time in frames, from rest."""
    lag = Lag(FPS, substeps=substeps)
    x = flux(instants(lag, n_frames))[:, None, None, None]
    return lag(x, tau=torch.full((1, 1, 1, 1), tau, dtype=torch.float64), moving=REST).flatten()


def instants(lag, n_frames):
    """Times at which the flux is wanted, in frames."""
    path = lag.trajectory
    return (torch.arange(path.count(n_frames), dtype=torch.float64) - path.n_before) / path.steps


@pytest.mark.parametrize("tau", [6.0, 10.0])
def test_a_step_is_followed_as_the_paper_says_if_the_sub_steps_are_many(tau):
    time = torch.arange(9, dtype=torch.float64)
    found = shown(lambda at: 2 + 3 * (at > 1).double(), tau, substeps=100)
    wanted = 5 - 3 * torch.exp(-(time - 1).clamp(min=0) * FRAME / tau)
    assert torch.allclose(found, wanted, atol=0.01)


@given(tau=st.floats(3, 30), period=st.floats(3, 12), phase=st.floats(0, 6))
@settings(max_examples=20, deadline=None)
def test_four_sub_steps_solve_the_differential_equation_for_a_smooth_flux(tau, period, phase):
    def flux(time):
        return np.sin(2 * np.pi * time / period + phase) * (1 - np.exp(-((time / 2) ** 2)))

    time = np.arange(9)
    exact = solve_ivp(lambda t, y: (flux(t) - y) * FRAME / tau, (0, 8), [0.0], t_eval=time, rtol=1e-9, atol=1e-10)
    found = shown(lambda at: torch.from_numpy(flux(at.numpy())), tau)
    np.testing.assert_allclose(found, exact.y[0], atol=0.02)


def test_twice_the_sub_steps_leave_an_eighth_of_the_error():
    def flux(time):
        return torch.sin(time) * (1 - torch.exp(-(time**4)))

    exact = shown(flux, 10.0, substeps=64)
    errors = [float((shown(flux, 10.0, substeps=s) - exact).abs().max()) for s in (4, 8)]
    assert errors[0] / errors[1] > 5  # 8 in the limit


def test_a_ramp_lags_behind_by_the_time_constant():
    late = torch.arange(30) * FRAME - FRAME * shown(lambda time: time, 10.0, n_frames=30)
    assert torch.allclose(late[10:], torch.tensor(10.0).double(), atol=1e-3)


@pytest.mark.parametrize("tau", [0.0, 1e-9])
def test_without_inertia_a_pixel_shows_the_flux_of_the_moment(tau):
    found = shown(torch.sin, tau)
    assert torch.allclose(found, torch.sin(torch.arange(9, dtype=torch.float64)), atol=2e-6)


@pytest.mark.parametrize("share", [0.0, 0.4, 1.0])
def test_what_the_camera_was_moving_before_is_what_the_first_frame_is_late(share):
    """A ramp: as late in the first frame as later where the camera was moving, and on time where it was not."""
    lag = Lag(100.0, substeps=5)  # a frame is ten milliseconds, and five time constants
    flux = instants(lag, 5)[:, None, None, None]
    found = lag(flux, tau=torch.full((1, 1, 1, 1), 2.0, dtype=torch.float64), moving=share * MOVING)
    late = torch.tensor([share * 0.2, 0.2, 0.2, 0.2, 0.2], dtype=torch.float64)
    assert torch.allclose(found.flatten(), torch.arange(5, dtype=torch.float64) - late, atol=0.01)


def test_rows_that_are_read_one_after_the_other_see_the_ramp_one_after_the_other():
    height, lag = 5, Lag(FPS, substeps=8, readout=0.5)
    x = instants(lag, 4)[:, None, None, None].expand(-1, 1, height, 2)
    found = lag(x, tau=torch.zeros(1, 1, height, 2, dtype=torch.float64), moving=REST)
    early = 0.5 * (1 - torch.arange(1, height + 1, dtype=torch.float64) / height)
    wanted = (torch.arange(4)[:, None] - early).clamp(min=0)
    assert torch.allclose(found, wanted[:, None, :, None].expand_as(found), atol=1e-5)


@pytest.mark.parametrize("options", [{}, {"readout": 0.7}])
def test_motion_lag_and_sensor_are_a_good_operator(options):
    lag = Lag(FPS, substeps=2, **options)
    chain = Chain({"warp": Warp((4, 5), (12, 13), (4, 4), lag.trajectory), "lag": lag, "sensor": Sensor()})
    x = torch.rand(1, 1, 12, 13, dtype=torch.float64)
    slots = {name: 0.5 + torch.rand(s, dtype=torch.float64) for name, s in chain.slots(x.shape, 3).items()}
    slots["lag.tau"] += 10
    slots["warp.motion"] = torch.eye(3, dtype=torch.float64).repeat(3, 1, 1)
    slots["warp.motion"][:, :2, 2] = torch.tensor([[0.1, 0.0], [0.8, 0.3], [1.1, -0.6]])
    assert chain.out_shape(x.shape, 3) == (3, 1, 4, 5)
    assert slots["warp.motion"].shape == (3, 3, 3)
    check_operator(chain, x, slots)


def test_a_sample_is_valid_if_its_pixel_has_seen_only_what_is_in_the_canvas():
    lag, mask = Lag(FPS, substeps=2), torch.ones(9, 1, 1, 1)
    mask[5] = 0
    assert lag.valid(mask, tau=torch.zeros(1, 1, 1, 1), moving=REST).flatten().tolist() == [1, 1, 0, 0]


def test_the_instants_are_those_that_the_lag_asks_for():
    assert Lag(FPS, substeps=6).trajectory == Trajectory(6, n_before=6)


def test_one_instant_a_frame_is_the_frames_own():
    motion = torch.rand(4, 3, 3)
    assert Trajectory().interpolate(motion) is motion


@pytest.mark.parametrize("path", [Trajectory(4), Trajectory(3, n_before=2)])
@pytest.mark.parametrize("n_frames", [1, 2, 3, 7])
def test_the_path_goes_through_the_frames(path, n_frames):
    motion = torch.rand(n_frames, 3, 3, dtype=torch.float64)
    instants = path.interpolate(motion)
    assert len(instants) == path.count(n_frames)
    assert path.frames(len(instants)) == n_frames
    assert torch.allclose(instants[path.n_before :: path.steps], motion, atol=1e-12)


def test_a_cubic_path_is_found_exactly_and_goes_on_before_the_first_frame():
    def place(time):
        return torch.stack((1 + time**3, 2 * time - time**2), -1)

    path = Trajectory(5, n_before=5)
    found = path.interpolate(place(torch.arange(6, dtype=torch.float64)))
    assert torch.allclose(found, place(torch.arange(-5, 26, dtype=torch.float64) / 5), atol=1e-10)
