"""The blurs of the simulated camera."""

import numpy as np
import pytest

from deepir.simulate import Settings, simulate
from deepir.simulate.optics import PSF_SAMPLES_PER_PIXEL, airy, psf

SHARP = dict.fromkeys(
    ["gain_pixel", "gain_column", "offset_pixel", "offset_column", "offset_row", "shading", "dead_pixels"],
    0.0,
) | {"n_frames": 1, "shape": (24, 32), "read_noise": 0.0, "psf_sigma": 0.0}


def moments(kernel):
    """Variances along x and y, and their covariance, detector px."""
    at = (np.arange(len(kernel)) - len(kernel) // 2) / PSF_SAMPLES_PER_PIXEL
    x, y = np.meshgrid(at, at)
    return [(kernel * each).sum() for each in (x * x, y * y, x * y)]


def test_an_airy_pattern_is_dark_at_its_first_ring():
    assert airy(np.array([0.0]), 2.0)[0] == pytest.approx(1)
    assert airy(np.array([2.0]), 2.0)[0] == pytest.approx(0, abs=1e-12)
    assert airy(np.array([1.029 / 2.44 * 2.0]), 2.0)[0] == pytest.approx(
        0.5, abs=2e-3
    )  # full width 1.029 λ N


def test_a_disc_has_a_quarter_of_its_squared_radius_as_variance():
    x, y, _ = moments(psf(Settings(**SHARP | {"defocus_radius": 3.0})))
    assert (x, y) == pytest.approx((9 / 4, 9 / 4), rel=0.02)


def test_a_motion_blurs_along_its_direction_by_a_twelfth_of_its_square():
    x, y, xy = moments(psf(Settings(**SHARP | {"motion_blur": 6.0, "motion_blur_angle": 30.0})))
    turn = np.deg2rad(30)
    expected = 3 * np.array([np.cos(turn) ** 2, np.sin(turn) ** 2, np.cos(turn) * np.sin(turn)])
    assert np.allclose((x, y, xy), expected, atol=0.05)


def test_blurs_add_their_variances():
    x, _, _ = moments(psf(Settings(**SHARP | {"defocus_radius": 2.0, "psf_sigma": 1.0})))
    assert x == pytest.approx(1 + 1, rel=0.03)


def test_a_sharp_truth_is_what_the_camera_sees_without_its_optics():
    blurred = simulate(
        settings=Settings(**SHARP | {"sharp": True, "defocus_radius": 2.0, "scale": 3.0}), seed=1
    )
    clear = simulate(settings=Settings(**SHARP | {"scale": 3.0}), seed=1)
    assert blurred.truth.scene.shape == (24, 32)
    assert blurred.frames[0].std() < blurred.truth.scene.std()
    assert clear.truth.psf.max() == pytest.approx(1)
