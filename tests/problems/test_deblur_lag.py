"""Thermal lag: what is found, and what is said."""

import dataclasses

import numpy as np
import pytest
import torch
from small_problems import whole

import deepir
from deepir.assembly import build
from deepir.config import load
from deepir.errors import ConfigError
from deepir.metrics import scores
from deepir.problems.deblur_lag import speed_message, start_motion
from deepir.simulate import Settings, simulate
from deepir.simulate.scenes.procedural import procedural

CAMERA = Settings(
    n_frames=7, shape=(56, 72), motion="shift", max_shift=4.0, tau=10.0, counts=True, shading=0.0, dead_pixels=0.0
)
RUN = {"threads": 1, "physics": {"warp": {"motion": "shift"}}}
QUICK = RUN | {"solver": {"max_iterations": 2}}


@pytest.fixture(scope="module")
def sim():
    return simulate(procedural(4, (200, 240)), CAMERA, seed=3)


@pytest.fixture(scope="module")
def found(sim):
    return deepir.run("deblur_lag", "physics.warp.motion=shift", frames=sim.frames, threads=1)


def test_the_time_constant_is_found(found):
    assert found.extra["tau"].shape == CAMERA.shape
    assert found.extra["tau"].mean() == pytest.approx(10, rel=0.05)
    assert found.metrics["tau_ms"] == pytest.approx(found.extra["tau"].mean())
    assert not any("lag" in message for message in found.messages)


def test_the_scene_is_better_than_without_it(sim, found):
    ignored = deepir.run("nuc", "physics.warp.motion=shift", frames=sim.frames, threads=1)
    quality, rival = (scores(r.scene, sim.truth.scene)["psnr_aligned"] for r in (found, ignored))
    assert quality > rival + 3


def test_the_motion_is_where_the_camera_was_and_not_where_the_frames_tails_are(sim, found):
    assert np.abs(found.motion - sim.truth.motion)[:, :2, 2].max() < 0.1


def along(motion):
    """A problem of empty frames, whose camera moves so."""
    frames = np.zeros((len(motion), 24, 32), np.float32)
    return build(load("deblur_lag", ["physics.warp.motion=shift"]), whole(frames), motion)[0]


def test_the_start_takes_the_lag_out_of_the_registered_motion():
    """Frames that lag by the time constant of the configuration: the true motion comes out of the lagged one."""
    true = torch.eye(3, dtype=torch.float64).repeat(6, 1, 1)
    true[:, 0, 2] = torch.tensor([0.0, 1.0, 3.0, 4.0, 4.5, 3.0])
    problem = along(true)
    lag = problem.operator.stages["lag"]
    instants = lag.trajectory.interpolate(true)[:, :1, 2:]
    tau, moving = (torch.full((1, 1, 1, 1), value, dtype=torch.float64) for value in (10.0, 0.0))
    late = lag(instants[:, None], tau=tau, moving=moving)
    seen = true.clone()
    seen[:, 0, 2] = late.flatten()
    problem.fields["motion"].init_from(seen)
    start_motion(problem)
    assert torch.allclose(problem.fields["motion"]().double(), true, atol=1e-5)


@pytest.mark.usefixtures("few_trials")
def test_a_frame_that_fails_in_between_is_bridged(sim):
    frames = sim.frames.copy()
    frames[3] = np.random.default_rng(0).integers(7900, 9500, CAMERA.shape)
    result = deepir.run("deblur_lag", frames=frames, **QUICK)
    assert not result.frames_used[3]
    assert np.isfinite(result.motion).all()
    assert any(message.startswith("frame 3 is bridged") for message in result.messages)


def test_whether_the_camera_was_moving_before_is_found(sim, found):
    assert found.metrics["moving_before"] == 0
    moving = deepir.run("deblur_lag", frames=sim.frames[1:], **RUN)
    assert moving.metrics["moving_before"] == 1
    assert moving.extra["tau"].mean() == pytest.approx(10, rel=0.1)


def test_what_is_given_of_the_time_before_is_doubted_where_it_does_not_fit(sim):
    said = deepir.run("deblur_lag", "physics.lag.moving=0", frames=sim.frames[1:], **RUN).messages
    assert any("Try physics.lag.moving=1" in message for message in said)


@pytest.mark.parametrize(("far", "remedy"), [(8.0, "take physics.lag.substeps=9"), (40.0, "take problem 'nuc'")])
def test_a_camera_that_jumps_is_not_helped_by_sub_steps(far, remedy):
    motion = torch.eye(3, dtype=torch.float64).repeat(4, 1, 1)
    motion[1::2, 0, 2] = far
    (message,) = speed_message(along(motion))
    assert remedy in message


@pytest.mark.usefixtures("few_trials")
def test_time_constants_can_be_given_or_each_pixels_own_and_too_few_sub_steps_are_noticed(sim):
    known = deepir.run("deblur_lag", "physics.lag.tau=9.5", "physics.lag.substeps=1", frames=sim.frames, **QUICK)
    assert (known.extra["tau"] == 9.5).all()
    assert any("take physics.lag.substeps=" in message for message in known.messages)
    own = "physics.lag.tau={type: uniform+pixel, init: 10, pixel: {sigma: 1}}"
    assert deepir.run("deblur_lag", own, frames=sim.frames, **QUICK).extra["tau"].std() > 0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (["data.fps=null"], "physics.lag: the rate of the frames is needed, for example data.fps=60"),
        (["data.frames=[0, 2, 4]"], "needs frames that follow each other in time"),
        (["physics.lag.tau=-3"], "physics.lag.tau: a time constant, in ms, is not negative"),
        (["physics.lag.tau.init=0"], "starts above zero: physics.lag.tau.init=10"),
        (["physics.lag=null"], "'deblur_lag' needs a stage 'lag'"),
        (["physics.lag.moving=walking"], "physics.lag.moving"),
        (["physics.lag.substeps=0"], "substeps must be 1 to 100"),
    ],
)
def test_what_cannot_work_is_an_error(sim, changes, message):
    with pytest.raises(ConfigError, match=message):
        deepir.run("deblur_lag", *changes, frames=sim.frames)


def test_the_rates_of_camera_and_data_must_agree():
    settings = dataclasses.asdict(CAMERA) | {"fps": 30.0, "shape": list(CAMERA.shape)}
    with pytest.raises(ConfigError, match=r"data\.fps=60, but data\.simulate\.fps=30"):
        deepir.run("deblur_lag", data={"fps": 60, "simulate": settings}, **QUICK)
