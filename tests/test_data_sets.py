"""Configurations of several data sets."""

import functools
import json

import numpy as np
import pytest
import torch

import deepir
from deepir.errors import ConfigError, DataError
from deepir.operators import Downsample, Warp
from deepir.operators.warp import to_pixels
from deepir.simulate.scenes.procedural import procedural
from deepir.storage.stored import resume

NOISE = 0.05  # of a sample of the finer camera; of the coarse one, whose pixels are four times as large, half of it
QUICK = ("threads=1",)
#: Where the coarse camera looks, in px of the scene.
RELATIVE = np.array([[0.9997, -0.0262, 3.3], [0.0262, 0.9997, -2.4], [0, 0, 1]])
ALONE = {"physics": {"warp": {"motion": {"type": "rigid"}}}}


@pytest.fixture(scope="module")
def scene():
    """A scene of 112 x 112 px; its middle is what the finer camera shows."""
    return torch.from_numpy(procedural(3, (112, 112)))[None, None].double()


@pytest.fixture(scope="module")
def pair(tmp_path_factory, scene):
    """Arguments for the files of both cameras, and the scene on the finer one's grid."""
    tmp_path, rng = tmp_path_factory.mktemp("pair"), np.random.default_rng(1)
    warp = Warp((64, 64), (112, 112), (24, 24))
    fine = warp(scene, motion=torch.eye(3)[None].double())[0, 0].numpy()
    coarse = Downsample(factor=2)(warp(scene, motion=torch.from_numpy(RELATIVE)[None]))[0, 0].numpy()
    np.save(tmp_path / "fine.npy", (fine + NOISE * rng.standard_normal(fine.shape)).astype(np.float32))
    units = 200 + 90 * (coarse + NOISE / 2 * rng.standard_normal(coarse.shape))  # of its own
    np.save(tmp_path / "coarse.npy", units.astype(np.float32))
    truth = to_pixels(scene)[0, 0, 24:88, 24:88].numpy()
    files = f"data.path={tmp_path / 'fine.npy'}", f"datasets.coarse.data.path={tmp_path / 'coarse.npy'}"
    return files, truth


def quality(result, truth):
    """Peak signal-to-noise ratio, dB; the scene spans one."""
    error = (result.scene - truth)[4:-4, 4:-4]
    return -10 * np.log10(np.mean(error**2))


@pytest.fixture(scope="module")
def solved(pair):
    """The result of one camera, or of both, by a prior; each is solved once."""

    @functools.cache
    def run(both, prior):
        (fine, coarse), _ = pair
        config, files = ("two_cameras", (fine, coarse)) if both else (ALONE, (fine,))
        return deepir.run(config, *files, f"prior={prior}", *QUICK)

    return run


@pytest.mark.parametrize("prior", ["tv", "siren"])
def test_two_cameras_show_a_scene_better_than_the_finer_one(pair, solved, prior):
    both = solved(True, prior)
    assert quality(both, pair[1]) > quality(solved(False, prior), pair[1]) + 1
    assert both.extra["coarse_motion"][0] == pytest.approx(RELATIVE, abs=0.1)
    assert both.extra["coarse_gain"].mean() == pytest.approx(90, rel=0.05)


def test_a_warp_that_is_known_needs_no_registration(pair, solved, tmp_path):
    (fine, coarse), truth = pair
    np.save(tmp_path / "warp.npy", RELATIVE[None])
    known = f"datasets.coarse.physics.warp.motion={{type: constant, path: {tmp_path / 'warp.npy'}}}"
    result = deepir.run("two_cameras", fine, coarse, known, "prior=tv", *QUICK)
    assert result.extra["coarse_motion"][0] == pytest.approx(RELATIVE)
    assert quality(result, truth) > quality(solved(False, "tv"), truth) + 1


def test_a_data_set_may_have_a_scene_of_its_own_and_name_an_unknown(pair, tmp_path):
    (fine, _), _ = pair
    sensor = {"gain": {"type": "pixel", "sigma": 0.02}}
    shared = {"sensor": {"gain": {"unknown": "gain"}}}
    config = {
        "physics": {"sensor": sensor},
        "datasets": {"second": {"data": {"path": fine[10:]}, "physics": shared, "scene": "own"}},
        "solver": {"max_iterations": 3},
    }
    result = deepir.run(config, fine, *QUICK)
    assert result.extra["second_scene"].shape == result.scene.shape
    assert "second_gain" not in result.extra
    assert result.gain.std() > 0


def test_an_interrupted_run_of_two_cameras_goes_on(pair, solved, tmp_path):
    files, _ = pair
    folder = tmp_path / "run"

    def stop(progress):
        if progress.iteration == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        deepir.run("two_cameras", *files, f"output.dir={folder}", "prior=tv", *QUICK, callbacks=[stop])
    assert len(json.loads((folder / "run.json").read_text())["inputs"]) == 2
    assert np.array_equal(resume(folder).scene, solved(True, "tv").scene)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (["datasets.coarse.physics.warp.motion=affin"], r"datasets.coarse: physics.warp.motion: no field is called"),
        (["datasets.coarse.physics.warp=null"], r"begin with a stage 'warp' in each"),
        (["datasets.coarse.physics.sensor.gain={unknown: gain}"], r"no unknown 'gain' in the data sets before"),
        (["datasets.coarse.physics.sensor.gain={unknown: motion}"], r"'motion' is \(1, 3, 3\), which does not fit"),
        (["method=average"], r"method 'average' takes one data set"),
        (["problem=deconv"], r"problem 'deconv' takes one data set; take problem=generic"),
    ],
)
def test_mistakes_are_named_with_their_data_set(pair, changes, message):
    files, _ = pair
    with pytest.raises(ConfigError, match=message):
        deepir.run("two_cameras", *files, *changes, *QUICK)


def test_data_that_are_missing_or_show_something_else_are_named(pair, tmp_path):
    (fine, _), _ = pair
    with pytest.raises(DataError, match=r"datasets.coarse.data.path is missing"):
        deepir.run("two_cameras", fine, *QUICK)
    np.save(tmp_path / "coarse.npy", np.random.default_rng(0).standard_normal((32, 32)).astype(np.float32))
    with pytest.raises(DataError, match=r"datasets.coarse: its first frame does not register"):
        deepir.run("two_cameras", fine, f"datasets.coarse.data.path={tmp_path / 'coarse.npy'}", *QUICK)
