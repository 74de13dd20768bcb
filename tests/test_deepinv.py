"""Operators and denoisers in deepinv, and its own in deepir; without that package, with stand-ins of its protocol."""

import sys
import types

import pytest
import torch

from deepir.deepinv import PhysicsOperator, as_denoiser, as_physics
from deepir.denoisers.packages import unit_range
from deepir.operators import Blur, Operator, Warp
from deepir.registry import lookup


class StandIn(torch.nn.Module):
    """What `LinearPhysics` and `Denoiser` of deepinv are called by."""


@pytest.fixture(params=["deepinv", "stand-in"])
def deepinv(request, monkeypatch):
    if request.param == "deepinv":
        return pytest.importorskip("deepinv")
    modules = {name: types.ModuleType(name) for name in ("deepinv", "deepinv.physics", "deepinv.models")}
    modules["deepinv.physics"].LinearPhysics = modules["deepinv.models"].Denoiser = StandIn
    for name, module in modules.items():
        monkeypatch.setitem(sys.modules, name, module)
    return modules["deepinv"]


@pytest.mark.parametrize("kind", [Warp, Blur])
def test_an_operator_is_linear_physics(deepinv, kind):
    operator, x, slots = kind.example()
    physics = as_physics(operator, tuple(x.shape), **slots)
    y = physics.A(x)
    assert torch.equal(y, operator(x, **slots))
    u = torch.rand_like(y)
    assert torch.allclose((y * u).sum(), (x * physics.A_adjoint(u)).sum())


def test_physics_of_deepinv_are_a_stage(deepinv):
    _, x, slots = Blur.example()
    operator, size = Blur.example()[0], tuple(x.shape[-2:])
    physics = as_physics(operator, tuple(x.shape), **slots)
    stage = PhysicsOperator(physics, size, (size[0] - 2, size[1] - 2))
    assert stage(x).shape == stage.out_shape(tuple(x.shape), len(x)) == stage.valid(torch.ones_like(x)).shape
    assert stage.in_size((4, 5)) == size
    y = torch.rand_like(stage(x))
    assert torch.allclose((stage(x) * y).sum(), (x * stage.adjoint(y, tuple(x.shape))).sum())


def test_a_denoiser_is_converted_to_deepinv_and_back(deepinv):
    pictures = 100 + 10 * torch.rand(2, 1, 24, 24)
    model = as_denoiser("dct")
    wanted = torch.cat([lookup("denoiser", "dct")(each[None], 5.0) for each in pictures])
    assert torch.equal(model(pictures, 5.0), wanted)
    assert torch.equal(model(pictures, torch.tensor([5.0, 5.0])), wanted)
    assert torch.allclose(unit_range(model)(pictures, 5.0), wanted, atol=0.1)


def test_what_is_not_linear_is_refused(deepinv):
    class Squares(Operator):
        linear = affine = False

    with pytest.raises(ValueError, match="squares is not linear"):
        as_physics(Squares(), (1, 1, 4, 4))
