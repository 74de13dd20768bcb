"""The compiled loops of the CPU, against torch, SciPy and numpy, and their threads and memory.

Those of the warp are in tests/operators. A small burst has one thread, a large one those that there are, or are given.
"""

import os
import subprocess
import sys
import threading

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from deepir.arrays.samples import block_means
from deepir.arrays.windows import squared_gradient
from deepir.closed_form import normal_equations
from deepir.closed_form.normal_equations import PixelEquations, PixelEquationsCPU
from deepir.kernels import memory, threads
from deepir.kernels.compile import parallel_for, parallel_map
from deepir.kernels.median_filter import median_filter
from deepir.priors.penalties.tv import TV

sizes = st.tuples(st.integers(1, 6), st.integers(1, 50))
types = st.sampled_from([torch.float32, torch.float64])


@pytest.fixture(params=[1, 3])
def thread_count(request):
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
def test_the_normal_equations_are_exact_in_float32_too(thread_count, size, pedestal, one):
    wanted = pixels(PixelEquations, torch.float64, size, pedestal, one)
    for dtype in (torch.float32, torch.float64):
        found = pixels(PixelEquationsCPU, dtype, size, pedestal, one)
        for name in ("maps", "column_sums", "row_sums"):
            for each, right in zip(getattr(found, name), getattr(wanted, name), strict=True):
                assert error(each, right) < 1e-12


@pytest.mark.parametrize("terms", [0, 3])
@pytest.mark.parametrize("size", [(3, 5), (60, 80)])
def test_rows_and_columns_are_solved_and_the_pixels_found(thread_count, size, terms):
    generator = torch.Generator().manual_seed(1)

    def random(*shape):
        return torch.rand(shape, generator=generator, dtype=torch.float64)

    (height, width), results = size, []
    root, to_columns, to_rows = random(2, 2, width) / 1e3, random(terms, 2 * width), random(terms, 2 * height)
    rhs, columns, neutral = random(2 * width + terms), random(2, width), random(2)
    weights, smooth = random(3, height) / 1e6, (random(2, height, terms), random(terms, width))
    for kind in (PixelEquations, PixelEquationsCPU):
        mine, white = pixels(kind, torch.float64, size, 50.0), torch.empty(2, *size, dtype=torch.float64).unbind()
        solution = mine.solve(root, to_columns, to_rows, weights, rhs)
        errors, values = mine.back_substitute(columns, smooth, weights, neutral, white)
        results.append((solution, errors, values, *white))
    for found, right in zip(*results, strict=True):
        assert error(found, right) < 1e-10


@settings(deadline=None)
@given(size=sizes, dtype=types, channels=st.integers(1, 2), one=st.booleans(), factor=st.sampled_from([1.0, 3.0]))
def test_the_frames_of_a_sensor_without_its_prediction(size, dtype, channels, one, factor):
    shape = (3, channels, *size)
    flux = (50 + torch.randn(1 if one else 3, channels, *size, dtype=torch.float64)).requires_grad_()
    data, precision = (50 + torch.randn(shape)).double(), torch.rand(shape).double()
    gain, offset = 1 + 0.1 * torch.randn(1, *shape[1:]).double(), torch.randn(1, *shape[1:]).double()
    level = torch.randn(3, 1, 1, 1, dtype=torch.float64, requires_grad=True)
    wanted = factor * (precision * (gain * flux + offset + level - data).square()).sum() / 2
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
    found = normal_equations.sensor_gradients_and_loss_cpu(*given)
    wanted = normal_equations.sensor_gradients_and_loss(*given)
    assert all(torch.allclose(*pair) for pair in zip(found, wanted, strict=True))


@settings(deadline=None)
@given(
    size=sizes, dtype=types, pictures=st.sampled_from([(), (1, 1), (2, 3)]), weight=st.sampled_from([0.0, 0.1, 30.0])
)
def test_total_variation_and_its_gradient(size, dtype, pictures, weight):
    penalty, value = TV((1, 1, *size), weight=weight), torch.randn(*pictures, *size, dtype=dtype)
    penalty.weight_map.uniform_(0.5, 2.0)
    value.requires_grad_()
    tolerance = 1e-5 if dtype == torch.float32 else 1e-12
    exact, edge = value.detach().double().requires_grad_(), penalty.epsilon.double()
    squared = squared_gradient(exact)
    wanted = (penalty.weight_map * squared / ((squared + edge.square()).sqrt() + edge)).sum()
    found = penalty.energy(value)
    assert float(found.detach()) == pytest.approx(float(wanted.detach()), rel=tolerance)
    (slope,), (right,) = torch.autograd.grad(found, value), torch.autograd.grad(wanted, exact)
    assert slope.dtype == dtype
    assert torch.allclose(slope.double(), right, rtol=tolerance, atol=tolerance * float(right.abs().max()))


@pytest.mark.parametrize("side", [3, 5, 7])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("shape", [(5, 9), (61, 83), (400, 301)])
def test_a_median_filter_is_that_of_scipy(shape, dtype, side):
    picture = np.random.default_rng(1).standard_normal(shape).astype(dtype)
    picture.ravel()[::3] = 0  # ties
    np.testing.assert_array_equal(median_filter(picture, side), ndimage.median_filter(picture, side))


def test_means_of_blocks_are_those_of_their_usable_samples():
    rng = np.random.default_rng(2)
    frames, usable = rng.standard_normal((3, 13, 18)).astype(np.float32), rng.random((3, 13, 18)) > 0.4
    usable[1, :4, :4] = False
    blocks = np.where(usable, frames, np.nan)[:, :12, :16].reshape(3, 3, 4, 4, 4)
    expected = np.nanmean(np.where(np.isfinite(blocks).any((2, 4), keepdims=True), blocks, 0), (2, 4))
    expected[1, 0, 0] = np.median(frames[1][usable[1]])
    np.testing.assert_allclose(block_means(frames, usable, 4), expected, rtol=1e-5, atol=1e-6)


def test_a_parallel_loop_covers_its_range_once_whatever_the_number_of_threads(thread_count):
    for count in (0, 1, 2, 10):
        seen, lock = [], threading.Lock()

        def note(first, last, seen=seen, lock=lock):
            with lock:
                seen.extend(range(first, last))

        parallel_for(note, count)
        assert sorted(seen) == list(range(count))


def test_an_error_in_a_thread_is_raised(thread_count):
    def fail(first, last):
        if last == 9:
            raise ArithmeticError("the last part")

    with pytest.raises(ArithmeticError, match="the last part"):
        parallel_for(fail, 9)


def test_a_first_use_says_why_it_takes_long(tmp_path):
    code = (
        "import numpy as np; from deepir.kernels.median_filter import median_filter; "
        "print(median_filter(np.arange(81.0).reshape(9, 9), 3)[4, 4])"
    )
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    first, second = (
        subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=True)
        for _ in range(2)
    )
    assert first.stdout == second.stdout == "40.0\n"
    assert first.stderr.splitlines() == ["compiling kernels for this machine, once: 5 to 15 s"]
    assert second.stderr == ""


@pytest.mark.parametrize("most", [None, 3])
def test_loops_and_layers_have_several_threads_for_large_bursts_only(most):
    before = torch.get_num_threads()
    assert threads.count() == threads.available() == min(before, threads.MAX_THREADS)
    for samples, expected in (
        (threads.MIN_PARALLEL_SAMPLES - 1, 1),
        (threads.MIN_PARALLEL_SAMPLES, most or threads.available()),
    ):
        with threads.for_samples(samples, most):
            assert (threads.count(), torch.get_num_threads()) == (expected, 1)
            assert parallel_map(lambda _: threads.count(), range(3)) == [1] * 3  # a loop within a loop is not shared
            with threads.for_layers():
                assert torch.get_num_threads() == expected
            assert torch.get_num_threads() == 1
        assert torch.get_num_threads() == before


def test_threads_and_memory_are_restored_after_an_error():
    before = torch.get_num_threads()
    with pytest.raises(KeyError), threads.for_samples(threads.MIN_PARALLEL_SAMPLES, 2), memory.kept():
        raise KeyError
    assert torch.get_num_threads() == before


def test_nested_contexts_return_memory_once_at_the_end_of_the_outermost(monkeypatch):
    calls = []

    class Library:
        def mallopt(self, option, value):
            calls.append(option)

        def malloc_trim(self, pad):
            calls.append("trim")

    monkeypatch.setattr(memory, "_glibc", Library)
    with memory.kept():
        begun = len(calls)
        with memory.kept():
            pass
        assert (len(calls), "trim" in calls) == (begun, False)
    assert calls.count("trim") == 1


def test_another_c_library_is_left_alone(monkeypatch):
    monkeypatch.setattr(memory, "_glibc", lambda: None)
    with memory.kept():
        pass
