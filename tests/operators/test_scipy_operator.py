"""Operators as SciPy's linear operators."""

import numpy as np
import pytest
import torch
from scipy.sparse.linalg import lsqr

from deepir.operators import Blur, Operator, Sensor, Warp
from deepir.registry import components

AFFINE = [name for name, kind in components("operator").items() if kind.example()[0].affine]


@pytest.mark.parametrize("name", AFFINE)
def test_the_adjoint_is_exact(name):
    operator, x, slots = components("operator")[name].example()
    matrix = operator.as_linear_operator(tuple(x.shape), **slots)
    rng = np.random.default_rng(0)
    u, v = rng.standard_normal(matrix.shape[1]), rng.standard_normal(matrix.shape[0])
    assert v @ (matrix @ u) == pytest.approx(u @ (matrix.T @ v), rel=1e-10)
    assert matrix.dtype == np.float64
    at_zero = operator(torch.zeros_like(x), **slots)
    assert matrix @ x.flatten().numpy() == pytest.approx((operator(x, **slots) - at_zero).flatten().numpy())


def test_a_chain_is_inverted_by_scipy():
    warp, x, slots = Warp.example()
    chain = Sensor() @ warp
    maps = {"sensor.gain": torch.full((1, 1, 6, 7), 2.0), "sensor.offset": torch.full((1, 1, 6, 7), 5.0)}
    maps |= {"sensor.level": torch.zeros(3, 1, 1, 1), "warp.motion": slots["motion"]}
    matrix = chain.as_linear_operator(tuple(x.shape), **maps)
    frames = chain(x, **{name: each.double() for name, each in maps.items()}) - 5
    found = lsqr(matrix, frames.flatten().numpy(), atol=1e-10, btol=1e-10, iter_lim=3000)[0]
    assert matrix @ found == pytest.approx(frames.flatten().numpy(), abs=1e-4)


def test_what_is_not_linear_is_refused():
    class Squares(Operator):
        linear = affine = False

        def forward(self, x, **slots):
            return x**2

    with pytest.raises(ValueError, match="squares is not linear"):
        Squares().as_linear_operator((1, 1, 4, 4))


def test_pylops_takes_it():
    pylops = pytest.importorskip("pylops")
    operator, x, slots = Blur.example()
    matrix = pylops.LinearOperator(operator.as_linear_operator(tuple(x.shape), **slots))
    assert pylops.utils.dottest(matrix, *matrix.shape, rtol=1e-8)
