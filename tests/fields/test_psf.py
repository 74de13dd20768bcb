"""Point-spread functions, and other things that are known."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage, special

from deepir.assembly import make_field, start_field
from deepir.errors import ConfigError
from deepir.fields.base import Pixels
from deepir.fields.constant import Constant
from deepir.fields.psf import Airy, Defocus, Gaussian, Kernel, MotionBlur, Simplex
from deepir.operators import Blur

SIZE = (60, 80)


def test_a_gaussian_is_scipys_and_without_room_one_pixel():
    point = np.zeros((9, 9))
    point[4, 4] = 1
    wanted = ndimage.gaussian_filter(point, 1.2, radius=4, mode="constant")
    assert np.allclose(Gaussian((1, 1, 9, 9), size=SIZE, sigma=1.2)().detach()[0, 0], wanted, atol=1e-6)
    assert torch.equal(Gaussian((1, 1, 1, 1), size=SIZE)(), torch.ones(1, 1, 1, 1))


@settings(max_examples=25, deadline=None)
@given(sigma=st.floats(0.4, 3.0), start=st.floats(0.4, 3.0))
def test_the_width_of_a_gaussian_is_found_again(sigma, start):
    kernel = Gaussian((1, 1, 15, 15), size=SIZE, sigma=sigma)().detach()
    field = Gaussian((1, 1, 15, 15), size=SIZE, sigma=start)
    field.init_from(3 * kernel)
    assert field.sigma.item() == pytest.approx(sigma, rel=1e-3)


@pytest.mark.parametrize("sigma", [0.0, -1.0, float("nan"), float("inf")])
def test_a_width_must_be_positive(sigma):
    with pytest.raises(ValueError, match="sigma must be a positive number"):
        Gaussian((1, 1, 3, 3), size=SIZE, sigma=sigma)


def test_the_gradient_of_the_width_is_right():
    field = Gaussian((1, 1, 7, 7), size=SIZE, sigma=1.1).double()
    x = torch.rand(1, 1, 12, 12, dtype=torch.float64)

    def blurred(value):
        psf = torch.func.functional_call(field, {"value": value}, ())
        return Blur(radius=3)(x, psf=psf)

    assert torch.autograd.gradcheck(blurred, field.value.detach().clone().requires_grad_())


def test_a_kernel_from_a_file_is_scaled_to_sum_one_in_the_middle_of_its_array(tmp_path):
    given = np.random.default_rng(0).random((3, 5)) * 70
    np.save(tmp_path / "psf.npy", given)
    for shape, inside in (((1, 1, 3, 5), np.s_[:]), ((1, 1, 7, 9), np.s_[2:5, 2:7])):
        field = Kernel(shape, path=str(tmp_path / "psf.npy"))
        assert np.allclose(field()[0, 0][inside], given / given.sum(), atol=1e-6)
        assert float(field().sum()) == pytest.approx(1)
        assert not list(field.parameters())


def test_a_kernel_without_a_file_does_not_blur():
    x = torch.rand(1, 1, 8, 9)
    assert torch.allclose(Blur(radius=1)(x, psf=Kernel((1, 1, 3, 3))()), x[..., 1:-1, 1:-1])


def test_a_kernel_without_a_positive_sum_is_refused(tmp_path):
    np.save(tmp_path / "psf.npy", np.array([[-1.0, 0.5], [0.2, 0.1]]))
    with pytest.raises(ConfigError, match=r"psf\.npy.*positive sum"):
        Kernel((1, 1, 2, 2), path=str(tmp_path / "psf.npy"))


def test_a_known_map_comes_from_a_file_or_a_number(tmp_path):
    given = np.random.default_rng(0).random((6, 7)).astype(np.float32)
    np.save(tmp_path / "gain.npy", given)
    field = Constant((1, 1, 6, 7), 1.0, path=str(tmp_path / "gain.npy"))
    assert np.array_equal(field()[0, 0], given)
    field.init_from(torch.zeros(1))
    assert np.array_equal(field()[0, 0], given)
    assert torch.equal(Constant((1, 1, 6, 7), 1.0, value=3.0)(), torch.full((1, 1, 6, 7), 3.0))
    assert torch.equal(Constant((1, 1, 6, 7), 1.0)(), torch.ones(1, 1, 6, 7))


def test_a_map_of_another_size_is_refused_with_both_sizes(tmp_path):
    np.save(tmp_path / "gain.npy", np.ones((5, 7)))
    given = {"type": "constant", "path": str(tmp_path / "gain.npy")}
    wanted = (1, 1, 6, 7)
    with pytest.raises(ConfigError, match=r"sensor\.gain: .*\(1, 1, 6, 7\) is wanted, not \(1, 1, 5, 7\)"):
        make_field(given, wanted, 1.0, (6, 7), 1.0, "sensor.gain", wanted.__eq__)
    with pytest.raises(ConfigError, match="either"):
        Constant((1, 1, 6, 7), 1.0, path="a.npy", value=1.0)


def test_zeros_of_a_map_are_zeros_and_a_turned_one_is_refused(tmp_path):
    np.save(tmp_path / "weights.npy", np.array([0, 1, 2, 3.0])[:, None, None])
    known = Constant((4, 1, 1, 1), path=str(tmp_path / "weights.npy"))
    assert known().flatten().tolist() == [0, 1, 2, 3]
    assert known.starting_at(torch.ones(4, 1, 1, 1))().sum() == 4
    start = {"init": str(tmp_path / "weights.npy")}
    start_field(field := Pixels((4, 1, 1, 1)), start, None, None, "weight")
    assert field().flatten().tolist() == [0, 1, 2, 3]
    np.save(tmp_path / "weights.npy", np.ones((5, 7)))
    with pytest.raises(ConfigError, match=r"weight\.init.*\(5, 7\), \(1, 1, 7, 5\) is wanted"):
        start_field(Pixels((1, 1, 7, 5)), start, None, None, "weight")  # turned by a quarter


def test_an_airy_pattern_is_that_of_bessels_function():
    at = np.arange(-8, 9)
    v = special.jn_zeros(1, 1)[0] * np.hypot(at, at[:, None]) / 2.5 + 1e-9
    wanted = (2 * special.j1(v) / v) ** 2
    found = Airy((1, 1, 17, 17), size=SIZE, radius=2.5)().detach()[0, 0]
    assert np.allclose(found, wanted / wanted.sum(), atol=1e-6)


@pytest.mark.parametrize("radius", [1.5, 2.7, 4.0])
def test_a_point_out_of_focus_is_a_disc(radius):
    found = Defocus((1, 1, 13, 13), size=SIZE, radius=radius)().detach()[0, 0].numpy()
    at = np.arange(-6, 7)
    distance = np.hypot(at, at[:, None])
    assert np.allclose(found[distance < radius - 1.2], 1 / (np.pi * radius**2), rtol=0.1)
    assert found[distance > radius + 1.5].max() < 1e-3
    assert found.sum() == pytest.approx(1, abs=1e-5)


def test_a_camera_that_moves_along_x_blurs_along_x():
    found = MotionBlur((1, 1, 11, 11), size=SIZE, length=5.0)().detach()[0, 0].numpy()
    assert np.allclose(found[5, 3:8], 0.2, atol=0.03)
    steep = MotionBlur((1, 1, 11, 11), size=SIZE, length=5.0, angle=90.0)().detach()[0, 0].numpy()
    assert np.allclose(steep, found.T, atol=1e-5)


def test_values_of_any_shape_are_not_negative_and_sum_to_one():
    field = Simplex((1, 1, 5, 5), size=SIZE)
    field.init_from(torch.randn(1, 1, 5, 5))
    found = field().detach()
    assert found.min() >= 0
    assert float(found.sum()) == pytest.approx(1, abs=1e-6)
