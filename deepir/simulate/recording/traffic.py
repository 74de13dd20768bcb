"""Moving objects of recordings: cars and people, each at a constant speed."""

from __future__ import annotations

import numpy as np

from deepir.simulate.recording.paths import CAMERA_HEIGHTS, CAMERA_SPEEDS, LANE_CENTRE, PAVEMENT_CENTRE
from deepir.simulate.recording.settings import RecordingSettings
from deepir.simulate.recording.surfaces import AHEAD, DOWN, RIGHT, Surface, Texture, cut_out, texture
from deepir.simulate.scenes.objects import Canvas, person

CAR_SIZE = (1.8, 4.3, 1.4)  # width, length and height, m
ONCOMING_SPEED = 9.0  # speed of oncoming cars, m/s
HALF_CAR_SPACING = 7.0  # half the distance between cars of one lane, m
WALKING_SPEED = 1.3  # speed of pedestrians, m/s
GAIT_PICTURES = 8  # pictures of a walker in one gait cycle (two steps)
GAIT_RATE = 0.9  # gait cycles a second
PERSON_HEIGHT = 1.8  # m
#: Least and largest distance of walkers' feet below the horizon, in heights of the backdrop.
FEET_POSITIONS = (0.24, 0.34)


def cars_ahead(
    settings: RecordingSettings, seed: int, rng: np.random.Generator, duration: float
) -> list[Surface]:
    """One car ahead in the lane of the camera, the others oncoming, distributed over the duration."""
    found = []
    for k in range((settings.objects + 1) // 2):
        speed = CAMERA_SPEEDS["drive"] if k == 0 else -ONCOMING_SPEED
        meets = duration * (k - rng.uniform(0.2, 0.8)) / max((settings.objects - 1) // 2, 1)
        z = 14.0 if k == 0 else (CAMERA_SPEEDS["drive"] + ONCOMING_SPEED) * meets + 6.0
        look = cut_out(seed + k, (128, 160), _rear if k == 0 else _front, 2.0 / 160)
        corner = np.array([(LANE_CENTRE if k == 0 else -LANE_CENTRE) - 1.0, -1.6, z])
        found.append(Surface((look,), corner, RIGHT, DOWN, (2.0, 1.6), speed * AHEAD))
    return found


def people(
    settings: RecordingSettings, seed: int, rng: np.random.Generator, duration: float
) -> list[Surface]:
    """People on the pavements who cross the street or walk along it."""
    found = []
    for k in range(settings.objects // 2):
        side, meets = (-1) ** k, duration * (k + rng.uniform(0.2, 0.8)) / max(settings.objects // 2, 1)
        away = rng.uniform(9, 16) + CAMERA_SPEEDS[settings.kind] * meets
        if k % 2:  # across
            velocity = -side * WALKING_SPEED * RIGHT
            start = np.array([-side * rng.uniform(0, 3), 0, away]) - velocity * meets
        else:
            velocity = (-1) ** (k // 2) * WALKING_SPEED * AHEAD
            start = np.array([side * (PAVEMENT_CENTRE - 0.9), 0, away]) - velocity * meets
        found.append(_walker(seed + k, start, velocity, rng))
    return found


def people_across(
    settings: RecordingSettings,
    seed: int,
    rng: np.random.Generator,
    duration: float,
    reach: float,
    tall: float,
) -> list[Surface]:
    """People who pass before a camera at rest.

    Args:
        settings: Number of people, kind.
        seed: Of their looks.
        rng: Random stream of their motion.
        duration: Of the recording, s.
        reach: Largest azimuth to either side, rad.
        tall: Height of the backdrop, on whose ground they walk, over its distance.
    """
    found = []
    for k in range(settings.objects):
        away, way = (
            CAMERA_HEIGHTS[settings.kind] / (tall * rng.uniform(*FEET_POSITIONS)),
            rng.choice([-1.0, 1.0]),
        )
        meets = duration * (k + rng.uniform(0, 1)) / settings.objects
        velocity = way * WALKING_SPEED * rng.uniform(0.7, 1.3) * RIGHT
        start = np.array([away * np.tan(reach * rng.uniform(-0.9, 0.9)), 0, away]) - velocity * meets
        found.append(_walker(seed + k, start, velocity, rng))
    return found


def cars_below(
    settings: RecordingSettings, rng: np.random.Generator, duration: float, road: float
) -> list[Surface]:
    """Cars on a road along z at x = `road`, seen from above."""
    found = []
    for k in range(settings.objects):
        way = (-1) ** k
        meets = duration * (k + rng.uniform(0, 1)) / settings.objects
        z = (
            18.0 + HALF_CAR_SPACING * k
            if way > 0
            else (CAMERA_SPEEDS["drone"] + ONCOMING_SPEED) * meets + 22.0
        )
        side = texture(np.full((32, 32), 0.5), CAR_SIZE[1] / 32)
        found += box((road + 1.75 * way, z), CAR_SIZE, _roof(way), side, way * ONCOMING_SPEED * AHEAD)
    return found


def box(
    place: tuple[float, float],
    size: tuple[float, float, float],
    roof: Texture,
    wall: Texture,
    velocity: np.ndarray | None = None,
) -> list[Surface]:
    """A roof on four walls.

    Args:
        place: x and z of its middle, m.
        size: Along x, z and up, m.
        roof: Texture of the roof.
        wall: Texture of the walls.
        velocity: (3,), m/s; None: at rest.
    """
    (x, z), (wide, deep, tall) = place, size
    low, high = np.array([x - wide / 2, -tall, z - deep / 2]), np.array([x + wide / 2, -tall, z + deep / 2])
    speed = np.zeros(3) if velocity is None else velocity
    return [
        Surface((roof,), low, RIGHT, AHEAD, (wide, deep), speed),
        Surface((wall,), low, RIGHT, DOWN, (wide, tall), speed),
        Surface((wall,), high, -RIGHT, DOWN, (wide, tall), speed),
        Surface((wall,), low, AHEAD, DOWN, (deep, tall), speed),
        Surface((wall,), high, -AHEAD, DOWN, (deep, tall), speed),
    ]


def _walker(seed: int, feet: np.ndarray, velocity: np.ndarray, rng: np.random.Generator) -> Surface:
    swings = 0.16 * np.sin(2 * np.pi * np.arange(GAIT_PICTURES) / GAIT_PICTURES)
    tall = PERSON_HEIGHT * rng.uniform(0.9, 1.05)
    looks = [
        cut_out(seed, (160, 128), lambda c, s=swing: person(c, c.aspect / 2, 0.98, 0.95, s), tall / 152)  # type: ignore[misc]
        for swing in swings
    ]
    size = (128 * tall / 152, 160 * tall / 152)
    corner = feet + np.array([-size[0] / 2, -size[1], 0])
    return Surface(looks, corner, RIGHT, DOWN, size, velocity, GAIT_PICTURES * GAIT_RATE)


def _rear(c: Canvas) -> None:
    """A car from behind, 2 m wide and 1.6 m high; its exhaust is hot."""
    _body(c)
    c.box(0.3, 0.3, 0.65, 0.22, 0.25, warmer=0.05)
    c.disc(0.32, 0.87, 0.035, 0.98)
    c.glow(0.32, 0.9, 0.12, 0.06, 0.15)


def _front(c: Canvas) -> None:
    """A car from ahead; its engine is hot."""
    _body(c)
    c.box(0.28, 0.28, 0.69, 0.22, 0.3, warmer=0.08)
    c.box(0.35, 0.66, 0.55, 0.14, 0.85)
    for x in (0.24, 1.0):
        c.disc(x, 0.66, 0.05, 0.6)


def _body(c: Canvas) -> None:
    c.polygon([(0.27, 0.25), (0.98, 0.25), (1.1, 0.55), (0.15, 0.55)], 0.42)
    c.box(0.12, 0.53, 1.01, 0.37, 0.46, warmer=0.08)
    for x in (0.15, 0.95):
        c.box(x, 0.85, 0.15, 0.13, 0.7)


def _roof(way: int) -> Texture:
    c = Canvas(3, (128, 64))
    c.image[:] = 0.45 + 0.01 * c.rough
    ahead = way > 0
    c.box(0.06, 0.62 if ahead else 0.26, 0.3, 0.1, 0.2)
    c.box(0.06, 0.2 if ahead else 0.74, 0.3, 0.07, 0.25)
    c.glow(0.21, 0.88 if ahead else 0.12, 0.12, 0.08, 0.4)
    return texture(c.image, CAR_SIZE[1] / 128)
