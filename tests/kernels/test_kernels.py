"""The compiled loops of the CPU, against what torch computes on other devices; the warp's are in tests/operators."""

import os
import subprocess
import sys
import threading

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from deepir.arrays.windows import squared_gradient
from deepir.closed_form import normal_equations
from deepir.closed_form.normal_equations import PixelEquations, PixelEquationsCPU
from deepir.kernels.compile import parallel_for
from deepir.priors.penalties.tv import TV

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


def pixels(kind, dtype, size, pedestal, one=False):
    generator = torch.Generator().manual_seed(0)
    shape = (4, *size)
    flux = pedestal + 10 * torch.rand(shape, generator=generator, dtype=torch.float32)
    flux = flux[:1].expand(shape) if one else flux  # without a warp, all frames see the same flux
    data, precision = flux + torch.randn(shape, generator=generator), torch.rand(shape, generator=generator)
    sigma, level = torch.tensor([0.02, 50.0], dtype=torch.float64), torch.arange(4, dtype=torch.float64)
    return kind(flux.to(dtype), data.to(dtype), precision.to(dtype), level, 1.0, sigma, sigma)


@pytest.mark.parametrize("size", [(1, 1), (3, 5), (60, 80)])
@pytest.mark.parametrize("pedestal", [0.0, 8000.0])
@pytest.mark.parametrize("one", [False, True])
def test_the_normal_equations_are_exact_in_float32_too(threads, size, pedestal, one):
    wanted = pixels(PixelEquations, torch.float64, size, pedestal, one)
    for dtype in (torch.float32, torch.float64):
        found = pixels(PixelEquationsCPU, dtype, size, pedestal, one)
        for name in ("maps", "column_sums", "row_sums"):
            for each, right in zip(getattr(found, name), getattr(wanted, name), strict=True):
                assert error(each, right) < 1e-12


@pytest.mark.parametrize("terms", [0, 3])
@pytest.mark.parametrize("size", [(3, 5), (60, 80)])
def test_rows_and_columns_are_solved_and_the_pixels_found(threads, size, terms):
    generator = torch.Generator().manual_seed(1)

    def random(*shape):
        return torch.rand(shape, generator=generator, dtype=torch.float64)

    (height, width), results = size, []
    root, to_columns, to_rows = random(2, 2, width) / 1e3, random(terms, 2 * width), random(terms, 2 * height)
    rhs, columns, neutral = random(2 * width + terms), random(2, width), random(2)
    weights, smooth = random(3, height) / 1e6, (random(2, height, terms), random(terms, width))
    for kind in (PixelEquations, PixelEquationsCPU):
        mine, white = pixels(kind, torch.float64, size, 50.0), (torch.empty(size), torch.empty(size))
        white = tuple(each.double() for each in white)
        solution = mine.solve(root, to_columns, to_rows, weights, rhs)
        errors, values = mine.back_substitute(columns, smooth, weights, neutral, white)
        results.append((solution, errors, values, *white))
    for found, right in zip(*results, strict=True):
        assert error(found, right) < 1e-10


@settings(deadline=None)
@given(size=sizes, dtype=types, one=st.booleans())
def test_the_weighted_residuals_and_their_sum(size, dtype, one):
    prediction, data = (
        100 + torch.randn(1 if one else 3, 1, *size, dtype=dtype),
        100 + torch.randn(3, 1, *size),
    )
    data, precision = data.to(dtype), torch.rand(3, 1, *size, dtype=dtype)
    gradient, loss = normal_equations.gradient_and_loss_cpu(prediction, data, precision)
    residuals, wanted = normal_equations.gradient_and_loss(prediction, data, precision)
    assert torch.equal(gradient, residuals)
    assert float(loss) == pytest.approx(float(wanted), rel=1e-5 if dtype == torch.float32 else 1e-12)


@settings(deadline=None)
@given(size=sizes, dtype=types, channels=st.integers(1, 2), one=st.booleans(), factor=st.sampled_from([1.0, 3.0]))
def test_the_frames_of_a_sensor_without_its_prediction(size, dtype, channels, one, factor):
    shape = (3, channels, *size)
    flux = (50 + torch.randn(1 if one else 3, channels, *size, dtype=torch.float64)).requires_grad_()
    data, precision = (50 + torch.randn(shape)).double(), torch.rand(shape).double()
    gain, offset = 1 + 0.1 * torch.randn(1, *shape[1:]).double(), torch.randn(1, *shape[1:]).double()
    level = torch.randn(3, 1, 1, 1, dtype=torch.float64, requires_grad=True)
    wanted = factor * normal_equations.weighted_least_squares(gain * flux + offset + level, data, precision)
    given = [each.detach().to(dtype) for each in (flux, data, precision, gain, offset, level)]
    given[0].requires_grad_()
    given[-1].requires_grad_()
    found = factor * normal_equations.sensor_least_squares(given[0].expand(shape), *given[1:3], tuple(given[3:]))
    tolerance = 1e-4 if dtype == torch.float32 else 1e-12
    assert float(found.detach()) == pytest.approx(float(wanted.detach()), rel=tolerance)
    slopes = torch.autograd.grad(found, (given[0], given[-1]))
    for slope, right in zip(slopes, torch.autograd.grad(wanted, (flux, level)), strict=True):
        assert slope.dtype == dtype
        assert torch.allclose(slope.double(), right, rtol=tolerance, atol=tolerance * float(right.abs().max()))


@settings(deadline=None)
@given(size=sizes, u=st.sampled_from([0.0, 0.3]), v=st.sampled_from([0.0, 2.0]))
def test_what_the_pixels_own_parts_add_to_the_slope(size, u, v):
    frames = [50 + torch.randn(3, 1, *size, dtype=torch.float64) for _ in range(3)]
    maps = [torch.randn(1, 1, *size, dtype=torch.float64) for _ in range(2)]
    level, system = torch.randn(3, 1, 1, 1, dtype=torch.float64), torch.rand(5, *size, dtype=torch.float64)
    given = (*frames, *maps, level, torch.tensor([u, v], dtype=torch.float64), system)
    found, wanted = (
        normal_equations.sensor_gradients_and_loss_cpu(*given),
        normal_equations.sensor_gradients_and_loss(*given),
    )
    assert all(torch.allclose(*pair) for pair in zip(found, wanted, strict=True))


def reference(penalty, squared):
    edge = penalty.epsilon.double()
    return (penalty.weight_map * squared / ((squared + edge.square()).sqrt() + edge)).sum()


@settings(deadline=None)
@given(
    size=sizes,
    dtype=types,
    pictures=st.sampled_from([(), (1, 1), (2, 3)]),
    weight=st.sampled_from([0.0, 0.1, 30.0]),
)
def test_total_variation_and_its_gradient(size, dtype, pictures, weight):
    penalty, value = TV((1, 1, *size), weight=weight), torch.randn(*pictures, *size, dtype=dtype)
    penalty.weight_map.uniform_(0.5, 2.0)
    value.requires_grad_()
    tolerance = 1e-5 if dtype == torch.float32 else 1e-12
    exact = value.detach().double().requires_grad_()
    found, wanted = penalty.energy(value), reference(penalty, squared_gradient(exact))
    assert float(found.detach()) == pytest.approx(float(wanted.detach()), rel=tolerance)
    (slope,), (right,) = torch.autograd.grad(found, value), torch.autograd.grad(wanted, exact)
    assert slope.dtype == dtype
    assert torch.allclose(slope.double(), right, rtol=tolerance, atol=tolerance * float(right.abs().max()))


def test_a_parallel_loop_covers_its_range_once_whatever_the_number_of_threads(threads):
    for count in (0, 1, 2, 10):
        seen, lock = [], threading.Lock()

        def note(first, last, seen=seen, lock=lock):
            with lock:
                seen.extend(range(first, last))

        parallel_for(note, count)
        assert sorted(seen) == list(range(count))


def test_an_error_in_a_thread_is_raised(threads):
    def fail(first, last):
        if last == 9:
            raise ArithmeticError("the last part")

    with pytest.raises(ArithmeticError, match="the last part"):
        parallel_for(fail, 9)


def test_a_first_use_says_why_it_takes_long(tmp_path):
    code = "import torch; from deepir.arrays.statistics import median; print(median(torch.arange(9001.0)))"
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    first, second = (
        subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=True)
        for _ in range(2)
    )
    assert first.stdout == second.stdout == "4500.0\n"
    assert first.stderr.splitlines() == ["compiling kernels for this machine, once: 5 to 15 s"]
    assert second.stderr == ""
