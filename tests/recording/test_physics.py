"""What a recording tells of thermal lag, by scenes that move as is known."""

import numpy as np
import pytest
from scipy import ndimage
from skimage import data

from deepir.recording.correct import findings_lines
from deepir.recording.estimate import SensorEstimate
from deepir.recording.thermal_lag import (
    LENGTH,
    MAX_RUNS,
    OFFSETS,
    NeighbouringFrames,
    ThermalLag,
    thermal_lag,
)

SIZE = (96, 128)
NOISE = 2.0
PICTURE = 4.0 * ndimage.gaussian_filter(data.camera().astype(float), 0.7)
STEPS = 4  # instants of a frame


def view(y, x):
    """The picture with its upper left corner at a point, or at one for each row."""
    rows, columns = np.indices(SIZE)
    return ndimage.map_coordinates(PICTURE, [rows + y, columns + x], order=1)


def shaken(tau, count=48):
    """Frames of a camera that shakes while it moves on, of pixels with this time constant, in frames."""
    time = np.arange(count * STEPS) / STEPS
    y, x = 150 + 0.5 * time + 2.5 * np.sin(0.7 * time), 120 + 0.5 * time + 3 * np.sin(0.8 * time + 1)
    kept = np.exp(-1 / STEPS / tau) if tau else 0.0
    shown, frames, rng = view(y[0], x[0]), [], np.random.default_rng(2)
    for k in range(len(time)):
        shown = kept * shown + (1 - kept) * view(y[k], x[k])
        if k % STEPS == 0:
            frames.append(shown + NOISE * rng.standard_normal(SIZE))
    return np.stack(frames).astype(np.float32)


def runs_of(frames):
    neighbours = NeighbouringFrames()
    assert sum(1 for _ in neighbours.collect(frames)) == len(frames)
    return [np.stack(run) for run in neighbours.runs]


@pytest.mark.parametrize("tau", [0.0, 0.3, 0.6])
def test_a_thermal_lag_is_seen_and_measured(tau):
    found = thermal_lag(runs_of(shaken(tau)))
    assert found.is_seen == (tau > 0)
    if tau:
        assert 0.5 * tau < found.time_constant < 2 * tau


def test_lag_is_not_judged_by_few_frames():
    assert thermal_lag(runs_of(shaken(0.3, 12))) is None


def test_few_runs_are_kept_spread_over_a_long_recording():
    frames = np.arange(4000)[:, None, None] * np.ones((1, 2, 2))
    neighbours = NeighbouringFrames()
    for _ in neighbours.collect(iter(frames)):
        pass
    assert MAX_RUNS / 2 < len(neighbours.runs) <= MAX_RUNS
    assert np.ptp(np.diff(neighbours.numbers)) == 0
    assert neighbours.numbers[-1] > 3500
    for number, run in zip(neighbours.numbers, neighbours.runs, strict=True):
        assert [frame[0, 0] for frame in run] == [number + each for each in OFFSETS]


def test_a_repeated_frame_ends_a_run():
    frames = np.arange(2 * LENGTH - 2)[:, None, None] * np.ones((1, 2, 2))
    frames[LENGTH - 2] = frames[LENGTH - 3]
    neighbours = NeighbouringFrames()
    assert len(list(neighbours.collect(frames))) == len(frames)
    assert neighbours.numbers == [LENGTH - 2]


@pytest.mark.parametrize(
    ("misfit", "lag", "said"),
    [
        (0.9, ThermalLag(0.3, 12.0), ["motion: the frames register", "thermal lag: about 0.3 of the time"]),
        (np.inf, ThermalLag(0.05, 0.2), ["motion: near and far", "thermal lag: none is seen"]),
        (np.inf, None, ["motion: near and far", "thermal lag: not judged"]),
    ],
)
def test_the_report_says_what_was_seen_in_words(misfit, lag, said):
    none = np.zeros(SIZE)
    estimate = SensorEstimate(none + 1, none, none > 0, 0.0, None, "offset", misfit)
    for line, start in zip(findings_lines(estimate, lag), said, strict=True):
        assert line.startswith(start)
