"""The compiled loops of the CPU, against what torch computes on other devices; the warp's are in tests/operators."""

import threading

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from deepir import elimination, fidelity
from deepir.loops import spread
from deepir.penalties import tv

sizes = st.tuples(st.integers(1, 6), st.integers(1, 50))
types = st.sampled_from([torch.float32, torch.float64])


@pytest.fixture(params=[1, 3])
def threads(request):
    before = torch.get_num_threads()
    torch.set_num_threads(request.param)
    yield request.param
    torch.set_num_threads(before)


def error(found, wanted):
    return float((found - wanted).abs().max() / wanted.abs().max())


@pytest.mark.parametrize("size", [(1, 1), (3, 5), (60, 80)])
@pytest.mark.parametrize("pedestal", [0.0, 8000.0])
def test_the_sums_over_the_frames_are_exact_in_float32_too(threads, size, pedestal):
    flux = pedestal + 10 * torch.rand(4, *size)
    data, precision = torch.randn(4, *size), torch.rand(4, *size)
    wanted = elimination._sums(flux.double(), data.double(), precision.double())
    for found, right in zip(elimination._sums_on_cpu(flux, data, precision), wanted, strict=True):
        assert error(found, right) < 1e-13
    of_one = flux[:1].expand(4, *size)  # without a warp, all frames see the same flux
    for found, right in zip(
        elimination._sums_on_cpu(of_one, data, precision)[4:],
        elimination._sums(of_one.double(), data.double(), precision.double())[4:],
        strict=True,
    ):
        assert error(found, right) < 1e-13


@settings(deadline=None)
@given(size=sizes, dtype=types, one=st.booleans())
def test_the_weighted_residuals_and_their_sum(size, dtype, one):
    prediction, data = (
        100 + torch.randn(1 if one else 3, 1, *size, dtype=dtype),
        100 + torch.randn(3, 1, *size),
    )
    data, precision = data.to(dtype), torch.rand(3, 1, *size, dtype=dtype)
    weighted, nats = fidelity._half_squares_on_cpu(prediction, data, precision)
    residuals, wanted = fidelity._half_squares(prediction, data, precision)
    assert torch.equal(weighted, residuals)
    assert float(nats) == pytest.approx(float(wanted), rel=1e-5 if dtype == torch.float32 else 1e-12)


@settings(deadline=None)
@given(
    size=sizes,
    dtype=types,
    pictures=st.sampled_from([(), (1, 1), (2, 3)]),
    weight=st.sampled_from([0.0, 0.1, 30.0]),
)
def test_total_variation_and_its_gradient(size, dtype, pictures, weight):
    penalty, value = tv.TV(weight=weight), torch.randn(*pictures, *size, dtype=dtype, requires_grad=True)
    rounding = penalty.rounding / penalty.weight.clamp(min=1e-12)
    tolerance = 1e-5 if dtype == torch.float32 else 1e-12
    exact = value.detach().double().requires_grad_()
    found, wanted = penalty.energy(value), tv.total_variation(exact, rounding.double())
    assert float(found.detach()) == pytest.approx(float(wanted.detach()), rel=tolerance)
    (slope,), (right,) = torch.autograd.grad(found, value), torch.autograd.grad(wanted, exact)
    assert slope.dtype == dtype
    assert torch.allclose(slope.double(), right, rtol=tolerance, atol=tolerance * float(right.abs().max()))


def test_the_parts_of_a_range_are_all_of_it_once_whatever_the_number_of_threads(threads):
    for count in (0, 1, 2, 10):
        seen, lock = [], threading.Lock()

        def note(first, last, seen=seen, lock=lock):
            with lock:
                seen.extend(range(first, last))

        spread(note, count)
        assert sorted(seen) == list(range(count))


def test_what_goes_wrong_in_a_part_is_raised(threads):
    def fail(first, last):
        if last == 9:
            raise ArithmeticError("the last part")

    with pytest.raises(ArithmeticError, match="the last part"):
        spread(fail, 9)
