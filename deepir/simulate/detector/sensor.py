"""The detector: its fixed pattern, its defects and its noise."""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from deepir.simulate.settings import Settings

ADC_MAX = 16383  # largest count of the 14-bit converter
NOISY_PIXEL_EXCESS = 99.0  # additional variance of a noisy pixel, in variances of its noise


class Defect(IntEnum):
    """Kinds of bad pixels; 0 is a good one."""

    LOW = 1  # stuck at zero
    HIGH = 2  # stuck at full scale
    FLICKERING = 3
    STUCK = 4  # stuck at a value within the scene's range
    NOISY = 5


def fixed_pattern(
    settings: Settings, rng: np.random.Generator, shading_rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gain, offset (data units) and the defects of `dead_pixels`, (H, W) each.

    Args:
        settings: The camera.
        rng: Random stream of the pattern.
        shading_rng: Random stream of the gain's shading.
    """
    height, width = settings.shape
    layout = ((height, width), (1, width), (height, 1))
    sigmas = (settings.gain_pixel, settings.gain_column, settings.gain_row)
    normal, uniform = ([draw(size) for size in layout] for draw in (rng.standard_normal, rng.random))
    parts = normal if settings.gain_distribution == "normal" else [-part for part in uniform]
    gain = np.maximum(1 + sum(s * part for s, part in zip(sigmas, parts, strict=True)), 0.05)
    smooth = shading(settings.gain_shading, settings.shape, shading_rng)
    gain = gain * (1 + smooth - smooth.mean())

    sigmas = (settings.offset_pixel, settings.offset_column, settings.offset_row)
    offset = sum(s * rng.standard_normal(size) for s, size in zip(sigmas, layout, strict=True))
    offset = settings.range * (offset + shading(settings.shading, settings.shape, rng))

    bad = np.zeros((height, width), np.uint8)
    defects = rng.permutation(bad.size)[: round(settings.dead_pixels * bad.size)]
    bad.flat[defects] = np.arange(defects.size) % 3 + Defect.LOW
    return gain, offset, bad


def shading(peak_to_peak: float, shape: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    """A random quadratic (H, W) with a given range."""
    y, x = np.linspace(-1, 1, shape[0])[:, None], np.linspace(-1, 1, shape[1])
    smooth = np.tensordot(rng.standard_normal(5), np.stack(np.broadcast_arrays(x, y, x * y, x * x, y * y)), 1)
    return peak_to_peak * smooth / np.ptp(smooth)


def add_defects(bad: np.ndarray, settings: Settings, rng: np.random.Generator) -> np.ndarray:
    """Defects (H, W) with those of `stuck_pixels` and `noisy_pixels` added among the good pixels."""
    places = rng.permutation(np.flatnonzero(bad == 0))
    stuck = round(settings.stuck_pixels * bad.size)
    noisy = round(settings.noisy_pixels * bad.size)
    bad = bad.copy()
    bad.flat[places[:stuck]], bad.flat[places[stuck : stuck + noisy]] = Defect.STUCK, Defect.NOISY
    return bad


def expose(
    flux: np.ndarray,
    gain: np.ndarray,
    offset: np.ndarray,
    level: np.ndarray,
    bad: np.ndarray,
    settings: Settings,
    rng: np.random.Generator,
    defects_rng: np.random.Generator,
) -> np.ndarray:
    """Data of a flux: pattern, noise, defects, converter.

    Args:
        flux: (N, H, W), data units.
        gain: (H, W).
        offset: (H, W) or (N, H, W), data units.
        level: (N,), data units.
        bad: (H, W), kinds of defects.
        settings: The camera.
        rng: Random stream of the noise.
        defects_rng: Random stream of the defects' values.

    Returns:
        (N, H, W), float32, or uint16 counts.
    """
    read, photons = settings.read_noise * settings.range, settings.photons / settings.range
    clean = gain * flux
    frames = rng.poisson(np.maximum(clean, 0) * photons) / photons if photons else clean
    frames = frames + offset + level[:, None, None] + read * rng.standard_normal(flux.shape)
    frames += 0.3 * settings.range * (bad == Defect.FLICKERING) * rng.choice([-1, 0, 1], size=flux.shape)
    frames[:, bad == Defect.LOW] = 0
    frames[:, bad == Defect.HIGH] = ADC_MAX if settings.counts else 2.0
    if (stuck := bad == Defect.STUCK).any():
        frames[:, stuck] = defects_rng.uniform(flux[0].min(), flux[0].max(), int(stuck.sum()))
    if (noisy := bad == Defect.NOISY).any():
        variance = read**2 + (np.maximum(clean[:, noisy], 0) / photons if photons else 0.0)
        frames[:, noisy] += np.sqrt(NOISY_PIXEL_EXCESS * variance) * defects_rng.standard_normal(
            (len(flux), noisy.sum())
        )
    if settings.counts:
        return np.clip(np.rint(frames), 0, ADC_MAX).astype(np.uint16)
    return frames.astype(np.float32)
