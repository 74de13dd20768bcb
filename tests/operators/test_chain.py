"""Operators compose."""

import pytest
import torch

from deepir.operators import Add, Blur, Chain, Downsample, Sensor, Warp
from deepir.testing import check_operator


def slots_for(chain, x, n_frames):
    torch.manual_seed(0)
    found = {n: 0.5 + torch.rand(s, dtype=torch.float64) for n, s in chain.slots(tuple(x.shape), n_frames).items()}
    if "warp.motion" in found:
        found["warp.motion"] = torch.eye(3, dtype=torch.float64) + 0.01 * found["warp.motion"]
        found["warp.motion"][:, 2, 2] = 1
    return found


def test_the_last_written_is_applied_first():
    x = torch.rand(1, 1, 8, 8)
    chain = Downsample(factor=2) @ Blur(radius=1)
    psf = torch.rand(1, 1, 3, 3)
    assert torch.equal(chain(x, **{"blur.psf": psf}), Downsample(factor=2)(Blur(radius=1)(x, psf=psf)))


def test_a_slot_that_no_stage_has_is_refused():
    for wrong in ("gain", "senser.gain"):
        with pytest.raises(ValueError, match=rf"no slot '{wrong}' in this chain, which has: sensor\.gain"):
            (Sensor() @ Downsample(factor=2)).at((1, 1, 8, 8), **{wrong: torch.ones(1, 1, 4, 4)})


def test_composition_is_associative():
    a, b, c = Blur(radius=1), Add(), Sensor()
    names = ["blur", "add", "sensor"]
    assert [n for n, _ in ((c @ b) @ a).named()] == [n for n, _ in (c @ (b @ a)).named()] == names


def test_two_stages_of_a_kind_do_not_clash():
    chain = Blur(radius=2) @ Blur(radius=1) @ Blur(radius=1)
    assert chain.slots((1, 1, 20, 20), 1) == {
        "blur.psf": (1, 1, 3, 3),
        "blur2.psf": (1, 1, 3, 3),
        "blur3.psf": (1, 1, 5, 5),
    }


@pytest.mark.parametrize(
    ("chain", "shape", "linear"),
    [
        # The whole forward model: warp, blur, downsample, stray flux, sensor.
        (Sensor() @ Add() @ Downsample() @ Blur(radius=1) @ Warp((10, 12), (14, 15), (2, 1)), (1, 1, 14, 15), False),
        (Downsample() @ Blur(radius=1), (2, 1, 8, 10), True),
    ],
)
def test_a_chain_is_a_good_operator(chain, shape, linear):
    x = torch.rand(shape, dtype=torch.float64)
    check_operator(chain, x, slots_for(chain, x, 3))
    assert (chain.linear, chain.affine) == (linear, True)


@pytest.mark.parametrize("size", [(4, 5), (7, 3)])
def test_sizes_go_backwards_through_a_chain(size):
    chain = Chain({"down": Downsample(factor=3), "blur": Blur(radius=2)})
    assert chain.out_shape((1, 1, *chain.in_size(size)), 1)[-2:] == size


def test_a_bad_pixel_spreads_over_what_is_computed_from_it():
    chain = Chain({"blur": Blur(radius=1), "down": Downsample(factor=2)})
    mask = torch.ones(1, 1, 10, 10)
    mask[0, 0, 4, 4] = 0  # in blurred pixels (2..4, 2..4), which are in blocks 1 and 2
    valid = chain.valid(mask, **{"blur.psf": torch.ones(1, 1, 3, 3) / 9})
    wanted = torch.ones(4, 4)
    wanted[1:3, 1:3] = 0
    assert torch.equal(valid[0, 0], wanted)
