"""A prior that takes more than noise is let go of; one that takes noise alone is not."""

import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter

import deepir
from deepir.estimation.prior_weight import (
    WEIGHT_REDUCTION,
    is_oversmoothed,
    reduce_weight,
    store_reference_misfit,
    weigh_scene,
)
from deepir.priors.penalties.foe import FoE
from deepir.priors.penalties.tv import TV
from deepir.simulate import Settings, simulate
from tests.estimation.test_spatial_weights import NOISE, problem_of


def smoothed(faint, penalty=FoE, **options):
    """Frames at rest with a texture of so many deviations of the noise, all explained until a prior made them flat."""
    rng = np.random.default_rng(0)
    noisy = 1 + NOISE * (faint * rng.normal(size=(48, 64)) + rng.normal(size=(48, 64)))
    problem, _ = problem_of(noisy.astype(np.float32))
    scene = problem.fields["scene"]
    problem.represent("scene", scene, {"prior": penalty(tuple(scene.shape), **options)})
    weigh_scene(problem)
    problem.reference_misfit.fill_(0.0)
    with torch.no_grad():
        scene.init_from(torch.ones_like(scene()))
    return problem


def test_noise_may_be_taken():
    assert not is_oversmoothed(smoothed(0.0))


def test_texture_may_not():
    assert is_oversmoothed(smoothed(0.7))


@pytest.mark.parametrize(("penalty", "options"), [(TV, {}), (FoE, {"weight": 20.0})])
def test_a_penalty_that_cannot_tell_or_is_given_its_weight_keeps_it(penalty, options):
    assert not is_oversmoothed(smoothed(0.7, penalty, **options))


def test_before_the_misfit_is_known_nothing_is_let_go():
    problem = smoothed(0.7)
    problem.reference_misfit.fill_(torch.inf)
    assert not is_oversmoothed(problem)


def test_what_is_let_go_of_has_less_weight():
    problem = smoothed(0.7)
    (penalty,) = problem.penalties["scene"].values()
    before = float(penalty.weight)
    reduce_weight(problem)
    assert float(penalty.weight) == pytest.approx(WEIGHT_REDUCTION * before)


def test_misfit_is_in_variances_of_the_noise():
    problem = smoothed(0.0)
    store_reference_misfit(problem)
    assert float(problem.reference_misfit) == pytest.approx(48 * 64, rel=0.1)


@pytest.mark.parametrize(("texture", "looser"), [(0.06, True), (0.02, False)])
def test_a_sky_of_galaxies_bears_its_prior_unless_it_is_textured(texture, looser):
    rng = np.random.default_rng(1)
    y, x = np.mgrid[:300, :360]
    sky = 0.1 + texture * gaussian_filter(rng.normal(size=y.shape), 1.5)
    for row, column, size in zip(*rng.uniform([[0], [0], [1]], [[300], [360], [5]], (3, 60)), strict=True):
        sky += 0.2 * np.exp(-np.hypot(y - row, x - column) / size)
    camera = Settings(shape=(96, 128), photons=1000.0, read_noise=0.002, shading=0.0, dead_pixels=0.0)
    burst = simulate(np.clip(sky, 0, 1), camera, seed=1)
    history = deepir.run("nuc", frames=burst.frames).history
    assert ("looser" in {row["stage"] for row in history}) is looser
