"""Fourier ring correlation: which detail two halves agree in."""

import numpy as np
import pytest
from scipy import ndimage

from deepir.analysis.fourier_ring_correlation import THRESHOLD, fourier_ring_correlation

SIZE = (120, 150)


def noise(seed):
    return np.random.default_rng(seed).standard_normal(SIZE)


def test_the_same_picture_agrees_down_to_the_pixel():
    found = fourier_ring_correlation(noise(0), 3 * noise(0) + 5)
    np.testing.assert_allclose(found.correlation, 1)
    assert found.resolution == 2


def test_unrelated_pictures_agree_in_nothing():
    found = fourier_ring_correlation(noise(0), noise(1))
    assert abs(found.correlation[20:].mean()) < 0.03
    assert found.resolution > 20


@pytest.mark.parametrize("period", [4.0, 8.0])
def test_what_is_lost_in_noise_is_not_resolved(period):
    spectrum = np.fft.fft2(noise(0))
    radius = np.hypot(np.fft.fftfreq(SIZE[0])[:, None], np.fft.fftfreq(SIZE[1]))
    shared = np.fft.ifft2(np.where(radius < 1 / period, spectrum, 0)).real
    found = fourier_ring_correlation(shared + 0.05 * noise(1), shared + 0.05 * noise(2))
    assert found.resolution == pytest.approx(period, rel=0.1)


def test_the_correlation_is_that_of_signal_and_noise():
    """Of equal powers of both it is one half."""
    found = fourier_ring_correlation(noise(0) + noise(1), noise(0) + noise(2))
    assert found.correlation[20:].mean() == pytest.approx(0.5, abs=0.03)


def test_a_blur_of_both_changes_nothing():
    blurred = [ndimage.gaussian_filter(noise(0) + each, 0.7, mode="wrap") for each in (noise(1), noise(2))]
    found = fourier_ring_correlation(*blurred)
    assert found.correlation[40:].mean() == pytest.approx(0.5, abs=0.05)
    assert found.correlation[40:].min() > THRESHOLD
