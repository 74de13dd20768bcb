"""Paths of a simulated camera, and traffic beside it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deepir.simulate.recording.settings import RecordingSettings
from deepir.simulate.recording.surfaces import AHEAD, DOWN, RIGHT, Surface, Texture, cut_out, texture
from deepir.simulate.scenes.objects import Canvas, person

WANDER_WAVES = 12  # sinusoids in a random course
CAMERA_SPEEDS = {"drive": 12.0, "walk": 1.4, "drone": 8.0}  # m/s, by kind of recording
#: M above the ground.
CAMERA_HEIGHTS = {"drive": 1.4, "walk": 1.65, "pan": 3.5, "tripod": 3.5, "drone": 40.0}
LANE_CENTRE = 1.75  # x of the middle of the car's lane, m
PAVEMENT_CENTRE = 6.2  # x of pedestrians, m
WALK_YAW = -12.0  # yaw of a camera that is carried along the pavement, towards the street, degrees
DRONE_PITCH = -60.0  # degrees
DRONE_TURN_RATE = 4.0  # yaw rate of the drone, degrees a second
MAX_PAN_YAW = 50.0  # largest yaw of a pan to either side, degrees
PAN_STOP_DURATIONS = (0.5, 1.5)  # least and longest stop of a pan, s
PAN_MOVE_DURATIONS = (0.8, 2.0)  # least and longest move of a pan, s
STEP_RATE = 1.8  # steps of a camera that is carried, Hz
CAR_SIZE = (1.8, 4.3, 1.4)  # width, length and height, m
ONCOMING_SPEED = 9.0  # speed of oncoming cars, m/s
HALF_CAR_SPACING = 7.0  # half the distance between cars of one lane, m
WALKING_SPEED = 1.3  # speed of pedestrians, m/s
GAIT_PICTURES = 8  # pictures of a walker in one gait cycle (two steps)
GAIT_RATE = 0.9  # gait cycles a second
PERSON_HEIGHT = 1.8  # m
#: Least and largest distance of walkers' feet below the horizon, in heights of the backdrop.
FEET_POSITIONS = (0.24, 0.34)


@dataclass(frozen=True)
class CameraPath:
    """Poses of a camera."""

    times: np.ndarray  # (I,), s
    position: np.ndarray  # (I, 3), m
    rotation: np.ndarray  # (I, 3, 3), from the camera's axes to the world's


def camera_path(settings: RecordingSettings, rng: np.random.Generator) -> CameraPath:
    """The path of a kind of recording, at `substeps` instants for each frame after the first.

    Args:
        settings: Kind, frames, rates.
        rng: Random stream of speed, vibration and turns.

    Returns:
        The poses of all instants; every `substeps`-th is that of a frame.
    """
    count = (settings.n_frames - 1) * settings.substeps + 1
    times = np.arange(count) / (settings.frame_rate * settings.substeps)
    position = np.zeros((count, 3))
    position[:, 1] = -CAMERA_HEIGHTS[settings.kind]
    yaw, pitch, roll = np.zeros((3, count))
    if settings.kind == "drive":
        position[:, 0] = LANE_CENTRE + wander(rng, times, 0.15, 0.05, 0.2)
        position[:, 1] += wander(rng, times, 0.01, 2, 12)
        position[:, 2] = CAMERA_SPEEDS["drive"] * (times + wander(rng, times, 0.3, 0.05, 0.2))
        yaw = wander(rng, times, 1.5, 0.05, 0.3) + wander(rng, times, 0.03, 3, 12)
        pitch, roll = wander(rng, times, 0.12, 1, 12), wander(rng, times, 0.1, 1, 12)
    elif settings.kind == "walk":
        phase = 2 * np.pi * STEP_RATE * times
        position[:, 0] = PAVEMENT_CENTRE + 0.03 * np.sin(phase / 2) + wander(rng, times, 0.1, 0.05, 0.3)
        position[:, 1] += 0.025 * np.sin(phase) + wander(rng, times, 0.01, 0.5, 4)
        position[:, 2] = CAMERA_SPEEDS["walk"] * times + 0.02 * np.sin(phase)
        yaw = WALK_YAW + wander(rng, times, 5, 0.05, 0.4) + wander(rng, times, 0.4, 0.8, 5)
        pitch = wander(rng, times, 1.5, 0.05, 0.4) + wander(rng, times, 0.4, 0.8, 5)
        roll = wander(rng, times, 0.8, 0.3, 3)
    elif settings.kind == "pan":
        yaw = pan_yaw(rng, times)
    elif settings.kind == "drone":
        position += wander(rng, times, 0.3, 0.1, 0.5)[:, None]
        position[:, 2] += CAMERA_SPEEDS["drone"] * times
        yaw = DRONE_TURN_RATE * (times - times[-1] / 2) + wander(rng, times, 0.2, 0.3, 3)
        pitch, roll = DRONE_PITCH + wander(rng, times, 0.3, 0.3, 3), wander(rng, times, 0.3, 0.3, 3)
    return CameraPath(times, position, rotations(yaw, pitch, roll))


def wander(rng: np.random.Generator, times: np.ndarray, rms: float, low: float, high: float) -> np.ndarray:
    """A smooth random course.

    Args:
        rng: Random stream.
        times: (I,), s.
        rms: Root mean square over the ensemble.
        low: Lowest frequency, Hz.
        high: Highest frequency, Hz.

    Returns:
        (I,).
    """
    rate = 2 * np.pi * np.exp(rng.uniform(np.log(low), np.log(high), WANDER_WAVES))
    parts = rng.standard_normal((2, WANDER_WAVES)) * rms / np.sqrt(WANDER_WAVES)
    angle = rate * times[:, None]
    return np.asarray(np.cos(angle) @ parts[0] + np.sin(angle) @ parts[1])


def pan_yaw(rng: np.random.Generator, times: np.ndarray) -> np.ndarray:
    """Yaw (I,), degrees: stops, and between them moves that start and end smoothly."""
    yaw, now, at = np.zeros(len(times)), 0.0, rng.uniform(-MAX_PAN_YAW, MAX_PAN_YAW)
    while now <= times[-1]:
        stop, move, aim = (
            rng.uniform(*PAN_STOP_DURATIONS),
            rng.uniform(*PAN_MOVE_DURATIONS),
            rng.uniform(-MAX_PAN_YAW, MAX_PAN_YAW),
        )
        part = ((times - now - stop) / move).clip(0, 1)
        later = times >= now
        yaw[later] = (at + (aim - at) * part**2 * (3 - 2 * part))[later]
        now, at = now + stop + move, aim
    return yaw


def rotations(yaw: np.ndarray, pitch: np.ndarray, roll: np.ndarray) -> np.ndarray:
    """(I, 3, 3) from degrees: positive yaw looks to the right, pitch up; positive roll turns +x towards +y."""

    def about(axis: int, angle: np.ndarray) -> np.ndarray:
        first, second = (axis + 1) % 3, (axis + 2) % 3
        found = np.tile(np.eye(3), (len(angle), 1, 1))
        cos, sin = np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))
        found[:, first, first] = found[:, second, second] = cos
        found[:, second, first], found[:, first, second] = sin, -sin
        return found

    return np.asarray(about(1, yaw) @ about(0, pitch) @ about(2, roll))


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
