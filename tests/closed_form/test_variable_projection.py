"""Gain and offset in closed form, against dense least squares."""

import itertools

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from deepir.closed_form.variable_projection import COLUMN, PIXEL, ROW, eliminate
from deepir.fields.sensor_maps import Column, GaussianMap, Pixel, Row
from deepir.fields.shading import Shading

SHAPE = (1, 1, 5, 6)
KINDS = {"column": Column, "row": Row, "pixel": Pixel, "shading": Shading}
SIGMAS = {"column": 0.02, "row": 0.01, "pixel": 0.03, "shading": 0.02}
subsets = st.sets(st.sampled_from(sorted(KINDS)))


def make_parts(names, unit, zero=()):
    return [KINDS[n](SHAPE, sigma=0.0 if n in zero else unit * SIGMAS[n]) for n in sorted(names)]


def burst(pedestal=50.0, n_frames=3, dead=0.0, seed=0):
    generator = torch.Generator().manual_seed(seed)
    shape = (n_frames, *SHAPE[1:])
    z = pedestal + 10 * torch.rand(shape, generator=generator, dtype=torch.float64)
    y = 0.5 * torch.randn(shape, generator=generator, dtype=torch.float64)
    w = (0.5 + torch.rand(shape, generator=generator, dtype=torch.float64)) / 0.1**2
    w = w * (torch.rand(SHAPE, generator=generator) >= dead)
    return z, y, w


def spread(part):
    """Matrix from a part's values to the map."""
    units = torch.eye(part.whitened.numel(), dtype=torch.float64).reshape(-1, *part.whitened.shape)
    if isinstance(part, Shading):
        return part.synthesise(units).flatten(1).T.numpy()
    return torch.stack([unit.expand(SHAPE).reshape(-1) for unit in units], 1).numpy()


def dense(z, y, w, gain, offset):
    """Whitened design matrix and right-hand side of the whole least-squares problem."""
    weights, flux = w.sqrt().numpy().ravel()[:, None], z.numpy().ravel()[:, None]
    columns = [
        weights * flux**power * np.tile(spread(part), (len(z), 1)) * part.prior_sigma.numpy()
        for power, parts in ((1, gain), (0, offset))
        for part in parts
    ]
    a = np.concatenate(columns, 1)
    b = weights[:, 0] * y.numpy().ravel()
    return np.concatenate([a, np.eye(a.shape[1])]), np.concatenate([b, np.zeros(a.shape[1])])


@settings(max_examples=30, deadline=None)
@given(
    gain=subsets, offset=subsets, zero=st.sampled_from([(), ("column",), ("pixel",), ("row", "pixel"), ("shading",)]),
    pedestal=st.sampled_from([0.0, 50.0, 8000.0]), dead=st.sampled_from([0.0, 0.3]),
    n_frames=st.integers(1, 4), seed=st.integers(0, 99),
)  # fmt: skip
def test_the_optimum_is_that_of_dense_least_squares(gain, offset, zero, pedestal, dead, n_frames, seed):
    gains, offsets = make_parts(gain, 1.0, zero), make_parts(offset, 50.0, zero)
    z, y, w = burst(pedestal, n_frames, dead, seed)
    eliminate(z, y, w, gains, offsets)
    parts = [*gains, *offsets]
    if parts:
        a, b = dense(z, y, w, gains, offsets)
        wanted = np.linalg.lstsq(a, b, rcond=None)[0]
        found = np.concatenate([part.whitened.detach().numpy().ravel() for part in parts])
        assert found == pytest.approx(wanted, abs=2e-7)
        # What counts for the line search: the objective itself.
        costs = [((a @ x - b) ** 2).sum() / 2 for x in (found, wanted)]
        assert costs[0] == pytest.approx(costs[1], rel=1e-11)


@pytest.mark.parametrize("pixel", [0.0, 1e-4, 0.007, 0.05])
@pytest.mark.parametrize("pedestal", [0.5, 8000.0])
def test_strong_lines_are_found_in_single_precision_too(pixel, pedestal):
    generator, shape, sigmas = torch.Generator().manual_seed(0), (1, 1, 40, 50), (0.2, 0.2, pixel)
    z = pedestal * (1 + 0.2 * torch.rand(5, *shape[1:], generator=generator))
    noise = torch.randn(z.shape, generator=generator)
    gain = 1 + 0.2 * torch.randn(shape[-1], generator=generator)
    y, precision = gain * z + 1e-3 * pedestal * noise, torch.full_like(z, 1e6 / pedestal**2)
    found = []
    for dtype in (torch.float32, torch.float64):
        gains, offsets = (
            [kind(shape, sigma=unit * sigma) for kind, sigma in zip((Column, Row, Pixel), sigmas, strict=True)]
            for unit in (1.0, pedestal)
        )
        eliminate(z.to(dtype), y.to(dtype), precision.to(dtype), gains, offsets, neutral=(1.0, 0.0))
        found.append(torch.cat([part.whitened.detach().flatten() for part in (*gains, *offsets)]))
    assert found[0].numpy() == pytest.approx(found[1].numpy(), abs=3e-5)


def white_variances(z, y, w, parts):
    """Posterior variances of whitened values, from the inverse of the dense normal matrix: one array a part."""
    a, _ = dense(z, y, w, *parts)
    sizes = [part.whitened.numel() for each in parts for part in each]
    return np.split(np.diag(np.linalg.inv(a.T @ a)), np.cumsum(sizes)[:-1])


@pytest.mark.parametrize(
    ("names", "pedestal", "dead"),
    [
        *itertools.product([["pixel"]], [0.0, 50.0, 8000.0], [0.0, 0.3]),
        (["column"], 50.0, 0.0),
        (["pixel", "column", "shading"], 50.0, 0.0),
    ],
)
def test_variances_of_pixels_or_columns_alone_and_of_shadings_are_those_of_the_dense_inverse(names, pedestal, dead):
    parts = make_parts(names, 1.0), make_parts(names, 50.0)
    z, y, w = burst(pedestal, dead=dead)
    found = [v for each in eliminate(z, y, w, *parts).posterior_variances() for v in each]
    compared = 0
    for variance, part, white in zip(found, itertools.chain(*parts), white_variances(z, y, w, parts), strict=True):
        assert variance.shape == part.whitened.shape
        if len(names) == 1 or isinstance(part, Shading):  # others are approximate beside each other
            wanted = white * part.prior_sigma.numpy().ravel() ** 2
            assert variance.numpy().ravel() == pytest.approx(wanted, rel=1e-6)
            compared += 1
    assert compared == 2


def test_variances_come_in_the_order_of_the_parts_and_lie_between_nothing_and_the_prior():
    gains, offsets = make_parts(["pixel", "column"], 1.0), make_parts(["row", "column", "pixel"], 50.0)
    found = [v for each in eliminate(*burst(), gains, offsets).posterior_variances() for v in each]
    for variance, part in zip(found, (*gains, *offsets), strict=True):
        assert variance.shape == part.whitened.shape
        assert (variance > 0).all()
        assert (variance <= part.sigma**2 * (1 + 1e-12)).all()


def test_a_pixel_without_data_is_left_at_its_prior():
    gains, offsets = make_parts(["pixel"], 1.0), make_parts(["pixel"], 50.0)
    z, y, w = burst()
    w[:, 0, 2, 3] = 0
    variances = [v for each in eliminate(z, y, w, gains, offsets).posterior_variances() for v in each]
    for part, variance in zip((*gains, *offsets), variances, strict=True):
        assert part.whitened[0, 0, 2, 3] == 0
        assert variance[0, 0, 2, 3] == pytest.approx(float(part.sigma) ** 2)


@pytest.mark.parametrize("names", [["pixel"], ["column", "row", "pixel"]])
def test_flux_that_is_not_a_number_leaves_the_parts_as_they_were(names):
    gains, offsets = make_parts(names, 1.0), make_parts(names, 50.0)
    z, y, w = burst()
    eliminate(z, y, w, gains, offsets)
    before = [part.values.clone() for part in (*gains, *offsets)]
    for bad in (float("nan"), float("inf")):
        z[1, 0, 2, 3] = bad
        eliminate(z, y, w, gains, offsets)
        assert all(torch.equal(a, b.values) for a, b in zip(before, (*gains, *offsets), strict=True))


def test_parts_without_a_closed_form_are_refused():
    class Whole(GaussianMap):
        constant_axes = (-2, -1)

    z, y, w = burst()
    for parts in ([Whole(SHAPE, sigma=1.0)], [Column(SHAPE, sigma=1.0), Column(SHAPE, sigma=2.0)]):
        with pytest.raises(ValueError, match="no closed form"):
            eliminate(z, y, w, parts, [])
    assert [kind.constant_axes for kind in (Pixel, Column, Row)] == [PIXEL, COLUMN, ROW]


def test_the_gradient_is_that_of_the_objective_optimised_anew(small_nuc):
    # The envelope theorem, which needs the elimination to be exact.
    problem = small_nuc(pedestal=8000.0)
    free = ["scene", "motion"]

    def objective():
        values = problem.values(free)
        terms = problem.losses(values, ("gain", "offset"))
        return torch.stack(list(terms.values())).sum()

    parameters = [problem.fields[name].values for name in free]
    gradients = torch.autograd.grad(objective(), parameters)
    for parameter, gradient in zip(parameters, gradients, strict=True):
        direction = torch.randn_like(parameter)
        step, costs = 1e-5, []
        for sign in (1, -1):
            with torch.no_grad():
                parameter.add_(sign * step * direction)
                costs.append(float(objective()))
                parameter.sub_(sign * step * direction)
        assert (costs[0] - costs[1]) / (2 * step) == pytest.approx(float((gradient * direction).sum()), rel=1e-4)
