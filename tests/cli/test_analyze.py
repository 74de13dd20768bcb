"""`deepir analyze`."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from deepir.simulate import Settings, simulate


@pytest.fixture(scope="session")
def simulated(tmp_path_factory):
    """Bursts that move as they should, and not; and a flat stack."""
    folder = tmp_path_factory.mktemp("bursts")
    camera = {"n_frames": 6, "shape": (64, 80), "counts": True}
    for name, jitter in {"both": "both", "along_x": "x"}.items():
        simulate(None, Settings(**camera, jitter=jitter), seed=1).save(folder / f"{name}.npz")
    rng = np.random.default_rng(0)
    pattern = 40 * rng.standard_normal((64, 80)) + 40 * rng.standard_normal((1, 80))
    np.save(folder / "flat.npy", 8000 + pattern + 5 * rng.standard_normal((12, 64, 80)))
    return folder


@pytest.fixture
def bursts(folder, simulated):
    """The same in the working folder."""
    shutil.copytree(simulated, folder, dirs_exist_ok=True)


def test_a_burst_that_suffices(deepir, bursts):
    status, out, _ = deepir("analyze", "both.npz")
    assert status == 0
    assert "move the camera between frames by more than 3 px in x and 3 px in y" in out
    assert "this burst suffices" in out
    with Image.open("both_analysis.png") as picture:
        assert picture.width > 600


def test_a_burst_along_one_axis_is_flagged(deepir, bursts):
    _, out, _ = deepir("analyze", "along_x.npz", "--output", "here.png")
    assert "moves along x only" in out
    assert "suffices" not in out
    assert Path("here.png").stat().st_size > 10_000


def test_a_run_is_analysed_as_it_is(deepir, bursts):
    deepir("run", "nuc", "data.path=both.npz", "output.dir=runs/mine", "solver.max_iterations=3")
    folder = Path("runs/mine")
    before = [path.name for path in folder.iterdir()]
    status, out, _ = deepir("analyze", "runs/mine")
    assert status == 0
    assert "this burst: 6 frames" in out
    assert "takes no settings" in deepir("analyze", "runs/mine", "seed=1")[2]
    assert sorted([*before, "analysis.png"]) == sorted(path.name for path in folder.iterdir())


def test_a_flat_stack_says_for_how_long_the_pattern_holds(deepir, bursts):
    status, out, _ = deepir("analyze", "flat.npy", "--flat")
    assert status == 0
    assert "columns 4" in out or "columns 5" in out
    assert "the pattern is stable for longer than the 6 frames over which it was measured" in out
    assert "this burst" not in out
    assert "than the 3 frames" in deepir("analyze", "flat.npy", "data.frames=6", "--flat", "--overwrite")[1]


def stored(name, *, scene, motion):
    rng = np.random.default_rng(0)
    maps = {"gain": np.ones((64, 80)), "offset": rng.standard_normal((64, 80)), "bad_pixels": np.zeros((64, 80), bool)}
    Path(name).mkdir()
    np.savez(Path(name, "result.npz"), scene=scene, motion=motion, **maps)
    np.savez(Path(name, "uncertainty.npz"), scene=np.ones(scene.shape))


def test_runs_in_which_nothing_moves_before_the_pattern_are_not_judged_by_their_motion(deepir, folder):
    stored("one", scene=np.ones((64, 80)), motion=np.full((1, 3, 3), np.nan))
    stored("many", scene=np.ones((4, 64, 80)), motion=np.tile(np.eye(3), (4, 1, 1)))
    for name in ("one", "many"):
        status, out, err = deepir("analyze", name)
        assert status == 0, err
        assert "pattern: standard deviation" in out
        assert "this burst" not in out
