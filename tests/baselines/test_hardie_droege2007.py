"""The most probable scene and sensor."""

import numpy as np
import pytest
import torch
from cameras import clean

import deepir
from deepir.baselines.hardie_droege2007 import Model, high_pass, high_pass_normal
from deepir.errors import ConfigError
from deepir.metrics import scores
from deepir.simulate import simulate


def model(seed=0, size=5, n=4):
    """A small model whose look is a random matrix, and a start near the scene that made its data."""
    g = torch.Generator().manual_seed(seed)
    matrix = torch.rand(n * size**2, size**2, generator=g, dtype=torch.float64)
    scene = torch.rand(1, 1, size, size, generator=g, dtype=torch.float64)

    def look(z):
        return (matrix @ z.reshape(-1)).reshape(n, 1, size, size)

    def normal(*shape):
        return torch.randn(*shape, generator=g, dtype=torch.float64)

    data = (1 + 0.1 * normal(size, size)) * look(scene) + 0.3 * normal(size, size) + 0.1 * normal(n, 1, size, size)
    return Model(
        forward=look,
        adjoint=lambda y: (matrix.T @ y.reshape(-1)).reshape(1, 1, size, size),
        data=data,
        usable=(torch.rand(n, 1, size, size, generator=g) > 0.1).double(),
        precisions=(100.0, 10.0, 100.0, 10.0),
    ), scene + 0.1 * normal(1, 1, size, size)


def cost(model, z, gain, bias):
    """The paper's L, with the gain."""
    noise, smooth, of_gain, of_bias = model.precisions
    left = model.usable * (model.data - gain * model.forward(z) - bias)
    terms = zip((noise, smooth, of_gain, of_bias), (left, high_pass(z), gain - 1, bias), strict=True)
    return sum(p * (each**2).sum() / 2 for p, each in terms)


def test_the_gradient_of_the_papers_cost_is_zero_at_the_result(monkeypatch):
    monkeypatch.setattr("deepir.baselines.hardie_droege2007.GAUSS_NEWTON_STEPS", 50)
    monkeypatch.setattr("deepir.baselines.hardie_droege2007.CG_TOLERANCE", 1e-12)
    small, start = model()
    z, _ = small.solve(start)
    unknowns = [each.requires_grad_() for each in (z, *small.sensor(small.forward(z)))]
    gradients = torch.autograd.grad(cost(small, *unknowns), unknowns)
    assert max(float(each.abs().max()) for each in gradients) < 1e-5


def test_three_rounds_are_enough():
    small, start = model()
    z, _ = small.solve(start)
    best = z
    for _ in range(5):
        best, _ = small.solve(best)
    found, least = (float(cost(small, each, *small.sensor(small.forward(each)))) for each in (z, best))
    assert found == pytest.approx(least, rel=1e-3)


def test_roughness_is_the_transpose_after_the_difference():
    a, b = torch.rand(2, 1, 1, 7, 8, dtype=torch.float64)
    assert torch.allclose((high_pass(a) * high_pass(b)).sum(), (a * high_pass_normal(b)).sum())
    y, x = torch.meshgrid(torch.arange(7.0), torch.arange(8.0), indexing="ij")
    assert torch.allclose(high_pass((2 * x + 3 * y).double()[None, None]), torch.zeros(1).double(), atol=1e-12)


@pytest.mark.parametrize(("name", "sigma"), [("offset", {"offset_pixel": 0.05}), ("gain", {"gain_pixel": 0.1})])
def test_gain_and_bias_are_found(name, sigma):
    # Offsets alone, then gains alone: the strengths tell which it is.
    sim = simulate(None, clean(n_frames=8, shape=(32, 40), psf_sigma=0.5, read_noise=0.003, **sigma), seed=1)
    result = deepir.run("nuc", frames=sim.frames, method="hardie_droege2007")
    found, truth = (getattr(each, name).ravel() for each in (result, sim.truth))
    assert np.corrcoef(found, truth)[0, 1] > 0.9
    before, after = (scores(each, sim.truth.scene)["psnr_aligned"] for each in (sim.frames[0], result.scene))
    assert after > before + 12


def test_without_a_sensor_it_is_refused():
    frames = np.random.default_rng(0).random((3, 24, 32))
    with pytest.raises(ConfigError, match="needs the stage 'sensor' last"):
        deepir.run("nuc", "physics.sensor=null", "problem=generic", frames=frames, method="hardie_droege2007")
