"""Noise by what a fit leaves: right for mixtures, whatever a few samples do, and by the light alone."""

import numpy as np
import pytest
import torch

from deepir.arrays.samples import MAD_TO_SIGMA
from deepir.effects.noise import HUBER_CONSISTENCY, HUBER_K, estimate_noise, huber_scale


def gaussian(count, sigma=1.0, seed=0):
    return sigma * torch.randn(count, generator=torch.Generator().manual_seed(seed))


def test_the_bound_is_right_for_a_gaussian():
    from scipy.integrate import quad
    from scipy.stats import norm

    assert pytest.approx(quad(lambda x: min(x * x, HUBER_K**2) * norm.pdf(x), -9, 9)[0], rel=1e-5) == HUBER_CONSISTENCY
    assert huber_scale(gaussian(100_000, 3.0).abs()) == pytest.approx(3.0, rel=0.01)


def test_a_mixture_is_read_more_rightly_than_by_the_median():
    # As where the samples of a bin have other variances, and other leverages.
    each = torch.cat([gaussian(50_000, 0.6), gaussian(50_000, 1.4, seed=1)])
    right = float(each.square().mean().sqrt())
    assert abs(huber_scale(each.abs()) - right) < 0.5 * abs(MAD_TO_SIGMA * float(each.abs().median()) - right)


def test_a_few_wild_ones_hardly_count():
    each = gaussian(10_000)
    each[:200] = 1e3
    assert huber_scale(each.abs()) == pytest.approx(1, rel=0.1)


@pytest.mark.parametrize("offset", [0.0, 40.0])
def test_photon_noise_belongs_to_the_light_whatever_the_offset(small_nuc, offset):
    problem = small_nuc(size=(90, 100), pedestal=60.0)
    generator, values = (
        torch.Generator().manual_seed(1),
        {name: value.detach() for name, value in problem.values().items()},
    )
    light = problem.predict(values) - values["offset"]
    shift = offset * torch.randn(light.shape[-2:], generator=generator, dtype=light.dtype)
    noise = (0.04 + light / 20).sqrt() * torch.randn(light.shape, generator=generator, dtype=light.dtype)
    problem.data.copy_(light + shift + noise)
    problem.held_out[..., ::7] = True
    found = estimate_noise(problem, light + shift, light)
    read, photon = found.read, found.per_unit
    seen = read + photon * light.numpy()
    assert np.median(seen / (0.04 + light.numpy() / 20)) == pytest.approx(1, rel=0.05)
    assert photon == pytest.approx(1 / 20, rel=0.2)
