"""The scene's prior is stronger where the scene is plain, and where samples are less sure, than where it is rich.

One that takes more than noise is let go of; one that takes noise alone is not.
"""

import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter
from small_problems import whole

import deepir
from deepir.assembly import build
from deepir.config import load
from deepir.estimation.prior_weight import (
    WEIGHT_REDUCTION,
    adapt_weight_map,
    is_oversmoothed,
    reduce_weight,
    store_reference_misfit,
    weigh_scene,
)
from deepir.priors.penalties.foe import FoE
from deepir.priors.penalties.tv import TV
from deepir.simulate import Settings, simulate

NOISE = 0.01


def problem_of(scene, *settings):
    """Five frames that do not move, of which the scene is known to `NOISE`."""
    found, _ = build(load("nuc", settings), whole(np.stack([scene] * 5)), torch.eye(3).repeat(5, 1, 1))
    found.precision.fill_(1 / (5 * NOISE**2))
    margin = [(each - side) // 2 for each, side in zip(found.fields["scene"].shape[-2:], scene.shape, strict=True)]
    with torch.no_grad():
        found.fields["scene"].init_from(torch.from_numpy(np.pad(scene, [(m, m) for m in margin], "edge"))[None, None])
    weigh_scene(found)
    return found, tuple(slice(m, m + side) for m, side in zip(margin, scene.shape, strict=True))


def weights(scene, *settings, dark=None):
    problem, inside = problem_of(scene.astype(np.float32), *settings)
    if dark is not None:
        problem.precision[..., dark] *= 0.5
    adapt_weight_map(problem)
    (penalty,) = problem.penalties["scene"].values()
    return (penalty.weight * penalty.weight_map[inside]).numpy()


@pytest.mark.parametrize("prior", ["tv", "huber_tv"])
def test_half_a_frame_of_texture_is_smoothed_less_than_the_plain_half(prior):
    rng = np.random.default_rng(0)
    scene = 1 + NOISE * rng.normal(size=(48, 64))
    scene[:, 32:] += 20 * NOISE * rng.normal(size=(48, 32))
    weight = weights(scene, f"scene.penalties={{{prior}: auto}}")
    assert weight[8:-8, 8:24].min() > 2 * weight[8:-8, 40:56].max()


def test_a_lone_edge_is_less_of_a_texture_than_many():
    rng = np.random.default_rng(0)
    scene = 1 + NOISE * rng.normal(size=(48, 64))
    lone, many = scene.copy(), scene.copy()
    lone[:, 32:] += 20 * NOISE
    many[:, ::4] += 20 * NOISE
    assert np.median(weights(lone)[8:-8, 32]) > 1.3 * np.median(weights(many)[8:-8, 32])


def test_samples_half_as_sure_are_held_less():
    """A nat is for a step in standard deviations, which is 1.4 times as large."""
    rng = np.random.default_rng(0)
    scene = 1 + 20 * NOISE * rng.normal(size=(48, 64))
    weight = weights(scene, dark=slice(48, None))
    assert np.median(weight[8:-8, 52:60]) / np.median(weight[8:-8, 8:40]) == pytest.approx(0.5**0.5, rel=0.1)


def test_a_weight_that_is_given_is_the_same_everywhere():
    scene = np.linspace(0, 1, 48)[:, None] * np.ones(64)
    assert (weights(scene, "prior=tv", "scene.penalties.tv=3.0") == 3).all()


def test_a_penalty_of_no_shape_is_the_same_everywhere():
    value = torch.rand(1, 1, 9, 12, dtype=torch.float64)
    assert torch.equal(TV(weight=2.0)(value), TV((1, 1, 9, 12), weight=2.0)(value))


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


@pytest.mark.parametrize(
    ("faint", "penalty", "options", "reduced"),
    [(0.0, FoE, {}, False), (0.7, FoE, {}, True), (0.7, TV, {}, False), (0.7, FoE, {"weight": 20.0}, False)],
    ids=["noise may be taken", "texture may not", "a penalty that cannot tell", "a weight that is given"],
)
def test_a_prior_that_has_taken_texture_has_less_weight(faint, penalty, options, reduced):
    problem = smoothed(faint, penalty, **options)
    assert is_oversmoothed(problem) is reduced
    (penalty,) = problem.penalties["scene"].values()
    before = float(penalty.weight)
    reduce_weight(problem)
    assert float(penalty.weight) == pytest.approx((WEIGHT_REDUCTION if reduced else 1) * before)
    problem.reference_misfit.fill_(torch.inf)  # as long as it is not known
    assert not is_oversmoothed(problem)


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
