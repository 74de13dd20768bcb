"""Counts to kelvin: linear, as with TLinear output, or by Planck's law."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np

from deepir.arrays import Array
from deepir.config import schema
from deepir.errors import ConfigError, DataError
from deepir.io.guards import warn_once

ZERO_CELSIUS = 273.15  # K


@dataclass(frozen=True)
class Linear:
    """Kelvin = `scale` counts + `zero`."""

    scale: float  # K per count: 0.01 for TLinear (K x 100), 0.04 and 0.1 elsewhere, 1 for data in kelvin
    zero: float = 0.0  # K at zero counts; 273.15 with scale 1 for data in degrees Celsius

    def kelvin(self, counts: Array) -> Array:
        """Temperature of counts of any shape, K, float32."""
        return (self.scale * counts.astype(np.float64) + self.zero).astype(np.float32)

    def counts(self, kelvin: Array) -> Array:
        """Counts of temperatures of any shape, float32."""
        return ((kelvin.astype(np.float64) - self.zero) / self.scale).astype(np.float32)

    def __str__(self) -> str:
        return f"{self.scale:g} K a count" + (f" from {self.zero:g} K" if self.zero else "")


@dataclass(frozen=True)
class Planck:
    """A calibrated camera that sees a reflecting surface through air and perhaps a window.

    A black body at T gives `r1 / (r2 (exp(b / T) - f)) - o` counts; FLIR's `o` is negative. The camera receives the
    fraction `emissivity transmission window_transmission` of the surface's signal. The rest comes from the surroundings
    at `reflected`, the air at `atmosphere` and the window at `window`, K.

    Source: Usamentiaga et al., Infrared thermography for temperature measurement and non-destructive testing, Sensors
    14 (2014).
    """

    r1: float
    b: float
    f: float = 1.0
    o: float = 0.0
    r2: float = 1.0
    emissivity: float = 1.0
    reflected: float = 293.15
    transmission: float = 1.0
    atmosphere: float = 293.15
    window_transmission: float = 1.0
    window: float = 293.15

    def kelvin(self, counts: Array) -> Array:
        """Temperature of counts of any shape, K, float32; NaN where the signal is below that of any temperature."""
        own = (counts.astype(np.float64) + self.o - self._surroundings()) / self._share()
        with np.errstate(all="ignore"):
            kelvin = self.b / np.log(self.r1 / (self.r2 * own) + self.f)
        return np.where(own > 0, kelvin, np.nan).astype(np.float32)

    def counts(self, kelvin: Array) -> Array:
        """Counts of temperatures of any shape, float32; NaN where there is none."""
        own = self.signal(kelvin.astype(np.float64))
        with np.errstate(over="ignore"):
            return np.asarray(own * self._share() + self._surroundings() - self.o).astype(np.float32)

    def signal(self, kelvin: float | Array) -> Any:
        """Counts of a black body at `kelvin` above zero signal (`-o`)."""
        with np.errstate(all="ignore"):  # of nonsense, infinity
            return self.r1 / (self.r2 * (np.exp(self.b / kelvin) - self.f))

    def _share(self) -> float:
        """Of the surface's signal that reaches the camera."""
        return self.window_transmission * self.transmission * self.emissivity

    def _surroundings(self) -> float:
        """Signal of all else: what the surface reflects, the air and the window."""
        air, glass = self.transmission, self.window_transmission
        around = glass * air * (1 - self.emissivity) * self.signal(self.reflected)
        around += glass * (1 - air) * self.signal(self.atmosphere) + (1 - glass) * self.signal(self.window)
        return float(around)

    def __str__(self) -> str:
        return (
            f"Planck's law, emissivity {self.emissivity:.3g}, surroundings at {self.reflected - ZERO_CELSIUS:.1f} °C, "
            f"air {self.transmission:.3f} at {self.atmosphere - ZERO_CELSIUS:.1f} °C"
        )


Radiometry = Linear | Planck
KELVIN = Linear(1.0)  # radiometry of data in kelvin


def unit_metadata(radiometry: Radiometry | None) -> dict[str, Any]:
    """Unit of values as metadata of a file: `{"unit": "K"}`, or counts with their radiometry."""
    if radiometry is None:
        return {}
    if radiometry == KELVIN:
        return {"unit": "K"}
    return {"unit": "counts", "radiometry": asdict(radiometry)}


def air_transmission(
    distance: float,
    humidity: float,
    kelvin: float,
    alphas: tuple[float, float],
    betas: tuple[float, float],
    weight: float,
) -> float:
    """Transmission of air.

    Args:
        distance: m.
        humidity: Relative humidity, 0 to 1.
        kelvin: Temperature, K.
        alphas: Attenuation of the two bands without water vapour.
        betas: Attenuation of the two bands by water vapour.
        weight: Weight of the first band.

    Source: FLIR's model; Minkina and Dudzik, Infrared Thermography: Errors and Uncertainties (2009).
    """
    celsius = kelvin - ZERO_CELSIUS
    water = humidity * math.exp(1.5587 + 6.939e-2 * celsius - 2.7816e-4 * celsius**2 + 6.8455e-7 * celsius**3)
    bands = [
        math.exp(-math.sqrt(distance) * (alpha + beta * math.sqrt(water)))
        for alpha, beta in zip(alphas, betas, strict=True)
    ]
    return weight * bands[0] + (1 - weight) * bands[1]


def resolve_radiometry(found: Radiometry | None, asked: schema.Radiometry) -> Radiometry | None:
    """The radiometry of a file with the user's settings in place of its own.

    Args:
        found: Radiometry of the file.
        asked: The user's settings (`data.radiometry`).

    Raises:
        ConfigError: A scale is given together with Planck's law, or a law without its constants.
    """
    given = asked.model_dump(exclude_none=True)
    law = Linear if {"scale", "zero"} & given.keys() else Planck
    if not given:
        return found
    known = (asdict(found) if isinstance(found, law) else {}) | given
    if wrong := given.keys() - {each.name for each in fields(law)}:
        raise ConfigError(f"data.radiometry: scale and {min(wrong)} exclude each other: a scale or Planck's law")
    if missing := [name for name in ("scale", "r1", "b") if name in law.__annotations__ and name not in known]:
        raise ConfigError(
            f"data.radiometry: {min(given)} needs {' and '.join(missing)} too: the file says nothing of kelvin"
        )
    return law(**known)


def as_of_frame_0(
    frames: Iterable[Array], laws: Sequence[Radiometry | None], asked: schema.Radiometry | None, source: str
) -> Iterator[Array]:
    """Frames, float32, in the counts that frame 0 would have given of the same temperatures.

    Args:
        frames: (h, w).
        laws: Radiometry of each frame.
        asked: The user's settings.
        source: The file, for messages.
    """
    laws = [resolve_radiometry(law, asked or schema.Radiometry()) for law in laws]
    first = laws[0]
    for frame, law in zip(frames, itertools.chain(laws, itertools.repeat(laws[-1])), strict=False):
        if law == first:
            yield frame.astype(np.float32)
            continue
        if first is None or law is None:
            raise DataError(f"{source}: only some of its frames say what kelvin are; give data.radiometry.scale=...")
        warn_once(
            f"{source}: what makes kelvin of counts changes, {_change(first, laws)}; the counts of such frames are "
            "converted to those of frame 0"
        )
        yield first.counts(law.kelvin(frame))


def _change(first: Radiometry, laws: Sequence[Radiometry | None]) -> str:
    """The first frame whose radiometry is another, and how, in words."""
    number, other = next((k, law) for k, law in enumerate(laws) if law not in (first, None))
    before, after = vars(first), vars(other)
    what = [f"{each} {before.get(each)}, then {after[each]}" for each in after if before.get(each) != after[each]]
    return f"at frame {number} first ({'; '.join(what)})"
