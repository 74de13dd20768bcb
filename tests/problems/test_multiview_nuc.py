"""Frames of different scenes: the pattern that they share, without registration."""

import numpy as np
import pytest

import deepir
from deepir.config import priors

QUICK = {"threads": 1, "solver": {"max_iterations": 2}}


@pytest.mark.parametrize("prior", priors())
def test_every_prior_takes_two_steps(prior):
    frames = np.random.default_rng(0).random((3, 24, 32)).cumsum(1).cumsum(2)
    result = deepir.run("multiview_nuc", frames=frames, prior=prior, **QUICK)
    assert result.scene.shape == (3, 24, 32)
    assert np.isfinite(result.scene).all()
    assert np.abs(result.scene[0] - result.scene[1]).max() > 0
