"""A recording of a camera that is carried over a picture, and its truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy import ndimage
from skimage import data

SIZE = (80, 112)
FRAMES = 120
NOISE = 3.0


@dataclass(frozen=True)
class Walk:
    """Frames = gain (scenes - 8000) + 8000 + fine + slow + noise; counts."""

    frames: np.ndarray  # (N, h, w)
    scenes: np.ndarray
    gain: np.ndarray  # (h, w)
    fine: np.ndarray  # mean zero
    slow: np.ndarray  # mean zero
    bad: np.ndarray  # bool


@pytest.fixture(scope="session")
def walk() -> Walk:
    rng = np.random.default_rng(7)
    picture = 8000 + 4.0 * ndimage.gaussian_filter(data.camera().astype(float), 0.8)
    time = np.linspace(0, 2 * np.pi, FRAMES)
    y = 190 + 90 * np.sin(0.61 * time) + 6 * np.sin(3.1 * time)
    x = 170 + 70 * np.cos(0.87 * time) + 6 * np.cos(2.3 * time)
    rows, columns = np.indices(SIZE)
    scenes = np.stack(
        [ndimage.map_coordinates(picture, [rows + a, columns + b], order=1) for a, b in zip(y, x, strict=True)]
    )
    v, u = np.mgrid[-1 : 1 : SIZE[0] * 1j, -1 : 1 : SIZE[1] * 1j]
    slow = 150 * (u**2 + v**2) + 60 * u
    gain = 1 + 0.02 * rng.standard_normal(SIZE)
    fine = 60 * rng.standard_normal(SIZE) + 40 * rng.standard_normal((1, SIZE[1]))
    frames = gain * (scenes - 8000) + 8000 + fine + slow + NOISE * rng.standard_normal(scenes.shape)
    bad = rng.random(SIZE) < 0.002
    frames[:, bad] = 12000
    frames = frames.round().astype(np.uint16)
    return Walk(frames, scenes, gain, fine - fine.mean(), slow - slow.mean(), bad)


@pytest.fixture
def estimated_once(monkeypatch):
    """The same keyframes are estimated once: for tests of the ways to them."""
    from deepir.recording import segments

    known, estimate = {}, segments.estimate_sensor

    def of(keyframes, *, former=None, jumps=()):
        key = (keyframes.frames.tobytes(), keyframes.numbers.tobytes(), id(former), tuple(jumps))
        if key not in known:
            known[key] = estimate(keyframes, former=former, jumps=jumps)
        return known[key]

    monkeypatch.setattr(segments, "estimate_sensor", of)


@pytest.fixture(scope="session")
def corrected(walk):
    """Every second frame of the walk, corrected by themselves."""
    from deepir.correct_recording import correct

    return correct(walk.frames[::2])
