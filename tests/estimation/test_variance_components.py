"""Strengths by their marginal likelihood, against strengths that are known."""

import pytest
import torch
from torch.autograd.functional import hessian, jacobian

from deepir.effects.sensor_pattern import high_order
from deepir.estimation.variance_components import estimate_sigmas
from deepir.kernels.compile import parallel_for
from deepir.kernels.normal_equations import negative_log_likelihood

COUNT = 4000


def burst(sigma, noise=1.0, seed=0):
    """Information (3, K) and posterior means (2, K) of values of strengths `sigma`, the means at strengths of one."""
    generator = torch.Generator().manual_seed(seed)
    root = torch.randn(COUNT, 2, 2, dtype=torch.float64, generator=generator) / noise
    system = root @ root.mT
    values = torch.tensor(sigma, dtype=torch.float64) * torch.randn(COUNT, 2, dtype=torch.float64, generator=generator)
    chance = torch.randn(COUNT, 2, dtype=torch.float64, generator=generator)
    seen = (system @ values[..., None] + root @ chance[..., None])[..., 0]
    means = torch.linalg.solve(system + torch.eye(2), seen)
    return torch.stack((system[:, 0, 0], system[:, 0, 1], system[:, 1, 1])), means.T


ONE, MUCH = torch.ones(2, dtype=torch.float64), torch.full((2,), 9.0, dtype=torch.float64)


@pytest.mark.parametrize("sigma", [(0.3, 2.0), (3.0, 0.5), (1.0, 0.0)])
def test_strengths_are_found(sigma):
    found = estimate_sigmas(*burst(sigma, noise=0.3), ONE, MUCH, [0, 1])
    assert found.tolist() == pytest.approx(sigma, rel=0.15, abs=0.045)  # a weak prior of gains is in it


def test_what_is_given_and_what_is_not_there_stay():
    information, means = burst((0.3, 2.0), noise=0.3)
    assert estimate_sigmas(information, means, ONE, MUCH, [1])[0] == 1
    none = torch.tensor([0.0, 1.0], dtype=torch.float64)
    assert estimate_sigmas(information, torch.stack((0 * means[0], means[1])), none, MUCH, [0, 1])[0] == 0


def test_a_few_outliers_change_little():
    information, means = burst((0.3, 2.0), noise=0.3)
    spoilt = means.clone()
    spoilt[:, ::100] *= 300
    sound, found = (estimate_sigmas(information, each, ONE, MUCH, [0, 1]) for each in (means, spoilt))
    assert found.tolist() == pytest.approx(sound.tolist(), rel=0.1)


def test_it_stays_below_its_bound():
    assert estimate_sigmas(*burst((0.3, 2.0)), ONE, torch.tensor([9.0, 1.5]).double(), [0, 1])[1] <= 1.5 + 1e-9


def test_slope_and_curvature_are_those_of_the_likelihood():
    information, means = burst((0.3, 2.0))
    (aa, ab, bb), (x, y) = information[:, :37], means[:, :37]
    system = torch.stack((aa, ab, ab, bb), 1).unflatten(1, (2, 2))
    score = torch.stack((aa * x + ab * y + x, ab * x + bb * y + y), 1)
    counts = torch.arange(37) % 5 > 0

    def exact(variance):
        whole = torch.eye(2) + system * variance
        width, shown = torch.logdet(whole), torch.linalg.solve(whole, score)
        return (width - (score * variance * shown).sum(1))[counts].sum()

    at, sums = torch.tensor([0.2, 3.0], dtype=torch.float64), torch.empty(6, dtype=torch.float64)
    parallel_for(negative_log_likelihood, 1, torch.stack((aa, ab, bb, *score.T)), counts, *at.tolist(), sums)
    (uu, uv), (_, vv) = hessian(exact, at)
    wanted = torch.stack((exact(at), *jacobian(exact, at), uu, uv, vv))
    assert sums.tolist() == pytest.approx(wanted.tolist(), rel=1e-9)


@pytest.mark.parametrize("count", [16, 40, 160])
def test_a_slope_of_the_scene_is_no_strength_of_its_rows(count):
    generator = torch.Generator().manual_seed(count)
    white = 0.01 * torch.randn(2, count, dtype=torch.float64, generator=generator)
    slope = 0.3 * torch.linspace(-1, 1, count, dtype=torch.float64)
    left = high_order(white + slope)
    assert torch.allclose(left, high_order(white), atol=1e-12)
    assert float(left.std()) == pytest.approx(float(white.std()), rel=0.2)
