"""Fields of experts: their energy against scipy, what they tell apart, and how their training sees its minimum."""

import copy
import importlib

import numpy as np
import pytest
import torch
from scipy.ndimage import correlate

from deepir.priors.penalties.foe import Experts, FoE, foe_energy
from deepir.priors.penalties.tv import TV
from deepir.simulate.scenes.procedural import procedural
from deepir.training import foe
from deepir.training.foe import FOE_PHOTOGRAPHS, FieldsOfExperts


def picture(shape=(20, 24)):
    return torch.randn(1, 1, *shape, dtype=torch.float64, generator=torch.Generator().manual_seed(0))


def varied(shape, **options):
    penalty = FoE((1, 1, *shape), **options)
    penalty.weight_map.copy_(torch.rand(shape, generator=torch.Generator().manual_seed(1)) + 0.2)
    return penalty


def reference(x, penalty):
    """By scipy's correlation, where a filter lies within the picture."""
    weight, total = float(penalty.weight), 0.0
    e, inside = penalty.rounding / weight, (slice(2, -2), slice(2, -2))
    for kernel, cost, tail in zip(penalty.filters, penalty.costs, penalty.tails, strict=True):
        length = np.hypot(correlate(x, kernel.double().numpy())[inside], e) - e
        t = float(tail) / weight
        total += (penalty.weight_map.numpy()[inside] * float(cost) * 2 * t * (np.sqrt(1 + length / t) - 1)).sum()
    return total


@pytest.mark.parametrize("weight", [0.3, 2.0])
def test_the_energy_is_the_references(weight):
    penalty = varied((20, 24), weight=weight)
    assert float(penalty.energy(picture())) == pytest.approx(reference(picture()[0, 0].numpy(), penalty), rel=1e-6)


@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("shape", [(5, 5), (6, 9), (41, 30)])
def test_the_loop_is_what_torch_computes(threads, shape):
    before, penalty, x = torch.get_num_threads(), varied(shape, weight=0.7), picture(shape).requires_grad_()
    torch.set_num_threads(threads)
    found = penalty.energy(x)
    (slope,) = torch.autograd.grad(found, x)
    torch.set_num_threads(before)
    tails = penalty.tails / penalty.weight
    wanted = foe_energy(x, penalty.weight_map, penalty.filters, penalty.costs, tails, penalty.epsilon)
    assert torch.allclose(found, wanted, rtol=1e-6)
    assert torch.allclose(slope, torch.autograd.grad(wanted, x)[0], rtol=1e-5, atol=1e-7)


def test_what_is_too_small_for_a_filter_costs_nothing():
    x = picture((4, 9)).requires_grad_()
    energy = FoE().energy(x)
    assert float(energy.detach()) == 0
    assert not torch.autograd.grad(energy, x)[0].any()


def test_a_level_is_not_seen_nor_a_sign_and_filters_have_no_mean_though_they_are_kept_in_half_precision():
    penalty = FoE(weight=0.5)
    assert float(penalty(picture() + 1e3)) == pytest.approx(float(penalty(picture())), rel=1e-5)
    assert float(penalty(-picture())) == pytest.approx(float(penalty(picture())), rel=1e-9)
    assert float(penalty.filters.sum((1, 2)).abs().max()) < 1e-5
    assert np.allclose(penalty.filters.square().sum((1, 2)), 2, rtol=1e-5)


@pytest.mark.parametrize("noise", [0.01, 0.03])
def test_white_noise_on_a_picture_is_taken_off_better_than_by_total_variation(noise):
    truth = torch.from_numpy(procedural(1, (160, 200))[40:120, 40:120]).float()[None, None]
    shown = truth + noise * torch.randn(truth.shape, generator=torch.Generator().manual_seed(2))

    def error(kind):
        # Of white noise, not of a spline's coefficients: at the best of five weights each.
        return min(
            float((denoised(kind(weight=w / noise)) - truth).square().mean()) for w in (0.2, 0.3, 0.45, 0.7, 1.0)
        )

    def denoised(penalty):
        x = shown.clone().requires_grad_()
        steps = torch.optim.LBFGS([x], max_iter=60, line_search_fn="strong_wolfe")

        def closure():
            value = (x - shown).square().sum() / 2 / noise**2 + penalty(x)
            (x.grad,) = torch.autograd.grad(value, x)
            return value

        steps.step(closure)
        return x.detach()

    assert error(FoE) < 0.96 * error(TV)


def test_its_stiffness_is_that_of_its_second_derivatives():
    penalty, x = FoE(weight=0.5), picture((24, 24)).float().double()
    wave = torch.cos(1.3 * torch.arange(24, dtype=torch.float64))[:, None] * torch.ones(24, dtype=torch.float64)
    wave = wave[None, None]
    _, stiffness = penalty.mean_curvature(x)
    steep = stiffness * float(wave.diff(dim=-2).square().sum())
    step = 1e-3
    bent = float(penalty(x + step * wave) - 2 * penalty(x) + penalty(x - step * wave)) / step**2
    assert 0.05 * steep < bent < steep  # of squares that touch it from above, which bend more


def slopes(seed):
    """The slope of the loss, by differences and by its gradient: how near depends on threads and processor."""
    torch.manual_seed(0)
    network, training = Experts(), FieldsOfExperts(np.random.default_rng(seed))
    same = (copy.deepcopy(training.rng.bit_generator.state), training.noise.get_state())

    def loss():
        training.rng.bit_generator.state, _ = copy.deepcopy(same[0]), training.noise.set_state(same[1])
        return training.loss(network)

    (slope,) = torch.autograd.grad(loss(), network.costs)
    network.costs.data += 0.05
    above = float(loss().detach())
    network.costs.data -= 0.1
    return (above - float(loss().detach())) / 0.1, float(slope.sum())


def test_training_goes_down_the_slope_of_its_minimum(monkeypatch):
    monkeypatch.setattr(foe, "LBFGS_ITERATIONS", 150)  # as near to the minimum as the slope is asked for
    monkeypatch.setattr(foe, "BURSTS_PER_ITERATION", 3)
    differences, gradients = np.transpose([slopes(seed) for seed in (10, 11, 12)])
    assert np.median(np.abs(differences / gradients - 1)) < 0.1


def test_nothing_is_learnt_from_pictures_that_bursts_are_judged_by(benchmarks):
    regimes = importlib.import_module("nuc_regimes").REGIMES
    assert not set(FOE_PHOTOGRAPHS) & {picture for each in regimes.values() for picture in each.pictures}
