"""The detector of a simulated camera: bolometers, thermal lag, line noise, gain and offset."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from enum import IntEnum

import numpy as np

from deepir.simulate.settings import RecordingSettings, Settings

#: Relative standard deviations of the constants from pixel to pixel; of the bias current, from column to column.
CONSTANT_SIGMAS = {
    "absorption": 0.01,
    "temperature coefficient": 0.005,
    "resistance": 0.01,
    "conductance": 0.02,
    "capacity": 0.01,
    "current": 0.01,
}
PIXEL_EMISSION = 0.5  # flux that a pixel emits itself, above that of scene value 0, in ranges
LENS_SHARE = 0.2  # share of a pixel's view that is lens, at f/1
CORNER_ANGLE = 20.0  # degrees from the axis to the frame's corner
TREMOR_WAVES = 4  # sinusoids in the path of each motion parameter
ADC_MAX = 16383  # largest count of the 14-bit converter
NOISY_PIXEL_EXCESS = 99.0  # additional variance of a noisy pixel, in variances of its noise

Camera = Settings | RecordingSettings


def bolometer_pixels(settings: Settings, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gain, offset and relative time constants of the pixels.

    `g = I α β R / G`, `o = -g Φ_fpa`, `τ = C / G`; the readout subtracts the mean pixel's offset.

    Returns:
        Gain, offset (data units) and time constants over their mean, (H, W) each.
    """

    def relative(name: str) -> np.ndarray:
        return np.maximum(1 + CONSTANT_SIGMAS[name] * rng.standard_normal(settings.shape), 0.05)

    names = ("absorption", "temperature coefficient", "resistance", "conductance", "capacity")
    alpha, beta, resistance, conductance, capacity = map(relative, names)
    current = 1 + CONSTANT_SIGMAS["current"] * rng.standard_normal((1, settings.shape[1]))
    gain = current * alpha * beta * resistance / conductance
    gain, slowness = gain / gain.mean(), capacity / conductance
    own = PIXEL_EMISSION * settings.range + (settings.pedestal if settings.counts else 0.0)
    return gain, (1 - gain) * own, slowness / slowness.mean()


def housing_flux(settings: Settings) -> np.ndarray:
    """Flux of a warming housing above that of the first frame, (N, H, W), data units.

    A pixel sees the housing outside the lens, whose solid angle falls with the fourth power of the cosine.
    """
    y, x = (np.linspace(-1, 1, side) for side in settings.shape)
    off_axis = np.hypot(x, y[:, None]) / np.sqrt(2)
    cosine = np.cos(np.arctan(off_axis * np.tan(np.deg2rad(CORNER_ANGLE))))
    seen = (1 - LENS_SHARE * cosine**4) / (1 - LENS_SHARE)
    time = np.arange(settings.n_frames) / settings.fps
    return settings.range * settings.housing_drift * time[:, None, None] * seen


def line_noise(settings: Settings, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Row noise (N, H) and column noise (N, W) of each frame, in the data's units."""
    sigmas = (settings.row_noise, settings.column_noise)
    rows, columns = (
        settings.range * sigma * rng.standard_normal((settings.n_frames, side))
        for sigma, side in zip(sigmas, settings.shape, strict=True)
    )
    return rows, columns


def smooth_path(settings: Settings, rng: np.random.Generator) -> np.ndarray:
    """A smooth random path of the nine motion parameters, at `substeps` instants for each frame after the first.

    Returns:
        (I, 9), in [-1, 1]; zero at the first instant.
    """
    time = np.arange((settings.n_frames - 1) * settings.substeps + 1) / (settings.substeps * settings.fps)
    rate = 2 * np.pi * settings.tremor * rng.uniform(0.1, 1, (TREMOR_WAVES, 9))
    phase, size = rng.uniform(0, 2 * np.pi, (TREMOR_WAVES, 9)), rng.uniform(0.2, 1, (TREMOR_WAVES, 9))
    found = (size * np.sin(rate * time[:, None, None] + phase)).sum(1)
    found -= found[0]
    return found / np.abs(found).max(0).clip(min=1e-12)


def time_constants(settings: Settings, rng: np.random.Generator) -> np.ndarray:
    """Time constant of each pixel (H, W), ms."""
    factors = 1 + settings.tau_pixel * rng.standard_normal(settings.shape)
    return settings.tau * factors.clip(min=0.2)


def lagged(flux: Iterable[np.ndarray], step: np.ndarray | float) -> Iterator[np.ndarray]:
    """What pixels that lag show at each instant: `tau dy/dt = x - y`, exact for a flux that is linear between two.

    Before the first instant the pixels have settled.

    Args:
        flux: (H, W) at each of the instants.
        step: Time between two instants, in time constants: of all pixels, or of each, (H, W).
    """
    kept = np.exp(-step)
    new = 1 - (1 - kept) / step
    old = 1 - kept - new
    instants = iter(flux)
    shown = before = next(instants)
    yield shown
    for now in instants:
        shown, before = kept * shown + old * before + new * now, now
        yield shown


def rolling_readout(shown: np.ndarray, settings: Settings) -> np.ndarray:
    """Frames (N, H, W) whose rows are read from the instants (I, H, W), the last row at the end of its frame."""
    height = settings.shape[0]
    early = settings.substeps * settings.readout * (1 - np.arange(1, height + 1) / height)
    at = np.arange(settings.n_frames)[:, None] * settings.substeps - early
    at = at.clip(min=0)  # (N, H)
    first = np.minimum(at.astype(int), len(shown) - 2 if len(shown) > 1 else 0)
    part = (at - first)[..., None]
    rows = np.arange(height)
    return (1 - part) * shown[first, rows] + part * shown[np.minimum(first + 1, len(shown) - 1), rows]


class Defect(IntEnum):
    """Kinds of bad pixels; 0 is a good one."""

    LOW = 1  # stuck at zero
    HIGH = 2  # stuck at full scale
    FLICKERING = 3
    STUCK = 4  # stuck at a value within the scene's range
    NOISY = 5


def fixed_pattern(
    settings: Camera, rng: np.random.Generator, shading_rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gain, offset (data units) and defects of `dead_pixels`, (H, W) each; the gain's shading has its own stream."""
    sigmas = (settings.gain_pixel, settings.gain_column, settings.gain_row)
    normal, uniform = (sensor_parts(settings.shape, draw) for draw in (rng.standard_normal, rng.random))
    parts = normal if settings.gain_distribution == "normal" else [-part for part in uniform]
    gain = np.maximum(1 + sum(s * part for s, part in zip(sigmas, parts, strict=True)), 0.05)
    smooth = shading(settings.gain_shading, settings.shape, shading_rng)
    gain = gain * (1 + smooth - smooth.mean())

    sigmas = (settings.offset_pixel, settings.offset_column, settings.offset_row)
    parts = sensor_parts(settings.shape, rng.standard_normal)
    offset = sum(s * part for s, part in zip(sigmas, parts, strict=True))
    offset = settings.range * (offset + shading(settings.shading, settings.shape, rng))

    bad = np.zeros(settings.shape, np.uint8)
    defects = rng.permutation(bad.size)[: round(settings.dead_pixels * bad.size)]
    bad.flat[defects] = np.arange(defects.size) % 3 + Defect.LOW
    return gain, offset, bad


def sensor_parts(shape: tuple[int, int], draw: Callable[[tuple[int, int]], np.ndarray]) -> list[np.ndarray]:
    """Random numbers of all pixels (H, W), columns (1, W) and rows (H, 1)."""
    height, width = shape
    return [draw(size) for size in ((height, width), (1, width), (height, 1))]


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
    settings: Camera,
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
