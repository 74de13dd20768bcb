"""Objects of the drawn scenes: people, animals, trees, houses, cars."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from deepir.simulate.scenes.drawing import Canvas, Point


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
            (x - side * 0.07 * h, y - 0.78 * h),
            (hand[0], hand[1] - 0.02 * h),
            0.038 * h,
            coat,
            taper=0.75,
            limb=0.08,
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
    c.rod(
        (x + way * 0.4 * h, y - 0.6 * h),
        (x + way * 0.58 * h, y - 0.95 * h),
        0.1 * h,
        0.9,
        taper=0.5,
        limb=0.1,
    )
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
            left, upper = (
                x + w / columns * (i + c.vary(0.2, 0.32)),
                top + h / floors * (j + c.vary(0.2, 0.28)),
            )
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
