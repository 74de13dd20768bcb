"""Objects that are drawn into simulated scenes."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from scipy import fft

Point = tuple[float, float]


def fractal_noise(rng: np.random.Generator, shape: tuple[int, int], slope: float, stretch: float = 1.0) -> np.ndarray:
    """Noise of unit variance with amplitude ~ 1 / frequency**slope; features are `stretch` times as long along x."""
    height, width = (fft.next_fast_len(int(1.1 * n), real=True) for n in shape)  # larger: it must not wrap
    fy = fft.fftfreq(height)[:, None] * shape[0]  # cycles per picture height
    fx = fft.rfftfreq(width)[None, :] * shape[0] * stretch
    amplitude = (1.0 + fx**2 + fy**2) ** (-slope / 2)
    spectrum = amplitude * np.exp(2j * np.pi * rng.random(amplitude.shape))
    noise = fft.irfft2(spectrum, (height, width))[: shape[0], : shape[1]]
    return (noise - noise.mean()) / noise.std()


def distance_from_line(x: np.ndarray, y: np.ndarray, p: Point, q: Point) -> tuple[np.ndarray, np.ndarray]:
    """Distance of points from a line that ends at p and q, and where along it is nearest, from 0 to 1."""
    dx, dy = q[0] - p[0], q[1] - p[1]
    along = np.clip(((x - p[0]) * dx + (y - p[1]) * dy) / max(dx * dx + dy * dy, 1e-12), 0, 1)
    return np.hypot(x - p[0] - along * dx, y - p[1] - along * dy), along


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

    def _window(self, points: Sequence[Point], margin: float) -> tuple[tuple[slice, slice], np.ndarray, np.ndarray]:
        """The part of the array around some points, which is painted, and its coordinates x and y."""
        low = (np.min(points, axis=0) - margin) * self.shape[0] - 1
        high = (np.max(points, axis=0) + margin) * self.shape[0] + 2
        (x0, y0), (x1, y1) = np.maximum(low, 0).astype(int), np.maximum(high, 0).astype(int)
        return (slice(y0, y1), slice(x0, x1)), self.x[None, x0:x1], self.y[y0:y1, None]

    def _cover(self, at: tuple[slice, slice], distance: np.ndarray, value: np.ndarray | float, rough: float) -> None:
        """Paint where the signed distance is negative, with an edge one pixel wide."""
        alpha = np.clip(0.5 - distance * self.shape[0], 0, 1)
        self.image[at] += alpha * (value + rough * self.rough[at] - self.image[at])

    def polygon(self, points: Sequence[Point], value: float, *, warmer: float = 0.0, rough: float = 0.01) -> None:
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

    def rod(self, p: Point, q: Point, r: float, value: float, *, taper: float = 1.0, limb: float = 0.0) -> None:
        """A line with round ends, `taper` times as thick at q; `limb` colder at its rim, like a pipe."""
        at, x, y = self._window([p, q], r * max(1.0, taper))
        off, along = distance_from_line(x, y, p, q)
        radius = r * (1 + (taper - 1) * along)
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


def person(c: Canvas, x: float, y: float, h: float, stride: float) -> None:
    """Feet at (x, y); skin is hotter than clothes, a coat cooler than legs."""
    coat = c.vary(0.7, 0.82)
    for side in (-1, 1):
        hip, foot = (x + 0.035 * side * h, y - 0.48 * h), (x + side * stride * h, y - 0.02 * h)
        c.rod(hip, foot, 0.058 * h, 0.76, taper=0.55, limb=0.1)
        c.rod(foot, (foot[0] + 0.05 * h, foot[1] + 0.01 * h), 0.025 * h, 0.6)
        hand = (x - side * (0.08 + 0.8 * stride) * h, y - 0.45 * h)
        c.disc(*hand, 0.026 * h, 0.93)
        c.rod(
            (x - side * 0.07 * h, y - 0.78 * h), (hand[0], hand[1] - 0.02 * h), 0.038 * h, coat, taper=0.75, limb=0.08
        )
    c.rod((x, y - 0.85 * h), (x, y - 0.8 * h), 0.035 * h, 0.92)
    c.rod((x, y - 0.75 * h), (x, y - 0.5 * h), 0.098 * h, coat + 0.02, taper=0.85, limb=0.09)
    c.rod((x, y - 0.94 * h), (x + 0.006 * h, y - 0.9 * h), 0.055 * h, 0.97, taper=0.85, limb=0.07)
    c.rod((x - 0.008 * h, y - 0.965 * h), (x - 0.03 * h, y - 0.94 * h), 0.036 * h, 0.86, taper=0.6)


def deer(c: Canvas, x: float, y: float, h: float, way: int) -> None:
    """Feet at height y, looking left (-1) or right (1)."""
    for leg, lean in ((-0.46, -0.06), (-0.36, 0.05), (0.27, -0.05), (0.4, 0.08)):
        c.rod((x + way * leg * h, y - 0.45 * h), (x + way * (leg + lean) * h, y), 0.05 * h, 0.8, taper=0.4)
    c.rod((x - way * 0.36 * h, y - 0.56 * h), (x + way * 0.34 * h, y - 0.57 * h), 0.18 * h, 0.9, limb=0.18)
    c.rod((x + way * 0.4 * h, y - 0.6 * h), (x + way * 0.58 * h, y - 0.95 * h), 0.1 * h, 0.9, taper=0.5, limb=0.1)
    c.rod((x + way * 0.58 * h, y - 0.97 * h), (x + way * 0.76 * h, y - 0.9 * h), 0.075 * h, 0.96, taper=0.5)
    c.rod((x + way * 0.55 * h, y - h), (x + way * 0.47 * h, y - 1.1 * h), 0.03 * h, 0.84, taper=0.5)


def tree(c: Canvas, x: float, y: float, h: float, value: float) -> None:
    """A stem at (x, y) and a crown of leaves, warmer below; h is its height."""
    c.rod((x, y), (x + 0.04 * h, y - 0.7 * h), 0.035 * h, value + 0.14, taper=0.5, limb=0.06)
    for _ in range(14):
        dx, dy = c.vary(-0.27, 0.27) * h, c.vary(-0.27, 0.25) * h
        c.blob(x + dx, y - 0.7 * h + dy, 0.15 * h, 0.12 * h, value + 0.25 * dy / h + c.vary(-0.04, 0.04))


def window(c: Canvas, x: float, y: float, w: float, h: float) -> None:
    """A pane in its frame: a cold mirror of the sky or a warm room, with or without blind and bar."""
    pane = c.vary(0.66, 0.85) if c.vary(0, 1) < 0.35 else c.vary(0.16, 0.34)
    c.box(x - 0.1 * w, y - 0.06 * h, 1.2 * w, 1.14 * h, c.vary(0.53, 0.64))
    c.box(x, y, w, h, pane, warmer=c.vary(-0.08, 0.14), rough=0.004)
    if c.vary(0, 1) < 0.4:
        c.box(x, y, w, h * c.vary(0.2, 0.8), c.vary(0.4, 0.55))
    if c.vary(0, 1) < 0.7:
        c.box(x + w * c.vary(0.4, 0.55), y, 0.07 * w, h, 0.5)


def house(c: Canvas, x: float, y: float, w: float, h: float) -> None:
    """Storeys of windows under a cold roof with a hot chimney; (x, y) is the lower left corner."""
    top, chimney = y - h, x + w * c.vary(0.2, 0.7)
    c.box(chimney, top - 0.13, 0.025, 0.12, 0.5)
    c.box(chimney - 0.004, top - 0.14, 0.033, 0.012, 0.9)
    peak = (x + w * c.vary(0.3, 0.7), top - c.vary(0.06, 0.11))
    c.polygon([(x - 0.01, top), peak, (x + w + 0.01, top)], c.vary(0.2, 0.3), warmer=0.12, rough=0.02)
    c.box(x, top, w, h, c.vary(0.36, 0.54), warmer=0.08, rough=0.02)
    c.box(x - 0.01, top - 0.004, w + 0.02, 0.01, 0.6)
    columns, floors = max(2, round(w / 0.085)), max(2, round(h / 0.13))
    for i in range(columns):
        for j in range(floors):
            left = x + w / columns * (i + c.vary(0.2, 0.32))
            upper = top + h / floors * (j + c.vary(0.2, 0.28))
            window(c, left, upper, 0.48 * w / columns, h / floors * c.vary(0.45, 0.58))
    c.glow(x + w * c.vary(0, 1), top + h * c.vary(0.3, 0.9), 0.05, 0.03, 0.12)


def car(c: Canvas, x: float, y: float, s: float) -> None:
    """Seen from the side, wheels at height y, its hot engine at the right; s is its length."""

    def panel(points: Sequence[Point], value: float, warmer: float) -> None:
        c.polygon([(x + u * s, y - v * s) for u, v in points], value, warmer=warmer)

    c.glow(x + 0.5 * s, y, 0.45 * s, 0.025 * s, 0.18)
    panel([(0.12, 0.23), (0.27, 0.38), (0.57, 0.38), (0.74, 0.23)], 0.4, 0.05)
    panel([(0.19, 0.24), (0.29, 0.355), (0.41, 0.355), (0.42, 0.24)], 0.2, 0.1)
    panel([(0.45, 0.24), (0.44, 0.355), (0.56, 0.355), (0.68, 0.24)], 0.22, 0.1)
    panel([(0.0, 0.08), (0.01, 0.21), (0.12, 0.25), (0.7, 0.25), (0.97, 0.18), (1.0, 0.08)], 0.45, 0.08)
    c.glow(x + 0.84 * s, y - 0.17 * s, 0.11 * s, 0.045 * s, 0.36)
    c.rod((x + 0.3 * s, y - 0.19 * s), (x + 0.33 * s, y - 0.19 * s), 0.006 * s, 0.32)
    c.disc(x + 0.965 * s, y - 0.15 * s, 0.022 * s, 0.8)
    for wheel in (0.19, 0.8):
        c.disc(x + wheel * s, y - 0.075 * s, 0.1 * s, 0.26)
        c.disc(x + wheel * s, y - 0.075 * s, 0.085 * s, 0.55, limb=0.1)
        c.disc(x + wheel * s, y - 0.075 * s, 0.045 * s, 0.8, limb=0.12)
    c.rod((x - 0.01 * s, y - 0.06 * s), (x + 0.03 * s, y - 0.06 * s), 0.011 * s, 0.97)


def wires(c: Canvas, y: float, n: int) -> None:
    """Power lines across the picture that sag from heights near y."""
    t = np.linspace(0, 1, 24)
    for _ in range(n):
        line = y + c.vary(-0.08, 0.08) * (1 - t) + c.vary(-0.08, 0.08) * t + c.vary(0.16, 0.4) * t * (1 - t)
        c.path(list(zip(t * c.aspect, line, strict=True)), 0.0016, c.vary(0.3, 0.42))
