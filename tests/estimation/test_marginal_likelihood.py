"""Evidence of variances, against the density of a Gaussian written out."""

import numpy as np
import pytest
import torch
from scipy.stats import multivariate_normal

from deepir.estimation.low_order_evidence import MarginalLikelihood, normal_matrix

FREE = 2


def burst(seed, frames=3, pixels=7, unknowns=5):
    """Columns, precisions, and what the pixels' own unknowns make of the samples."""
    rng = np.random.default_rng(seed)
    columns = rng.standard_normal((frames, unknowns, pixels))
    precision = rng.uniform(0.5, 2.0, (frames, pixels))
    own = rng.standard_normal((frames, 2, pixels))
    return columns, precision, own


def covariance(precision, own):
    """Of all samples: their noise, and what each pixel has of its own."""
    frames, pixels = precision.shape
    found = np.zeros((frames, pixels, frames, pixels))
    for p in range(pixels):
        found[:, p, :, p] = np.diag(1 / precision[:, p]) + own[:, :, p] @ own[:, :, p].T
    return found.reshape(frames * pixels, -1)


@pytest.mark.parametrize("seed", range(3))
def test_what_pixels_have_of_their_own_is_noise_that_their_frames_share(seed):
    columns, precision, own = burst(seed)
    inverse = np.linalg.inv(covariance(precision, own))
    flat = columns.transpose(1, 0, 2).reshape(columns.shape[1], -1)
    found = normal_matrix(*(torch.from_numpy(each) for each in (columns, precision, own)))
    np.testing.assert_allclose(found, flat @ inverse @ flat.T, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_the_evidence_is_the_density_of_the_data_with_wide_priors_where_there_are_none(seed):
    columns, precision, own = burst(seed)
    normal = normal_matrix(*(torch.from_numpy(each) for each in (columns, precision, own)))
    evidence = MarginalLikelihood(normal[:-1, :-1], normal[:-1, -1], FREE)
    priors = torch.tensor([[0.0, 0.0], [0.3, 0.0], [0.2, 1.5]], dtype=torch.float64)
    flat = columns.transpose(1, 0, 2).reshape(columns.shape[1], -1)
    wide, noise = 1e5, covariance(precision, own)
    densities = [
        multivariate_normal.logpdf(flat[-1], cov=noise + flat[:-1].T @ np.diag([*[wide] * FREE, *prior]) @ flat[:-1])
        for prior in priors.tolist()
    ]
    nats = evidence.nats(priors).numpy()
    np.testing.assert_allclose(nats - nats[0], densities[0] - np.array(densities), atol=1e-3)


def test_means_are_those_of_a_ridge():
    columns, precision, own = burst(0)
    normal = normal_matrix(*(torch.from_numpy(each) for each in (columns, precision, own)))
    prior = torch.tensor([0.3, 0.7], dtype=torch.float64)
    first, others = MarginalLikelihood(normal[:-1, :-1], normal[:-1, -1], FREE).posterior(prior)
    ridge = torch.diag(torch.cat((torch.zeros(FREE, dtype=prior.dtype), 1 / prior)))
    expected = torch.linalg.solve(normal[:-1, :-1] + ridge, normal[:-1, -1])
    torch.testing.assert_close(torch.cat((first, others)), expected, rtol=1e-5, atol=1e-6)
