"""How the camera of a recording moves: its place and its direction at each instant.

The world has x to the right, y down and z ahead, in metres; the ground is at y = 0. A camera looks along its own z.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deepir.simulate.recording.settings import RecordingSettings

WAVES = 12  # that make up a wander
SPEED = {"drive": 12.0, "walk": 1.4, "drone": 8.0}  # m/s
HEIGHT = {"drive": 1.4, "walk": 1.65, "pan": 3.5, "tripod": 3.5, "drone": 40.0}  # of the camera, m
LANE = 1.75  # x of the middle of the car's lane, m
PAVEMENT = 6.2  # x of who walks, m
ACROSS = -12.0  # yaw of who walks, towards the street, degrees
DOWN = -60.0  # pitch of the drone, degrees
TURN = 4.0  # yaw of the drone, degrees a second
PAN = 50.0  # largest yaw of a pan to either side, degrees
STOP, MOVE = (0.5, 1.5), (0.8, 2.0)  # durations of stops and moves of a pan, s
STEP = 1.8  # steps of who walks, Hz


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
        rng: Draws speed, vibration and turns.

    Returns:
        The poses of all instants; every `substeps`-th is that of a frame.
    """
    count = (settings.n_frames - 1) * settings.substeps + 1
    times = np.arange(count) / (settings.frame_rate * settings.substeps)
    position = np.zeros((count, 3))
    position[:, 1] = -HEIGHT[settings.kind]
    yaw, pitch, roll = np.zeros((3, count))
    if settings.kind == "drive":
        position[:, 0] = LANE + wander(rng, times, 0.15, 0.05, 0.2)
        position[:, 1] += wander(rng, times, 0.01, 2, 12)
        position[:, 2] = SPEED["drive"] * (times + wander(rng, times, 0.3, 0.05, 0.2))
        yaw = wander(rng, times, 1.5, 0.05, 0.3) + wander(rng, times, 0.03, 3, 12)
        pitch, roll = wander(rng, times, 0.12, 1, 12), wander(rng, times, 0.1, 1, 12)
    elif settings.kind == "walk":
        phase = 2 * np.pi * STEP * times
        position[:, 0] = PAVEMENT + 0.03 * np.sin(phase / 2) + wander(rng, times, 0.1, 0.05, 0.3)
        position[:, 1] += 0.025 * np.sin(phase) + wander(rng, times, 0.01, 0.5, 4)
        position[:, 2] = SPEED["walk"] * times + 0.02 * np.sin(phase)
        yaw = ACROSS + wander(rng, times, 5, 0.05, 0.4) + wander(rng, times, 0.4, 0.8, 5)
        pitch = wander(rng, times, 1.5, 0.05, 0.4) + wander(rng, times, 0.4, 0.8, 5)
        roll = wander(rng, times, 0.8, 0.3, 3)
    elif settings.kind == "pan":
        yaw = turns(rng, times)
    elif settings.kind == "drone":
        position += wander(rng, times, 0.3, 0.1, 0.5)[:, None]
        position[:, 2] += SPEED["drone"] * times
        yaw = TURN * (times - times[-1] / 2) + wander(rng, times, 0.2, 0.3, 3)
        pitch, roll = DOWN + wander(rng, times, 0.3, 0.3, 3), wander(rng, times, 0.3, 0.3, 3)
    return CameraPath(times, position, rotations(yaw, pitch, roll))


def wander(rng: np.random.Generator, times: np.ndarray, rms: float, low: float, high: float) -> np.ndarray:
    """A smooth random course (I,) with frequencies from `low` to `high` Hz; rms as that of its whole ensemble."""
    rate = 2 * np.pi * np.exp(rng.uniform(np.log(low), np.log(high), WAVES))
    parts = rng.standard_normal((2, WAVES)) * rms / np.sqrt(WAVES)
    angle = rate * times[:, None]
    return np.asarray(np.cos(angle) @ parts[0] + np.sin(angle) @ parts[1])


def turns(rng: np.random.Generator, times: np.ndarray) -> np.ndarray:
    """Yaw (I,), degrees: stops, and between them moves that start and end smoothly."""
    yaw, now, at = np.zeros(len(times)), 0.0, rng.uniform(-PAN, PAN)
    while now <= times[-1]:
        stop, move, aim = rng.uniform(*STOP), rng.uniform(*MOVE), rng.uniform(-PAN, PAN)
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
