"""Drawing with soft edges on a picture of radiant flux, for the built-in scenes."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from scipy import fft

Point = tuple[float, float]


def fractal_noise(
    rng: np.random.Generator, shape: tuple[int, int], slope: float, stretch: float = 1.0
) -> np.ndarray:
    """Noise of unit variance with amplitude ~ 1 / frequency**slope.

    Args:
        rng: Random stream.
        shape: Height and width.
        slope: Exponent of the amplitude.
        stretch: Length of the features along x over that along y.
    """
    height, width = (fft.next_fast_len(int(1.1 * n), real=True) for n in shape)  # larger: it must not wrap
    fy = fft.fftfreq(height)[:, None] * shape[0]  # cycles per picture height
    fx = fft.rfftfreq(width)[None, :] * shape[0] * stretch
    amplitude = (1.0 + fx**2 + fy**2) ** (-slope / 2)
    spectrum = amplitude * np.exp(2j * np.pi * rng.random(amplitude.shape))
    noise = fft.irfft2(spectrum, (height, width))[: shape[0], : shape[1]]
    return (noise - noise.mean()) / noise.std()


class Canvas:
    """A picture that is painted; lengths are in picture heights: x in [0, aspect] right, y in [0, 1] down."""

    def __init__(self, seed: int, shape: tuple[int, int]) -> None:
        self.rng, texture = np.random.default_rng(seed).spawn(2)  # the layout knows nothing of the shape
        self.shape, self.aspect = shape, shape[1] / shape[0]
        self.image = np.zeros(shape)
        self.rough = fractal_noise(texture, shape, 1.1)  # plaster, leaves, gravel
        self.soft = fractal_noise(texture, shape, 1.8, stretch=2.5)  # clouds, ground
        self.y, self.x = (np.arange(n) / shape[0] for n in shape)

    def vary(self, low: float, high: float) -> float:
        """A uniform random number."""
        return float(self.rng.uniform(low, high))

    def _window(
        self, points: Sequence[Point], margin: float
    ) -> tuple[tuple[slice, slice], np.ndarray, np.ndarray]:
        """The part of the array around some points, which is painted, and its coordinates x and y."""
        low = (np.min(points, axis=0) - margin) * self.shape[0] - 1
        high = (np.max(points, axis=0) + margin) * self.shape[0] + 2
        (x0, y0), (x1, y1) = np.maximum(low, 0).astype(int), np.maximum(high, 0).astype(int)
        return (slice(y0, y1), slice(x0, x1)), self.x[None, x0:x1], self.y[y0:y1, None]

    def _cover(
        self, at: tuple[slice, slice], distance: np.ndarray, value: np.ndarray | float, rough: float
    ) -> None:
        """Paint where the signed distance is negative, with an edge one pixel wide."""
        alpha = np.clip(0.5 - distance * self.shape[0], 0, 1)
        self.image[at] += alpha * (value + rough * self.rough[at] - self.image[at])

    def polygon(
        self, points: Sequence[Point], value: float, *, warmer: float = 0.0, rough: float = 0.01
    ) -> None:
        """A convex polygon, `warmer` at its lower end than at its upper."""
        at, x, y = self._window(points, 0)
        p, q = np.asarray(points, float), np.roll(np.asarray(points, float), -1, axis=0)
        turn = np.sign(np.sum(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]))
        normal = turn * np.stack([q[:, 1] - p[:, 1], p[:, 0] - q[:, 0]], 1) / np.hypot(*(q - p).T)[:, None]
        distance = np.full(np.broadcast_shapes(x.shape, y.shape), -np.inf)
        for (nx, ny), (px, py) in zip(normal, p, strict=True):
            np.maximum(distance, nx * (x - px) + ny * (y - py), out=distance)
        top, bottom = p[:, 1].min(), p[:, 1].max()
        self._cover(at, distance, value + warmer * (y - top) / (bottom - top), rough)

    def box(self, x: float, y: float, w: float, h: float, value: float, **look: float) -> None:
        """An upright rectangle from its upper left corner."""
        self.polygon([(x, y), (x + w, y), (x + w, y + h), (x, y + h)], value, **look)

    def rod(
        self, p: Point, q: Point, r: float, value: float, *, taper: float = 1.0, limb: float = 0.0
    ) -> None:
        """A line with round ends, `taper` times as thick at q; `limb` colder at its rim, like a pipe."""
        at, x, y = self._window([p, q], r * max(1.0, taper))
        dx, dy = q[0] - p[0], q[1] - p[1]
        along = np.clip(((x - p[0]) * dx + (y - p[1]) * dy) / max(dx * dx + dy * dy, 1e-12), 0, 1)
        off, radius = np.hypot(x - p[0] - along * dx, y - p[1] - along * dy), r * (1 + (taper - 1) * along)
        self._cover(at, off - radius, value - limb * np.minimum(off / radius, 1) ** 2, 0.005)

    def disc(self, x: float, y: float, r: float, value: float, *, limb: float = 0.0) -> None:
        """A rod of no length."""
        self.rod((x, y), (x, y), r, value, limb=limb)

    def path(self, points: Sequence[Point], r: float, value: float, *, limb: float = 0.0) -> None:
        """Rods end to end: wires, pipes."""
        for p, q in pairwise(points):
            self.rod(p, q, r, value, limb=limb)

    def blob(self, x: float, y: float, rx: float, ry: float, value: float, *, ragged: float = 0.25) -> None:
        """An ellipse with a ragged edge and texture: leaves, rocks, damp patches."""
        at, along, down = self._window([(x - rx, y - ry), (x + rx, y + ry)], 2 * ragged * max(rx, ry))
        radius = np.hypot((along - x) / rx, (down - y) / ry)
        self._cover(at, (radius - 1 + ragged * self.rough[at]) * min(rx, ry), value, 0.06)

    def glow(self, x: float, y: float, rx: float, ry: float, warmer: float) -> None:
        """A Gaussian spot of heat."""
        at, along, down = self._window([(x - rx, y - ry), (x + rx, y + ry)], 2 * max(rx, ry))
        self.image[at] += warmer * np.exp(-(((along - x) / rx) ** 2) - ((down - y) / ry) ** 2)

    def ground(
        self, edge: float, value: float, *, hills: float = 0.0, warmer: float = 0.0, rough: float = 0.03
    ) -> None:
        """Ground below a (hilly) skyline at height `edge`, rougher and `warmer` towards the viewer."""
        skyline = edge + hills * self.soft[int(self.vary(0, self.shape[0]))]
        depth = self.y[:, None] - skyline
        near = np.clip(depth / (1 - edge), 0, 1)
        self._cover(np.s_[:, :], -depth, value + warmer * near + rough * (0.4 + near) * self.soft, rough)

    def sky(self, zenith: float, horizon: float, height: float, clouds: float) -> None:
        """A sky: cold overhead, warmer towards the horizon, where the path through air is longer."""
        self.image[:] = zenith + (horizon - zenith) * np.clip(self.y[:, None] / height, 0, 1) ** 2
        self.image += clouds * np.maximum(self.soft, -0.3)
