"""A prior competes on the scene alone: sensor and motion are those that total variation found."""

import functools

import numpy as np
import pytest
import torch
from small_problems import tiny

import deepir
from deepir.assembly import build
from deepir.config import load
from deepir.errors import ConfigError, DeepIRError
from deepir.optim.solve import solve
from deepir.pipeline.schedule import PriorRefinement, plan
from deepir.problems.recipe import Generic
from deepir.registry import lookup
from deepir.storage.stored import FileCheckpoint


@pytest.fixture(scope="module")
def run(burst):
    """Few iterations of a prior; each is solved once."""

    @functools.cache
    def run(prior, *more):
        short = ("threads=1", "solver.max_iterations=12", *more)
        return deepir.run("nuc", f"prior={prior}", *short, frames=burst.frames)

    return run


@pytest.mark.parametrize("prior", ["red", "grid", "siren"])
def test_the_sensor_is_what_total_variation_found(run, prior):
    found, reference = run(prior), run("tv")
    shared = reference.gain  # to the few held-out samples, which differ in the last stage only
    assert np.allclose(found.gain, shared, atol=1e-5)
    assert np.allclose(found.motion, reference.motion, atol=1e-6)
    assert np.abs(found.scene - reference.scene).max() > 1e-3


def test_a_residual_starts_at_the_result_of_total_variation(run):
    # At a step of almost nothing, the network stays at zero, and the scene at what it is added to.
    still = run("siren", "scene.fit.lr=1e-12")
    moved = run("siren")
    assert np.abs(still.scene - moved.scene).max() > 1e-3
    tv = run("siren", "scene.fit.lr=1e-12", "scene.fit.iterations=0")
    assert np.allclose(still.scene, tv.scene, rtol=1e-5)


def test_samples_that_stop_a_prior_are_seen_by_no_stage_before(small_nuc):
    problem, config = small_nuc(), load("nuc", ["prior=grid"])
    stages = PriorRefinement(problem, config).after(Generic().plan(problem))
    assert not any(stage.use_held_out for stage in stages)


def test_rounds_denoise_again(run):
    one, three = (run("red", f"scene.fit.rounds={n}") for n in (1, 3))
    stages = [stage for stage in dict.fromkeys(row["stage"] for row in three.history) if "prior" in stage]
    assert stages == ["prior 1", "prior 2", "prior 3"]
    assert np.abs(one.scene - three.scene).max() > 1e-3


@pytest.mark.parametrize("prior", ["dip", "tgv", "red"])
def test_a_solve_that_is_interrupted_in_the_priors_stage_ends_the_same(tmp_path, prior):
    config = load("nuc", [f"prior={prior}", "solver.max_iterations=12"])

    def once(callbacks=(), checkpoint=None):
        torch.manual_seed(0)
        problem, _ = build(config, *tiny())
        definition = lookup("problem", "nuc")()
        definition.initialise(problem, seed=0)
        stages = plan(problem, definition, config)
        return solve(problem, stages, callbacks=callbacks, checkpoint=checkpoint).values["scene"]

    def interrupt(progress):
        if progress.stage.startswith("prior") and progress.iteration == 5:
            raise DeepIRError("enough")

    whole = once()
    with pytest.raises(DeepIRError):
        once([interrupt], FileCheckpoint(tmp_path / "state.safetensors"))
    assert torch.equal(once(checkpoint=FileCheckpoint(tmp_path / "state.safetensors")), whole)


@pytest.mark.parametrize("prior", ["red", "tgv", "grid"])
def test_any_problem_with_a_scene_takes_a_prior(prior):
    # One blurred frame of an unknown scene: no burst, no sensor.
    frame = np.zeros((1, 24, 28), np.float32)
    frame[:, 8:16, 10:20] = 100.0
    config = {
        "physics": {"blur": {"radius": 2, "psf": {"type": "gaussian", "fixed": True}}},
        "noise": {"read": 1.0},
        "prior": prior,
        "solver": {"max_iterations": 40},
    }
    scene = deepir.run(config, frames=frame + np.random.default_rng(0).normal(0, 1, frame.shape)).scene
    inside, outside = scene[10:14, 13:17].mean(), scene[:4].mean()
    assert inside - outside > 60


def test_a_plan_of_ones_own_is_followed_by_the_priors_stage(run):
    plan = "solver.plan=[{name: mine, iterations: 3, steps: [{group: [scene], method: lbfgs}]}]"
    assert [row["stage"] for row in run("tgv", plan).history[:4]] == ["mine"] * 3 + ["prior"]


def test_a_rate_is_of_an_unknown_in_the_group(run):
    plan = "solver.plan=[{name: mine, steps: [{group: [scene], method: adam, rates: {motoin: 0.1}}]}]"
    with pytest.raises(ConfigError, match=r"stage 'mine': rates: no 'motoin' in the group; allowed: scene"):
        run("tv", plan)
