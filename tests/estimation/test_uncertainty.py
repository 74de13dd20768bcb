"""How sure a result is: of the size of its error, and larger where less is known."""

import functools
import math

import numpy as np
import pytest
import torch

import deepir
from deepir.fields.base import Pixels
from deepir.fields.constant import Constant
from deepir.fields.sensor_maps import Pixel
from deepir.operators import Sensor
from deepir.pipeline.collect import posterior_samples
from deepir.problem import Problem
from deepir.schedule import Stage, Step
from tests.effects import solved as bursts

solved = functools.partial(bursts.solved, seed=2, shape=(64, 80))


@pytest.mark.parametrize("n_frames", [3, 8])
def test_errors_of_the_scene_are_of_the_size_that_it_says(n_frames):
    result, sim = solved(n_frames=n_frames)
    error = result.scene - sim.truth.scene
    error -= np.median(error)
    ratio = 1.4826 * np.median(np.abs(error / result.uncertainty["scene"]))
    assert 0.5 < ratio < 2


def test_what_fewer_frames_show_is_less_sure():
    result, _ = solved(max_shift=20.0)
    sigma = result.uncertainty["scene"]
    assert sigma[0].mean() > 1.2 * sigma[32].mean()


def test_more_frames_make_the_pattern_cheaper_and_motion_along_one_axis_dearer():
    few, many, along_x = (
        solved(**each)[0].metrics["pattern_cost_db"] for each in ({"n_frames": 3}, {"n_frames": 8}, {"jitter": "x"})
    )
    assert few > 10 * math.log10(3 / 2)
    assert many < few
    assert along_x > few


def test_maps_have_the_shape_of_what_they_are_about():
    result, _ = solved(n_frames=3)
    for name in ("scene", "gain", "offset"):
        assert result.uncertainty[name].shape == getattr(result, name).shape
        assert (result.uncertainty[name] > 0).all()


@pytest.fixture
def problem():
    """Three frames of noise one of a scene, with an offset that has a Gaussian prior."""
    fields = {"scene": Constant((3, 1, 12, 16), 5.0), "offset": Pixel((1, 1, 12, 16), sigma=0.7)}
    data = 5 + torch.randn(3, 1, 12, 16, generator=torch.Generator().manual_seed(0))
    return Problem(Sensor(), fields, data, slots={"sensor.offset": "offset"})


def test_samples_of_a_gaussian_posterior_are_exact(problem):
    end = Stage("end", (Step(("offset",), "eliminate"),))
    drawn = np.stack([each.values["offset"].numpy() for each in posterior_samples(problem, end, 200, seed=1)])
    variance = 1 / (3 + 0.7**-2)
    assert drawn.var(0).mean() == pytest.approx(variance, rel=0.03)
    assert np.abs(drawn.mean(0) - variance * (problem.data - 5).sum(0).numpy()).mean() < 1.5 * np.sqrt(variance / 200)


def test_the_problem_is_left_as_it_was(problem):
    problem.fields["scene"] = Pixels((1, 1, 12, 16)).starting_at(torch.tensor(5.0))
    before = {name: each.clone() for name, each in problem.state_dict().items()}
    list(posterior_samples(problem, Stage("end", (Step(("scene",)),), 5), 2, seed=1))
    assert all(torch.equal(each, before[name]) for name, each in problem.state_dict().items())


@pytest.mark.parametrize("prior", ["tv", "foe"])
def test_standardised_errors_of_the_scene_have_the_size_of_one(prior):
    sim = bursts.burst(psf_sigma=1.0)
    result = deepir.run("nuc", f"prior={prior}", "uncertainty.samples=12", frames=sim.frames, threads=1)
    error = result.scene - sim.truth.scene
    error -= np.median(error)
    deviation = result.uncertainty["scene"]
    assert 0.85 < np.sqrt(np.mean(error**2) / np.mean(deviation**2)) < 1.2
    assert {"gain", "offset", "motion", "level"} <= result.uncertainty.keys()


@pytest.mark.parametrize(
    "settings",
    [("sr", "physics.downsample.factor=2"), ("nuc", "prior=siren", "scene.fit.iterations=20"), ("deconv",)],
    ids=["sr", "network", "deconv"],
)
def test_any_problem_and_prior_has_them(settings, tmp_path):
    frames = bursts.burst(shape=(64, 80), n_frames=1 if settings[0] == "deconv" else 4).frames
    frames = frames[0] if settings[0] == "deconv" else frames
    short = ("solver.max_iterations=5", "uncertainty.samples=2", f"output.dir={tmp_path}/run")
    result = deepir.run(*settings, *short, frames=frames)
    assert result.uncertainty["scene"].shape == result.scene.shape
    assert (result.uncertainty["scene"] > 0).mean() > 0.9


def test_one_sample_is_refused():
    with pytest.raises(deepir.DeepIRError, match=r"uncertainty\.samples"):
        deepir.run("nuc", "uncertainty.samples=1", frames=bursts.burst().frames)
