"""A recording: one sensor, and a scene for each of some bursts."""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy import ndimage

import deepir
from deepir.errors import ConfigError, DataError
from deepir.simulate.scenes.procedural import procedural

SIZE = (56, 72)
PER_SCENE = 10  # frames
QUICK = ("threads=1", "prior=tv")


@dataclass(frozen=True)
class Film:
    """Frames of a camera that looks at one scene after the other, and the offset that is in all of them."""

    frames: np.ndarray  # (N, h, w)
    scenes: np.ndarray  # what they show, (N, h, w)
    offset: np.ndarray  # (h, w), mean zero


@pytest.fixture(scope="module")
def film():
    rng = np.random.default_rng(5)
    height, width = SIZE
    rows, columns = np.indices(SIZE)
    v, u = np.linspace(-1, 1, height)[:, None], np.linspace(-1, 1, width)
    offset = 12 * rng.standard_normal((1, width)) + 8 * rng.standard_normal(SIZE) + 25 * (u**2 + v**2 + u)
    frames = []
    for k in range(3):
        picture = ndimage.spline_filter(8000 + 300 * procedural(20 + k, (height + 40, width + 40)))
        at = ndimage.gaussian_filter1d(rng.standard_normal((PER_SCENE, 2)), 1.0, axis=0) * 9
        at -= at[0]
        moved = [ndimage.map_coordinates(picture, [rows + 20 + y, columns + 20 + x], prefilter=False) for y, x in at]
        frames += moved
    scenes = np.stack(frames)
    noisy = scenes + offset + 3 * rng.standard_normal(scenes.shape)
    return Film(noisy.astype(np.float32), scenes, offset - offset.mean())


def left(result, film):
    """What is left of the offset, relative to what was there; of frames of a mean level."""
    level = float(film.frames.mean())
    found = result.offset + (result.gain - 1) * level
    return np.std(found - film.offset) / np.std(film.offset)


@pytest.fixture(scope="module")
def solved(film, tmp_path_factory):
    folder = tmp_path_factory.mktemp("recording") / "run"
    return deepir.run("recording", f"output.dir={folder}", *QUICK, frames=film.frames), folder


def test_scenes_that_share_a_sensor_tell_more_of_it_than_one(film, solved):
    one = deepir.run("recording", "method.count=1", *QUICK, frames=film.frames[:PER_SCENE])
    assert left(solved[0], film) < 0.8 * left(one, film)
    assert left(solved[0], film) < 0.06


def test_the_result_has_a_sensor_and_the_scene_of_each_burst(film, solved):
    result, folder = solved
    assert result.scene.shape == (3, *SIZE)
    bursts = result.metrics["bursts"]
    assert [len(numbers) for numbers in bursts] == [8, 8, 8]
    assert sorted(np.flatnonzero(result.frames_used)) == sorted(np.concatenate(bursts))
    assert np.isnan(result.motion[~result.frames_used]).all()
    assert result.motion[[numbers[0] for numbers in bursts]] == pytest.approx(np.tile(np.eye(3), (3, 1, 1)))
    shown = film.scenes[[numbers[0] for numbers in bursts]]
    for scene, truth in zip(result.scene, shown, strict=True):
        assert np.corrcoef(scene[6:-6, 6:-6].ravel(), truth[6:-6, 6:-6].ravel())[0, 1] > 0.99
    assert {"gain", "offset"} <= result.uncertainty.keys()
    assert (folder / "report.html").exists()


@pytest.mark.parametrize("prior", ["dip", "siren"])
def test_the_prior_is_swapped_in_one_line(film, prior):
    changes = ("threads=1", f"prior={prior}", "method.count=2", "method.frames=4", "solver.max_iterations=3")
    result = deepir.run("recording", *changes, frames=film.frames)
    assert result.scene.shape == (2, *SIZE)
    assert "prior" in {row["stage"] for row in result.history}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("method.count=0", r"at least one burst of two frames"),
        ("method.frames=1", r"at least one burst of two frames"),
        ("method.bursts=3", r"no option 'bursts'"),
        ("problem=nuc", r"needs a problem of several data sets"),
    ],
)
def test_a_wrong_choice_is_refused(film, change, message):
    with pytest.raises(ConfigError, match=message):
        deepir.run("recording", change, *QUICK, frames=film.frames)


def test_a_recording_that_does_not_move_is_refused():
    rng = np.random.default_rng(0)
    still = 8000 + 50 * rng.standard_normal(SIZE) + rng.standard_normal((20, *SIZE))
    with pytest.raises(DataError, match=r"none of 2 bursts registers"):
        deepir.run("recording", *QUICK, frames=still.astype(np.float32))
