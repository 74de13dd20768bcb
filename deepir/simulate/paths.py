"""Paths of the camera of a recording."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deepir.simulate.settings import RecordingSettings

WANDER_WAVES = 12  # sinusoids in a random course
CAMERA_SPEEDS = {"drive": 12.0, "walk": 1.4, "drone": 8.0}  # m/s, by kind of recording
CAMERA_HEIGHTS = {"drive": 1.4, "walk": 1.65, "pan": 3.5, "tripod": 3.5, "drone": 40.0}  # m above the ground
LANE_CENTRE = 1.75  # x of the middle of the car's lane, m
PAVEMENT_CENTRE = 6.2  # x of pedestrians, m
WALK_YAW = -12.0  # yaw of a camera that is carried along the pavement, towards the street, degrees
DRONE_PITCH = -60.0  # degrees
DRONE_TURN_RATE = 4.0  # yaw rate of the drone, degrees a second
MAX_PAN_YAW = 50.0  # largest yaw of a pan to either side, degrees
PAN_STOP_DURATIONS = (0.5, 1.5)  # least and longest stop of a pan, s
PAN_MOVE_DURATIONS = (0.8, 2.0)  # least and longest move of a pan, s
STEP_RATE = 1.8  # steps of a camera that is carried, Hz


@dataclass(frozen=True)
class CameraPath:
    """Poses of a camera."""

    times: np.ndarray  # (I,), s
    position: np.ndarray  # (I, 3), m
    rotation: np.ndarray  # (I, 3, 3), from the camera's axes to the world's


def camera_path(settings: RecordingSettings, rng: np.random.Generator) -> CameraPath:
    """The path of a kind of recording, at `substeps` instants for each frame after the first."""
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
    """A smooth random course at times (I,), s, with frequencies from `low` to `high`, Hz; `rms` is of the ensemble."""
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
