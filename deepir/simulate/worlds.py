"""The worlds of the kinds of recordings, and traffic in them."""

from __future__ import annotations

import numpy as np

from deepir.simulate.paths import CAMERA_HEIGHTS, CAMERA_SPEEDS, LANE_CENTRE, MAX_PAN_YAW, PAVEMENT_CENTRE
from deepir.simulate.planes import AHEAD, DOWN, RIGHT, Surface, Texture, World, cut_out, texture
from deepir.simulate.scenes.objects import Canvas, fractal_noise, house, person, tree
from deepir.simulate.scenes.procedural import procedural
from deepir.simulate.settings import RecordingSettings

GROUND_LENGTH = 1500.0  # m at which the ground ends
HOUSE_DISTANCE = 9.0  # distance of the houses from the middle of the street, m
HOUSE_ROW_HEIGHT = 12.8  # height of the picture of a row of houses, m
TREE_SPACING = 9.0  # distance between trees along the street, m
BACKDROP_HEIGHT_RATIO = 1.6  # height of the backdrop over that of the frame
BACKDROP_RESOLUTION = 1.6  # texels of the backdrop per px
ROAD_POSITION = 6.0  # x of the road below a drone, m
BACKDROP_SIDE_MULTIPLE = 64  # texels; averages of a backdrop then fit where it is mirrored
CAR_SIZE = (1.8, 4.3, 1.4)  # width, length and height, m
ONCOMING_SPEED = 9.0  # speed of oncoming cars, m/s
HALF_CAR_SPACING = 7.0  # half the distance between cars of one lane, m
WALKING_SPEED = 1.3  # speed of pedestrians, m/s
GAIT_PICTURES = 8  # pictures of a walker in one gait cycle (two steps)
GAIT_RATE = 0.9  # gait cycles a second
PERSON_HEIGHT = 1.8  # m
#: Least and largest distance of walkers' feet below the horizon, in heights of the backdrop.
FEET_POSITIONS = (0.24, 0.34)


def world(settings: RecordingSettings, seed: int, rng: np.random.Generator) -> World:
    """The world of a kind of recording, in scene values from 0 to about 1.

    The seed is of the drawn textures, the random stream of the objects' places.
    """
    if settings.kind == "drone":
        return _country(settings, seed, rng)
    if settings.kind in ("pan", "tripod"):
        reach = np.deg2rad(MAX_PAN_YAW) if settings.kind == "pan" else 0.0
        found = people_across(settings, seed, rng, reach, _tall(settings))
        return _surrounded(found, settings, seed, reach)
    surfaces = _street(settings, seed, rng)
    if settings.kind == "drive":
        surfaces += cars_ahead(settings, seed, rng)
    surfaces += people(settings, seed, rng)
    return _surrounded(surfaces, settings, seed, np.deg2rad(30), street=True)


def _surrounded(
    surfaces: list[Surface], settings: RecordingSettings, seed: int, reach: float, street: bool = False
) -> World:
    """Surfaces before a backdrop that covers a pan of `reach` to either side, rad."""
    texel = 1 / (BACKDROP_RESOLUTION * settings.focal)
    wide = 2 * (reach + np.deg2rad(settings.field_of_view))
    rows, columns = (
        BACKDROP_SIDE_MULTIPLE * int(np.ceil(side / texel / BACKDROP_SIDE_MULTIPLE)) for side in (_tall(settings), wide)
    )
    if street:
        c = Canvas(seed, (rows, columns))
        c.sky(0.02, 0.16, 0.5, 0.02)
        for k, edge in enumerate((0.44, 0.47)):
            c.ground(edge, 0.22 + 0.06 * k, hills=0.015, warmer=0.1, rough=0.02)
        picture = c.image
    else:
        picture = procedural(seed, (rows, columns))
    back = texture(picture, texel)
    return World(surfaces, back, azimuth=-columns * texel / 2, elevation=-rows * texel / 2)


def _tall(settings: RecordingSettings) -> float:
    """Height of the backdrop over its distance."""
    return BACKDROP_HEIGHT_RATIO * settings.shape[0] / settings.focal


def _ground(picture: Texture, corner: tuple[float, float, float], size: tuple[float, float], layer: int = 0) -> Surface:
    """A horizontal surface; x of its texture is the world's, y runs ahead."""
    return Surface((picture,), np.array(corner), RIGHT, AHEAD, size, layer=layer)


def _street(settings: RecordingSettings, seed: int, rng: np.random.Generator) -> list[Surface]:
    """Road, pavements, land, houses at both sides and trees; nearest things on the ground first."""
    length = CAMERA_SPEEDS[settings.kind] * settings.duration
    land = texture(0.33 + 0.03 * fractal_noise(rng, (512, 512), 1.2), 0.25)
    found = [
        _ground(_road(seed), (-8 * 1.28, 0, -20), (16 * 1.28, GROUND_LENGTH)),
        _ground(land, (-400, 0.02, -20), (800, GROUND_LENGTH), layer=1),
    ]
    for side in (-1, 1):
        for k, (far, low) in enumerate(((HOUSE_DISTANCE, 0.0), (3.5 * HOUSE_DISTANCE, 3.0))):
            front = cut_out(seed + 10 * k + side + 2, (256, 2048 >> k), _row, HOUSE_ROW_HEIGHT / 256)
            corner = np.array([side * far, -HOUSE_ROW_HEIGHT - low, -20.0 - 13 * k - 31 * (side > 0)])
            size = (length + 300, HOUSE_ROW_HEIGHT)
            found.append(Surface((front,), corner, AHEAD, DOWN, size, layer=k + 1))
    crowns = [cut_out(seed + k, (256, 256), lambda c: tree(c, 0.5, 1.0, 0.98, 0.34), 6 / 256) for k in range(3)]
    for k, z in enumerate(np.arange(8, length + 150, TREE_SPACING)):
        x = (-1) ** k * (PAVEMENT_CENTRE + 1.4) + rng.uniform(-0.3, 0.3)
        corner = np.array([x - 3, -6.0, z + rng.uniform(-2, 2)])
        found.append(Surface((crowns[k % 3],), corner, RIGHT, DOWN, (6, 6)))
    return found


def _row(c: Canvas) -> None:
    """Houses side by side, some with a gap between them."""
    x = 0.0
    while x < c.aspect:
        wide, gap = c.vary(0.6, 1.2), float(c.rng.choice([0.0, 0.0, 0.15, 0.5]))
        house(c, x, 1.0, min(wide, c.aspect - x), c.vary(0.5, 0.78))
        x += wide + gap


def _road(seed: int) -> Texture:
    """Asphalt with markings, tracks and patches between pavements, 20.5 m wide and 82 m long."""
    c = Canvas(seed, (2048, 512))
    per_m = 1 / 81.92  # picture heights
    middle = c.aspect / 2
    c.image[:] = 0.4 + 0.02 * c.soft + 0.012 * c.rough
    for x in (-LANE_CENTRE - 0.8, -LANE_CENTRE + 0.8, LANE_CENTRE - 0.8, LANE_CENTRE + 0.8):
        c.image += 0.05 * np.exp(-(((c.x - middle) / per_m - x) ** 2) / 0.1)
    for _ in range(30):
        at, down = c.vary(-3.5, 3.5) * per_m + middle, c.vary(0, 1)
        if c.vary(0, 1) < 0.5:
            c.blob(at, down, c.vary(0.3, 0.8) * per_m, c.vary(0.3, 1.5) * per_m, c.vary(0.3, 0.5), ragged=0.2)
        else:
            c.disc(at, down, 0.33 * per_m, c.vary(0.55, 0.7), limb=0.05)
    for z in np.arange(1, 81, 9):
        c.box(middle - 0.07 * per_m, z * per_m, 0.14 * per_m, 3 * per_m, 0.28)
    for side in (-1, 1):
        c.box(middle + side * 3.55 * per_m - 0.06 * per_m, 0.0, 0.12 * per_m, 1.0, 0.28)
        left = middle + (4.2 if side > 0 else -c.aspect / 2 / per_m) * per_m
        c.box(left, 0.0, c.aspect / 2 - 4.2 * per_m, 1.0, 0.5, rough=0.015)
        for joint in np.arange(0, 82, 1.28):
            c.box(left, joint * per_m, c.aspect / 2 - 4.2 * per_m, 0.03 * per_m, 0.44)
        c.box(middle + side * 4.2 * per_m - 0.12 * per_m, 0.0, 0.24 * per_m, 1.0, 0.6)
    return texture(c.image, 0.04)


def _country(settings: RecordingSettings, seed: int, rng: np.random.Generator) -> World:
    """Fields, a road, trees and houses from above."""
    length, across = CAMERA_SPEEDS["drone"] * settings.duration + 160, 122.88
    c = Canvas(seed, (2048, 1024))
    per_m = 1 / 245.76
    c.image[:] = 0.3 + 0.03 * c.soft + 0.03 * c.rough
    for _ in range(14):
        x, y, value = c.vary(0, c.aspect), c.vary(0, 1), c.vary(0.2, 0.45)
        wide, deep = c.vary(10, 40) * per_m, c.vary(10, 50) * per_m
        c.box(x, y, wide, deep, value, warmer=c.vary(-0.05, 0.05), rough=0.04)
    road = c.aspect / 2 + ROAD_POSITION * per_m
    c.box(road - 3.5 * per_m, 0.0, 7 * per_m, 1.0, 0.48, rough=0.02)
    for z in np.arange(0, 245, 9):
        c.box(road - 0.15 * per_m, z * per_m, 0.3 * per_m, 3 * per_m, 0.4)
    for _ in range(220):
        size, x = c.vary(1, 3.5) * per_m, c.vary(0, c.aspect)
        if abs(x - road) > 7 * per_m:
            c.blob(x, c.vary(0, 1), size, size, c.vary(0.12, 0.3), ragged=0.35)
    land = texture(c.image, 0.12)
    found = [_ground(land, (-2.5 * across, 0, -2 * across), (5 * across, length + 4 * across))]
    for z in np.arange(-20, length, 14).tolist():
        x = float(rng.choice([-1, 1]) * rng.uniform(14, 45))
        found += _house(seed, rng, (x, z + rng.uniform(-4, 4)), 0.15 + 0.3 * rng.random())
    found += cars_below(settings, rng, ROAD_POSITION)
    nothing = texture(np.full((BACKDROP_SIDE_MULTIPLE, BACKDROP_SIDE_MULTIPLE), 0.1), 0.1)
    return World(found, nothing, azimuth=0.0, elevation=0.0)


def _house(seed: int, rng: np.random.Generator, place: tuple[float, float], value: float) -> list[Surface]:
    """A roof on four walls."""
    wide, deep, tall = rng.uniform(7, 12), rng.uniform(7, 14), rng.uniform(3, 7)
    texel = 16.0 / 256
    roof = Canvas(seed + int(place[1]) % 97, (256, 256))
    roof.image[:] = value + 0.02 * roof.rough
    roof.image += 0.06 * (np.arange(256) * texel % 1 < 0.2)[:, None]
    roof.box(0.2, 0.2, 0.06, 0.06, 0.9)
    roof.box(0.3, 0.35, 0.08, 0.1, 0.12)
    return box((place[0], place[1]), (wide, deep, tall), texture(roof.image, texel), _wall(value))


def _wall(value: float) -> Texture:
    c = Canvas(1, (128, 256))
    c.image[:] = value + 0.15 + 0.02 * c.rough
    for x in np.arange(0.1, 2, 0.35).tolist():
        for y in (0.12, 0.55):
            c.box(x, y, 0.15, 0.2, 0.75 if x % 0.7 < 0.3 else 0.2)
    return texture(c.image, 8.0 / 128)


def cars_ahead(settings: RecordingSettings, seed: int, rng: np.random.Generator) -> list[Surface]:
    """One car ahead in the lane of the camera, the others oncoming, distributed over the duration."""
    found = []
    for k in range((settings.objects + 1) // 2):
        speed = CAMERA_SPEEDS["drive"] if k == 0 else -ONCOMING_SPEED
        meets = settings.duration * (k - rng.uniform(0.2, 0.8)) / max((settings.objects - 1) // 2, 1)
        z = 14.0 if k == 0 else (CAMERA_SPEEDS["drive"] + ONCOMING_SPEED) * meets + 6.0
        look = cut_out(seed + k, (128, 160), _rear if k == 0 else _front, 2.0 / 160)
        corner = np.array([(LANE_CENTRE if k == 0 else -LANE_CENTRE) - 1.0, -1.6, z])
        found.append(Surface((look,), corner, RIGHT, DOWN, (2.0, 1.6), speed * AHEAD))
    return found


def people(settings: RecordingSettings, seed: int, rng: np.random.Generator) -> list[Surface]:
    """People on the pavements who cross the street or walk along it."""
    found = []
    for k in range(settings.objects // 2):
        side = (-1) ** k
        meets = settings.duration * (k + rng.uniform(0.2, 0.8)) / max(settings.objects // 2, 1)
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
    settings: RecordingSettings, seed: int, rng: np.random.Generator, reach: float, tall: float
) -> list[Surface]:
    """People who pass before a camera at rest, within an azimuth of `reach` rad to either side.

    They walk on the ground of the backdrop, whose height over its distance is `tall`.
    """
    found = []
    for k in range(settings.objects):
        away = CAMERA_HEIGHTS[settings.kind] / (tall * rng.uniform(*FEET_POSITIONS))
        way = rng.choice([-1.0, 1.0])
        meets = settings.duration * (k + rng.uniform(0, 1)) / settings.objects
        velocity = way * WALKING_SPEED * rng.uniform(0.7, 1.3) * RIGHT
        start = np.array([away * np.tan(reach * rng.uniform(-0.9, 0.9)), 0, away]) - velocity * meets
        found.append(_walker(seed + k, start, velocity, rng))
    return found


def cars_below(settings: RecordingSettings, rng: np.random.Generator, road: float) -> list[Surface]:
    """Cars on a road along z at x = `road`, seen from above."""
    found = []
    for k in range(settings.objects):
        way = (-1) ** k
        meets = settings.duration * (k + rng.uniform(0, 1)) / settings.objects
        z = 18.0 + HALF_CAR_SPACING * k if way > 0 else (CAMERA_SPEEDS["drone"] + ONCOMING_SPEED) * meets + 22.0
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
    """A roof on four walls about a place (x, z), m, of a size along x, z and up, m, at a velocity (3,), m/s."""
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
