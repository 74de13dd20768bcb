"""Prediction against data."""

import math

import pytest
import torch
from scipy import stats

from deepir.likelihoods import Poisson
from deepir.registry import components

FIDELITIES = components("fidelity")
each_fidelity = pytest.mark.parametrize("name", FIDELITIES)


def samples(shape=(2, 1, 4, 5)):
    data = 5 + 3 * torch.rand(shape, dtype=torch.float64)
    return data + torch.randn(shape, dtype=torch.float64), data, 0.5 + torch.rand(shape, dtype=torch.float64)


@each_fidelity
def test_it_is_least_and_zero_where_the_prediction_is_the_data(name):
    prediction, data, precision = samples()
    fidelity = FIDELITIES[name]()
    assert float(fidelity(data, data, precision)) == pytest.approx(0, abs=1e-9)
    for step in (1e-3, 0.1, 1.0, 4.0):
        assert fidelity(data + step, data, precision) > 0
        assert fidelity(data - step, data, precision) > 0
    assert fidelity(prediction, data, precision) > 0


@each_fidelity
def test_the_gradient_is_right_and_in_float32_finite(name):
    prediction, data, precision = samples()
    fidelity = FIDELITIES[name]()
    assert torch.autograd.gradcheck(lambda p: fidelity(p, data, precision), prediction.requires_grad_())
    prediction = prediction.detach().float().requires_grad_()
    value = fidelity(prediction, data.float(), precision.float())
    assert value.dtype == torch.float64  # line searches compare sums of millions of terms
    (slope,) = torch.autograd.grad(value, prediction)
    assert slope.isfinite().all()


@each_fidelity
def test_a_sample_of_no_precision_does_not_count_whatever_it_holds(name):
    prediction, data, precision = samples()
    prediction.requires_grad_()
    precision[0, 0, 1, 2] = 0
    values = []
    for junk in (0.0, 7.0, -1e6, 1e6):
        data[0, 0, 1, 2] = junk
        value = FIDELITIES[name]()(prediction, data, precision)
        (slope,) = torch.autograd.grad(value, prediction)
        assert slope[0, 0, 1, 2] == 0
        assert slope.isfinite().all()
        values.append(float(value.detach()))
    assert values == pytest.approx([values[0]] * 4)


@each_fidelity
def test_noise_of_the_given_variance_costs_about_what_it_should(name):
    # Half a nat a sample for a Gaussian; a Laplacian costs sqrt(2) for each mean absolute residual.
    expected = {"gaussian": 0.5, "l1": math.sqrt(4 / math.pi), "huber": 0.5, "poisson": 0.5}
    truth = 100 + 50 * torch.rand(1, 1, 200, 200)
    data = torch.poisson(10 * truth) / 10 if name == "poisson" else truth + 3 * torch.randn_like(truth)
    precision = 10 / data if name == "poisson" else torch.full_like(truth, 1 / 9)
    if name in expected:
        cost = float(FIDELITIES[name]()(truth, data, precision)) / truth.numel()
        assert cost == pytest.approx(expected[name], rel=0.15 if name == "huber" else 0.02)


@pytest.mark.parametrize(("name", "density", "per_sigma"), [("gaussian", stats.norm, 1), ("l1", stats.laplace, 2**0.5)])
def test_gaussian_and_laplacian_are_scipys(name, density, per_sigma):
    prediction, data, precision = samples()
    log = density(loc=prediction, scale=precision.rsqrt() / per_sigma).logpdf
    found = float(FIDELITIES[name]()(prediction, data, precision))
    assert found == pytest.approx((log(prediction) - log(data)).sum())


def test_huber_is_gaussian_within_its_threshold_and_grows_like_l1_beyond():
    data, precision = torch.zeros(1, 1, 1, 1), torch.full((1, 1, 1, 1), 1 / 4)
    huber = FIDELITIES["huber"](threshold=2.0)
    at = [float(huber(torch.full_like(data, r), data, precision)) for r in (1.0, 4.0, 10.0, 12.0)]
    assert at == pytest.approx([1 / 8, 2.0, 2 * 5 - 2, 2 * 6 - 2])
    with pytest.raises(ValueError, match="threshold"):
        FIDELITIES["huber"](threshold=0.0)


@pytest.mark.parametrize("photons", [1.0, 0.05, 40.0])
def test_poisson_differences_are_those_of_scipys_log_likelihood(photons):
    counts = torch.poisson(torch.full((1, 1, 6, 7), 9.0, dtype=torch.float64))
    counts[0, 0, 0, :2] = 0
    data = counts / photons
    precision = torch.where(counts > 0, photons / data, torch.ones_like(data))  # variance y / photons
    poisson = FIDELITIES["poisson"]()
    one, other = (3 + 9 * torch.rand_like(data)) / photons, (3 + 9 * torch.rand_like(data)) / photons
    found = poisson(one, data, precision) - poisson(other, data, precision)
    log = stats.poisson.logpmf
    wanted = log(counts, photons * other).sum() - log(counts, photons * one).sum()
    assert float(found) == pytest.approx(wanted)


def test_poisson_is_finite_and_convex_below_zero():
    data = torch.tensor([0.0, 1.0, 5.0]).reshape(1, 1, 1, 3).double()
    precision = torch.tensor([1.0, 1.0, 0.2]).reshape(1, 1, 1, 3).double()
    line = torch.linspace(-2, 3, 400, dtype=torch.float64)
    costs = torch.stack([FIDELITIES["poisson"]()(p.expand_as(data), data, precision) for p in line])
    assert costs.isfinite().all()
    assert (costs.diff().diff() > -1e-9).all()
    assert costs[0] > costs[200]


def test_what_is_negative_has_no_photons():
    about_zero = torch.tensor([-0.1, 0.2, 0.1, 0.4] * 10 + [3.0] * 80)
    Poisson().check_data(about_zero, about_zero.isfinite())
    below = torch.tensor([-3.0, -1.0, -2.0, 1.0])
    with pytest.raises(ValueError, match="75% of the data are negative"):
        Poisson().check_data(below, below.isfinite())
    Poisson().check_data(below, below > 0)
