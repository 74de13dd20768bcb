"""The detector from its physics: thermal and electrical constants of its pixels (docs/explanation/sensor-physics.md).

Source: Saragadam et al. 2021, "Sensor modeling".
"""

from __future__ import annotations

import numpy as np

from deepir.simulate.settings import Settings

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


def bolometer_pixels(
    settings: Settings, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gain, offset and relative time constants of the pixels.

    `g = I α β R / G`, `o = -g Φ_fpa`, `τ = C / G`; the readout subtracts the mean pixel's offset.

    Returns:
        Gain, offset (data units) and time constants over their mean, (H, W) each.
    """

    def relative(name: str) -> np.ndarray:
        return np.maximum(1 + CONSTANT_SIGMAS[name] * rng.standard_normal(settings.shape), 0.05)

    alpha, beta, resistance = (
        relative("absorption"),
        relative("temperature coefficient"),
        relative("resistance"),
    )
    conductance, capacity = relative("conductance"), relative("capacity")
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
