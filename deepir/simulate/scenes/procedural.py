"""Scenes of simulated cameras: pictures, and procedural ones."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from deepir.errors import DataError, nearest
from deepir.paths import expanded
from deepir.simulate.scenes.objects import Canvas, car, deer, house, person, tree, window, wires

#: Pictures that scikit-image ships.
SKIMAGE_PICTURES = ("astronaut", "brick", "camera", "cell", "chelsea", "clock", "coffee", "coins", "grass", "gravel",
    "hubble_deep_field", "immunohistochemistry", "moon", "page", "retina", "rocket", "stereo_motorcycle", "text",
)  # fmt: skip

Scene = np.ndarray[Any, Any] | Callable[[tuple[int, int]], np.ndarray[Any, Any]]


def load_picture(name: str) -> Scene | list[Scene]:
    """A scene by name.

    Args:
        name: A file, `procedural:SEED`, `sky:SEED`, or a picture of scikit-image: `camera`. Several, separated by
            commas, make a list.

    Returns:
        A grey picture (height, width), its range stretched to [0, 1], or a function that draws one of a given shape.

    Raises:
        DataError: There is none of that name, or it is not a picture.
    """
    if "," in name and not Path(name).exists():
        return [each for part in name.split(",") if not isinstance(each := load_picture(part.strip()), list)]
    kind, _, seed = name.partition(":")
    if kind in DRAWN_SCENES and seed.isdecimal():
        return partial(DRAWN_SCENES[kind], int(seed))
    if name in SKIMAGE_PICTURES and not Path(name).exists():
        return _stretched_picture(_shipped(name), name)
    if not (Path(name).suffix or expanded(name).exists()):
        raise DataError(
            f"scene: no picture is called '{name}'; {nearest(name, SKIMAGE_PICTURES)}, "
            "procedural:SEED, sky:SEED or a file"
        )
    from deepir.io import read_frames

    frames = read_frames(name).frames
    if len(frames) != 1:
        raise DataError(f"{name}: a scene is one picture, this has {len(frames)}")
    return _stretched_picture(frames[0].astype(np.float64), name)


def _shipped(name: str) -> np.ndarray[Any, Any]:
    import skimage.data
    from skimage.color import rgb2gray

    found = getattr(skimage.data, name)()
    whole = np.asarray(found[0] if isinstance(found, tuple) else found) / 255  # a stereo pair's left one
    return rgb2gray(whole) if whole.ndim == 3 else whole


def _stretched_picture(whole: np.ndarray[Any, Any], name: str) -> np.ndarray[Any, Any]:
    if not (np.isfinite(whole).all() and np.ptp(whole) > 0):
        raise DataError(f"{name}: a scene is a picture that is finite and not constant")
    return _stretched(whole)


def procedural(seed: int = 0, shape: tuple[int, int] = (512, 640)) -> np.ndarray:
    """Draw a thermal-looking picture with smooth regions, fine texture and sharp edges.

    The seed chooses the kind, `SCENE_PAINTERS[seed % 4]` (street, house front, machinery, landscape), and its layout,
    which scales with the picture's height; only the texture depends on the number of pixels. Edges are
    anti-aliased.

    Args:
        seed: Any non-negative integer; the same seed and shape give the same picture.
        shape: Height and width in pixels.

    Returns:
        Radiant flux (height, width), float64: 0 is the coldest point of the picture and 1 the hottest.
    """
    canvas = Canvas(seed, shape)
    SCENE_PAINTERS[seed % len(SCENE_PAINTERS)](canvas)
    return _stretched(canvas.image + 0.005 * canvas.rough)


def sky(seed: int = 0, shape: tuple[int, int] = (512, 640)) -> np.ndarray:
    """Draw a sky: smooth except for faint clouds, a few birds, and a strip of land with a mast at the bottom.

    The hard case of a camera that looks up: few edges for the registration, and smooth gradients only for the pattern.
    Land and mast span the upper half of the range. Arguments and result are those of `procedural`.
    """
    c = Canvas(seed, shape)
    c.sky(0.05, c.vary(0.35, 0.45), 0.88, 0.015)
    for _ in range(4):
        x, y, span = c.vary(0.1, 0.9) * c.aspect, c.vary(0.25, 0.75), c.vary(0.01, 0.025)
        for side in (-1, 1):
            c.rod((x, y), (x + side * span, y - c.vary(0.1, 0.5) * span), 0.18 * span, 0.6, taper=0.4)
    horizon = c.vary(0.85, 0.88)
    mast = c.aspect * c.vary(0.2, 0.8)
    c.rod((mast, 0.95), (mast, horizon - c.vary(0.15, 0.25)), 0.008, 0.8, taper=0.5, limb=0.1)
    tree(c, c.aspect * c.vary(0.1, 0.9), horizon + 0.03, 0.12, 0.6)
    c.ground(horizon, 0.7, hills=0.008, warmer=0.3, rough=0.03)
    return _stretched(c.image)


def _stretched(image: np.ndarray) -> np.ndarray:
    low, high = image.min(), image.max()
    return (image - low) / (high - low)


def _street(c: Canvas) -> None:
    c.sky(0.05, 0.22, 0.55, 0.025)
    c.ground(0.45, 0.25, hills=0.015, warmer=0.1)
    wires(c, 0.12, 4)
    x = -c.vary(0.02, 0.15)
    while x < c.aspect:
        w, gap = c.vary(0.2, 0.38), float(c.rng.choice([0.0, 0.03, 0.13]))
        if gap > 0.1:
            tree(c, x + w + 0.07, 0.7, c.vary(0.25, 0.36), 0.34)
        house(c, x, 0.68, w, c.vary(0.25, 0.42))
        x += w + gap
    c.ground(0.675, 0.46, hills=0.001, warmer=-0.05)
    c.ground(0.738, 0.58, rough=0.01)
    c.ground(0.747, 0.33, warmer=0.1, rough=0.025)
    for track in (0.81, 0.9):
        c.glow(c.aspect * c.vary(0.3, 0.7), track, 0.7, 0.008, 0.07)
    tree(c, c.aspect * c.vary(0.85, 0.98), 0.76, 0.42, 0.36)
    c.rod((0.62 * c.aspect, 0.76), (0.62 * c.aspect, 0.3), 0.007, 0.5, taper=0.6, limb=0.1)
    c.rod((0.62 * c.aspect, 0.3), (0.56 * c.aspect, 0.28), 0.004, 0.5)
    c.rod((0.56 * c.aspect, 0.283), (0.53 * c.aspect, 0.283), 0.008, 0.9)
    car(c, c.aspect * c.vary(0.06, 0.18), 0.88, 0.45)
    for i, place in enumerate((0.56, 0.7, 0.78, 0.93)):
        near = 0.76 + 0.055 * i + c.vary(-0.02, 0.02)
        person(c, c.aspect * (place + c.vary(-0.03, 0.03)), near, 0.42 * (near - 0.36), c.vary(0.05, 0.15))


def _front(c: Canvas) -> None:
    c.image[:] = 0.42 + 0.1 * c.y[:, None] + 0.025 * c.rough
    x = -c.vary(0.0, 0.15)
    while x < c.aspect:
        w = c.vary(0.12, 0.2)
        for y, h in ((0.06, 0.17), (0.33, 0.2), (0.63, 0.2)):
            if c.vary(0, 1) < 0.85:
                c.glow(x + w / 2, y + h + 0.05, 0.06, 0.025, c.vary(0.05, 0.3))
                window(c, x, y + c.vary(-0.01, 0.02), w * c.vary(0.85, 1.0), h)
        x += w + c.vary(0.08, 0.14)
    for y in (0.285, 0.585):
        c.rod((0, y), (c.aspect, y + c.vary(-0.005, 0.005)), 0.007, 0.62, limb=0.08)
    pipe = c.aspect * c.vary(0.3, 0.36)
    c.path([(pipe, 0), (pipe, 0.8), (pipe + 0.03, 0.86), (pipe + 0.03, 0.95)], 0.009, 0.34, limb=-0.06)
    for _ in range(5):
        c.blob(c.vary(0, c.aspect), c.vary(0.7, 0.95), 0.09, 0.05, 0.33, ragged=0.4)
    c.ground(0.93, 0.4, hills=0.001, warmer=0.1)
    door = c.aspect * c.vary(0.6, 0.68)
    c.box(door - 0.012, 0.61, 0.184, 0.33, 0.66)
    c.box(door, 0.625, 0.16, 0.31, 0.5, warmer=0.12)
    c.box(door + 0.03, 0.65, 0.1, 0.09, 0.75)
    c.disc(door + 0.145, 0.79, 0.007, 0.3)
    c.glow(door + 0.08, 0.61, 0.12, 0.025, 0.2)
    person(c, door + 0.05, 0.975, 0.33, 0.06)
    person(c, c.aspect * c.vary(0.12, 0.2), 0.98, 0.35, 0.12)
    deer(c, c.aspect * c.vary(0.84, 0.9), 0.975, 0.1, -1)  # at this size, a dog


def _machinery(c: Canvas) -> None:
    c.image[:] = 0.22 + 0.1 * c.y[:, None] + 0.02 * c.soft + 0.012 * c.rough
    for i in range(7):
        x = c.aspect * (i + c.vary(0, 1)) / 7
        c.box(x, 0, 0.012, 0.8, c.vary(0.15, 0.38))
    for _ in range(9):
        x, y, r, value = c.vary(0, c.aspect), c.vary(0.04, 0.6), c.vary(0.01, 0.028), c.vary(0.3, 0.8)
        bend, fall = x + c.vary(0.15, 0.6), c.vary(0.1, 0.5)
        c.path([(x, -0.1), (x, y), (bend, y), (bend, y + fall), (bend + 0.9, y + fall)], r, value, limb=0.25 * value)
        for flange in (x + 0.08, bend - 0.05):
            c.box(flange, y - 1.4 * r, 0.018, 2.8 * r, 0.8 * value)
    c.ground(0.8, 0.34, warmer=0.12, rough=0.02)
    tank, level = c.aspect * c.vary(0.1, 0.16), c.vary(0.45, 0.6)
    c.rod((tank, 0.3), (tank, 0.78), 0.12, 0.42, limb=0.16)
    c.rod((tank, level), (tank, 0.78), 0.12, 0.66, limb=0.22)
    c.box(tank - 0.12, level - 0.13, 0.24, 0.13, 0.46)
    c.path([(tank + 0.05, 0.2), (tank + 0.05, 0.06), (c.aspect, 0.09)], 0.022, 0.72, limb=0.2)
    motor, y = c.aspect * c.vary(0.42, 0.5), 0.74
    c.rod((motor - 0.2, y), (motor + 0.36, y), 0.02, 0.74, limb=0.2)
    c.rod((motor, y), (motor + 0.2, y), 0.11, 0.86, limb=0.3)
    for i in range(11):
        c.box(motor - 0.05 + 0.028 * i, y - 0.115, 0.009, 0.23, 0.55 + 0.03 * c.vary(0, i))
    c.box(motor - 0.08, y + 0.11, 0.36, 0.03, 0.4)
    c.box(motor + 0.04, y - 0.16, 0.09, 0.07, 0.6)
    c.rod((motor + 0.33, y), (motor + 0.4, y), 0.09, 0.6, limb=0.2)
    c.glow(motor + 0.3, y, 0.04, 0.05, 0.2)
    cabinet = c.aspect * c.vary(0.78, 0.83)
    c.box(cabinet, 0.34, 0.2, 0.44, 0.38, warmer=0.05)
    c.box(cabinet + 0.02, 0.37, 0.16, 0.33, 0.28)
    for i in range(5):
        for j in range(3):
            x, y = cabinet + 0.03 + 0.029 * i, 0.39 + 0.1 * j
            c.box(x, y, 0.018 + c.vary(0, 0.006), c.vary(0.03, 0.07), c.vary(0.34, 0.62))
    c.glow(cabinet + c.vary(0.05, 0.15), c.vary(0.42, 0.62), 0.025, 0.02, 0.45)
    for r, value in ((0.06, 0.55), (0.045, 0.3), (0.012, 0.6)):
        c.disc(0.66 * c.aspect, 0.36, r, value, limb=0.08)
    c.path([(0.66 * c.aspect - 0.035, 0.34), (0.66 * c.aspect + 0.04, 0.38)], 0.005, 0.56)
    person(c, c.aspect * c.vary(0.3, 0.34), 0.95, 0.5, 0.08)


def _landscape(c: Canvas) -> None:
    c.sky(0.06, 0.26, 0.45, 0.04)
    for i, edge in enumerate((0.27, 0.34, 0.42, 0.5)):
        c.ground(edge, 0.27 + 0.045 * i, hills=0.035 - 0.006 * i, warmer=0.12, rough=0.012 + 0.012 * i)
    x = 0.0
    while x < c.aspect:
        tree(c, x, 0.53 + c.vary(-0.01, 0.02), c.vary(0.08, 0.19), 0.36)
        x += c.vary(0.03, 0.12)
    house(c, c.aspect * c.vary(0.66, 0.72), 0.56, 0.2, 0.14)
    c.ground(0.55, 0.4, hills=0.008, warmer=0.12, rough=0.045)
    lake = c.aspect * c.vary(0.2, 0.35)
    c.blob(lake, 0.66, 0.33, 0.05, 0.24, ragged=0.06)
    c.glow(lake, 0.66, 0.2, 0.012, -0.05)
    c.polygon(
        [(0.66 * c.aspect, 0.57), (0.67 * c.aspect, 0.57), (1.1 * c.aspect, 1), (0.8 * c.aspect, 1)], 0.62, rough=0.02
    )
    for _ in range(16):
        size, y = c.vary(0.01, 0.035), c.vary(0.62, 0.98)
        c.blob(c.vary(0, c.aspect), y, 1.4 * size, size, c.vary(0.52, 0.68), ragged=0.12)
    fence = [(c.aspect * u, 0.72 + 0.05 * u + c.vary(-0.006, 0.006)) for u in np.linspace(0, 0.66, 10)]
    for rise in (0.035, 0.015):
        c.path([(x, y - rise) for x, y in fence], 0.0022, 0.56)
    for x, y in fence:
        c.rod((x, y), (x, y - 0.05), 0.0045, 0.6)
    for i, place in enumerate((0, 4, 2, 5, 1, 3)):
        y = 0.74 + 0.035 * i + c.vary(-0.01, 0.01)
        way = int(c.rng.choice([-1, 1]))
        deer(c, c.aspect * (0.08 + 0.11 * place + c.vary(-0.02, 0.02)), y, 0.3 * (y - 0.42), way)
    tree(c, 0.97 * c.aspect, 0.88, 0.6, 0.33)
    person(c, 0.86 * c.aspect, 0.92, 0.26, 0.1)


SCENE_PAINTERS = (_street, _front, _machinery, _landscape)  # painters of the kinds of scenes; the seed chooses one


#: Functions that draw a scene of a given seed and shape: `procedural:3`.
DRAWN_SCENES = {"procedural": procedural, "sky": sky}
