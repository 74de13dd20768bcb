"""The algebra of linear maps, and that of SciPy."""

import numpy as np
import pytest
import torch
from scipy.sparse.linalg import lsqr

from deepir.operators import Blur, Operator, Sensor, Warp
from deepir.operators.linear import identity, stack
from deepir.registry import components

EXAMPLES = {name: kind.example() for name, kind in components("operator").items()}
AFFINE = [name for name, (operator, _, _) in EXAMPLES.items() if operator.affine]


class Squares(Operator):
    """Not linear."""

    linear = affine = False

    def forward(self, x, **slots):
        return x**2


def random(shape, seed=0):
    return torch.rand(shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


def assert_adjoint(linear):
    """The dot test: <A x, y> = <x, A' y>."""
    x, y = random(linear.in_shape), random(linear.out_shape, 1)
    assert float((linear(x) * y).sum()) == pytest.approx(float((x * linear.H(y)).sum()), rel=1e-10)


def blurs():
    """Two blurs of the same shapes."""
    operator, x, slots = Blur.example()
    return operator.at(tuple(x.shape), **slots), operator.at(tuple(x.shape), psf=slots["psf"].mT)


@pytest.mark.parametrize("name", AFFINE)
def test_every_affine_operator_has_an_exact_adjoint_which_finds_the_shape_of_the_input(name):
    operator, x, slots = EXAMPLES[name]
    linear = operator.at(tuple(x.shape), **slots)
    assert_adjoint(linear)
    y = random(linear.out_shape)
    torch.testing.assert_close(operator.at(**slots).H(y), linear.H(y))
    torch.testing.assert_close(linear(x), operator(x, **slots) - operator(torch.zeros_like(x), **slots))


@pytest.mark.parametrize(
    "made",
    [
        lambda a, b: a + b,
        lambda a, b: a - 2 * b,
        lambda a, b: -a * 3,
        lambda a, b: a.N + identity(a.in_shape),
        lambda a, b: a @ b.H,
        stack,
        lambda a, b: (a + b).H,
    ],
)
def test_sums_multiples_products_and_stacks_have_exact_adjoints(made):
    assert_adjoint(made(*blurs()))


def test_the_algebra_is_that_of_matrices():
    (a, b), x = blurs(), random(Blur.example()[1].shape)
    torch.testing.assert_close((2 * a - b)(x), 2 * a(x) - b(x))
    torch.testing.assert_close(a.N(x), a.H(a(x)))
    torch.testing.assert_close(stack(a, b)(x), torch.cat((a(x), b(x))))
    torch.testing.assert_close(a.H.H(x), a(x))


def test_a_map_shows_its_shapes():
    a, b = blurs()
    assert repr((a + 2 * b) @ identity(a.in_shape)) == ("(Blur + 2 Blur) @ Identity: (2, 1, 6, 7) -> (2, 1, 4, 5)")


@pytest.mark.parametrize("wrong", [lambda a: a @ a, lambda a: a + a.H, lambda a: stack(a, a.H)])
def test_shapes_that_do_not_fit_are_named(wrong):
    with pytest.raises(ValueError, match=r"Blur.*\(2, 1, 6, 7\)"):
        wrong(blurs()[0])


def test_slots_that_are_missing_are_neutral():
    x = random((2, 1, 4, 5))
    gain = random((1, 1, 4, 5), 1)
    torch.testing.assert_close(Sensor()(x, gain=gain), gain * x)
    assert_adjoint(Sensor().at(tuple(x.shape), gain=gain))


def test_what_is_not_linear_is_linearised_at_an_input():
    x, v = random((2, 1, 4, 5)), random((2, 1, 4, 5), 1)
    derivative = Squares().at(x)
    torch.testing.assert_close(derivative(v), 2 * x * v)
    assert_adjoint(derivative)
    warp, scene, slots = Warp.example()
    chain = (Squares() @ warp).at(scene, **{"warp.motion": slots["motion"]})
    torch.testing.assert_close(chain(scene), 2 * warp(scene, **slots) ** 2)
    assert_adjoint(chain)
    with pytest.raises(ValueError, match="squares is not linear"):
        Squares().at((1, 1, 4, 4))


def test_a_chain_is_inverted_by_scipy():
    warp, x, slots = Warp.example()
    chain = Sensor() @ warp
    maps = {"sensor.gain": torch.full((1, 1, 6, 7), 2.0), "sensor.offset": torch.full((1, 1, 6, 7), 5.0)}
    maps = {name: each.double() for name, each in maps.items()} | {"warp.motion": slots["motion"]}
    matrix = chain.at(tuple(x.shape), **maps).as_scipy()
    frames = chain(x, **maps) - 5
    found = lsqr(matrix, frames.flatten().numpy(), atol=1e-10, btol=1e-10, iter_lim=3000)[0]
    assert matrix @ found == pytest.approx(frames.flatten().numpy(), abs=1e-4)
    assert matrix.dtype == np.float64
