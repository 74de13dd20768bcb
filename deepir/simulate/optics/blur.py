"""Point-spread functions beside the Gaussian: diffraction, defocus, motion during the exposure."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import ndimage, signal, special

from deepir.simulate.settings import Settings

PSF_SAMPLES_PER_PIXEL = 5  # grid points of the truth's psf per detector px
AIRY_RINGS = 4  # first dark radii at which an Airy pattern is cut off: 95 % of its energy
KERNEL_SUBSAMPLES = 9  # samples of a kernel along the side of a grid point


def blur_picture(picture: np.ndarray, scale: float, settings: Settings) -> np.ndarray:
    """Blur a picture (height, width), `scale` px per detector px, by all but the Gaussian."""
    for each in _kernels(settings, scale):
        padded = np.pad(picture, [(side // 2,) * 2 for side in each.shape], mode="symmetric")
        picture = signal.fftconvolve(padded, each, mode="valid")
    return picture


def psf(settings: Settings) -> np.ndarray:
    """Point-spread function of the optics, (K, K), K odd, `PSF_SAMPLES_PER_PIXEL` points per px, sum one."""
    side = 2 * int(np.ceil(PSF_SAMPLES_PER_PIXEL * (blur_radius(settings) + 1))) + 1
    point = np.zeros((side, side))
    point[side // 2, side // 2] = 1
    for each in _kernels(settings, PSF_SAMPLES_PER_PIXEL):
        point = signal.fftconvolve(point, each, mode="same")
    found: np.ndarray = ndimage.gaussian_filter(
        point, settings.psf_sigma * PSF_SAMPLES_PER_PIXEL, mode="constant"
    )
    return found.clip(min=0) / found.clip(min=0).sum()


def blur_radius(settings: Settings) -> float:
    """Radius of the optics' blur, detector px."""
    return (
        3 * settings.psf_sigma
        + AIRY_RINGS * settings.airy_radius
        + settings.defocus_radius
        + settings.motion_blur / 2
    )


def _kernels(settings: Settings, scale: float) -> list[np.ndarray]:
    """The kernels in use, on a grid of `scale` points per detector px, each of sum one."""
    found = []
    if first := settings.airy_radius * scale:
        found.append(_drawn(lambda x, y: airy(np.hypot(x, y), first), AIRY_RINGS * first))
    if disc := settings.defocus_radius * scale:
        found.append(_drawn(lambda x, y: (np.hypot(x, y) <= disc).astype(float), disc))
    if settings.motion_blur:
        found.append(_line(settings.motion_blur * scale, np.deg2rad(settings.motion_blur_angle)))
    return found


def airy(r: np.ndarray, first: float) -> np.ndarray:
    """Diffraction at a round aperture, `(2 J1(v) / v)²`, of radii r, with its first dark ring at `first`."""
    v = special.jn_zeros(1, 1)[0] * r / first + 1e-9
    return np.asarray((2 * special.j1(v) / v) ** 2)


def _drawn(profile: Callable[[np.ndarray, np.ndarray], np.ndarray], radius: float) -> np.ndarray:
    """A profile, integrated over the area of each grid point."""
    side = 2 * int(np.ceil(radius)) + 3
    at = (np.arange(side * KERNEL_SUBSAMPLES) + 0.5) / KERNEL_SUBSAMPLES - side / 2
    fine = profile(at[None, :], at[:, None])
    kernel = fine.reshape(side, KERNEL_SUBSAMPLES, side, KERNEL_SUBSAMPLES).mean((1, 3))
    return np.asarray(kernel / kernel.sum())


def _line(length: float, angle: float) -> np.ndarray:
    """A straight line through the centre, distributed bilinearly over the grid points."""
    side = 2 * int(np.ceil(length / 2)) + 3
    along = length * ((np.arange(2000) + 0.5) / 2000 - 0.5)
    kernel = np.zeros((side, side))
    x, y = (side // 2 + along * turn for turn in (np.cos(angle), np.sin(angle)))
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    for i, weight_x in ((left, 1 - (x - left)), (left + 1, x - left)):
        for j, weight_y in ((top, 1 - (y - top)), (top + 1, y - top)):
            np.add.at(kernel, (j, i), weight_x * weight_y / 2000)
    return kernel
