"""Every prior on every problem: two steps each (`pytest -m matrix`)."""

import functools

import numpy as np
import pytest

import deepir
from deepir.config import prior_names
from deepir.registry import components
from deepir.simulate import Settings, simulate
from deepir.simulate.scenes.procedural import procedural

CAMERA = Settings(n_frames=4, shape=(40, 48), max_shift=4.0, shading=0.0, dead_pixels=0.0)
PROBLEMS = sorted(components("problem").keys() - {"generic"})
#: Of each kind one, a penalty, learned filters, denoisers and networks: on `nuc` they belong to the quick tests.
KINDS = ("tv", "foe", "red", "pnp", "dip", "siren", "grid", "deep_decoder")
CASES = [
    pytest.param(problem, prior, marks=() if problem == "nuc" and prior in KINDS else pytest.mark.matrix)
    for problem in PROBLEMS
    for prior in prior_names()
]


@functools.cache
def frames(shared):
    """A burst of one scene, or a frame each of several, with one pattern."""
    bursts = [simulate(procedural(seed, (110, 130)), CAMERA, seed=1).frames for seed in range(1, 2 if shared else 5)]
    return bursts[0] if shared else np.stack([burst[0] for burst in bursts])


@pytest.mark.usefixtures("few_trials")
@pytest.mark.parametrize(("problem", "prior"), CASES)
def test_a_prior_runs_on_a_problem(problem, prior):
    shared = problem != "multiview_nuc"
    result = deepir.run(problem, f"prior={prior}", "solver.max_iterations=2", frames=frames(shared))
    assert np.isfinite(result.scene).all()
    assert np.std(result.scene) > 0
