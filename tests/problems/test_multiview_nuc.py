"""Frames of different scenes: the pattern that they share, without registration."""

import numpy as np
import pytest
import tifffile
from PIL import Image

import deepir
from deepir.errors import ConfigError, DataError
from deepir.simulate import Settings, simulate
from deepir.simulate.recording import RecordingSettings, residual_pattern, simulate_recording
from deepir.simulate.scenes.procedural import load_picture

QUICK = {"threads": 1, "solver": {"max_iterations": 2}}
ONE = {"threads": 1}
PICTURES = "camera,moon,gravel,astronaut,grass,procedural:1,procedural:2,procedural:3,procedural:4,procedural:5"


def views(pictures=PICTURES, **more):
    """A frame of each picture; the pattern is an offset of 3 % at pixels, 2 % at columns and rows."""
    settings = {
        "n_frames": pictures.count(",") + 1, "shape": (64, 80), "own_scenes": True, "offset_pixel": 0.03,
        "offset_column": 0.02, "offset_row": 0.02, "gain_pixel": 0.0, "gain_column": 0.0, "shading": 0.0,
        "dead_pixels": 0.0,
    }  # fmt: skip
    return simulate(load_picture(pictures), Settings(**settings | more), seed=1)


def likeness(first, second):
    return np.corrcoef(first.ravel(), second.ravel())[0, 1]


def pattern(sensor, level):
    return sensor.gain * level + sensor.offset


@pytest.fixture(scope="module")
def sim():
    """Ten frames of 64 x 80 px."""
    return views()


@pytest.fixture(scope="module")
def folder(sim, tmp_path_factory):
    """With `views.npz`, `views_truth.npz`, and the run of `result`."""
    found = tmp_path_factory.mktemp("views")
    sim.save(found / "views.npz")
    return found


@pytest.fixture(scope="module")
def result(folder):
    data = {"path": str(folder / "views.npz"), "truth": str(folder / "views_truth.npz")}
    return deepir.run("multiview_nuc", data=data, output={"dir": str(folder / "run")}, **ONE)


# ---- the sensor ----


def test_the_pattern_of_ten_pictures_is_found(sim, result):
    level = sim.frames.mean()
    assert likeness(sim.frames.mean(0), pattern(sim.truth, level)) < 0.7  # what the frames' mean shows
    assert likeness(pattern(result, level), pattern(sim.truth, level)) > 0.95


def test_strengths_and_noise_are_found_from_the_frames_and_a_strength_that_is_given_stays(sim, result):
    found = result.metrics["strengths"]
    assert found["offset.pixel.sigma"] == pytest.approx(0.03, rel=0.15)
    assert found["offset.column.sigma"] == pytest.approx(0.02, rel=0.3)
    assert found["offset.row.sigma"] == pytest.approx(0.02, rel=0.3)
    assert result.metrics["noise_sigma"] == pytest.approx(sim.truth.read_noise, rel=0.4)
    given = deepir.run("multiview_nuc", "physics.sensor.offset.pixel.sigma=0.05", frames=sim.frames, **QUICK)
    assert given.metrics["strengths"]["offset.pixel.sigma"] == 0.05


def test_more_frames_show_the_pattern_better(sim, result):
    five = deepir.run("multiview_nuc", frames=sim.frames[:5], **QUICK)
    level = sim.frames.mean()
    few, many = (likeness(pattern(each, level), pattern(sim.truth, level)) for each in (five, result))
    assert 0.9 < few < many


@pytest.mark.parametrize(("order", "unit"), [(-1, 1), (1, 1000)], ids=["the last frame first", "in counts"])
def test_neither_order_nor_unit_of_the_frames_matters(sim, result, order, unit):
    found = deepir.run("multiview_nuc", frames=unit * sim.frames[::order], **ONE)
    assert likeness(found.offset, result.offset) > (0.9999 if unit == 1 else 0.999)
    assert np.abs(found.scene[::order] / unit - result.scene).max() < 0.01


def test_levels_of_the_frames_do_not_matter_to_an_offset(sim):
    levels = np.arange(len(sim.frames), dtype=np.float32)[:, None, None]
    plain, shifted = (
        deepir.run("multiview_nuc", "physics.sensor.gain=1", frames=frames, **QUICK).offset
        for frames in (sim.frames, sim.frames + levels)
    )
    assert likeness(plain, shifted) > 0.999


def test_gain_is_separated_from_offset_by_scenes_of_different_levels():
    """With a pedestal of 8,000 counts a gain of 3 % is a pattern of 250, which the scenes' 1,500 change by a fifth."""
    sim = views(counts=True, gain_pixel=0.03, gain_column=0.01, offset_pixel=0.003)
    result = deepir.run("multiview_nuc", frames=sim.frames, **QUICK)
    level = sim.frames.mean()
    assert likeness(pattern(result, level), pattern(sim.truth, level)) > 0.97
    assert likeness(result.gain, sim.truth.gain) > 0.9


def test_a_shading_that_is_stronger_than_the_slopes_of_the_scenes_is_the_sensors():
    sim = views(shading=0.4)
    plain, shaded = (
        deepir.run("multiview_nuc", f"physics.sensor.offset={kind}", frames=sim.frames, **QUICK)
        for kind in ("column+row+pixel", "column+row+shading+pixel")
    )
    first, second = (likeness(each.offset, sim.truth.offset) for each in (plain, shaded))
    assert second > 0.9
    assert second > first + 0.3


def test_pixels_that_are_no_sensors_are_found():
    sim = views(dead_pixels=0.01)
    found, true = deepir.run("multiview_nuc", frames=sim.frames, **QUICK).bad_pixels, sim.truth.bad_pixels
    assert (found & true).sum() > 0.9 * true.sum()
    assert (found & ~true).sum() <= 0.001 * true.size


def test_a_mask_is_kept_out(sim):
    frames = sim.frames.copy()
    frames[:, 20:30, 30:45] = np.nan
    result = deepir.run("multiview_nuc", frames=frames, **QUICK)
    good = ~result.bad_pixels
    assert (~good).sum() == 150
    assert likeness(result.offset[good], sim.truth.offset[good]) > 0.93


# ---- the scenes ----


def test_each_frame_has_a_scene_of_its_own(sim, result):
    assert result.scene.shape == sim.truth.scene.shape == (10, 64, 80)
    assert result.uncertainty["scene"].shape == (10, 64, 80)
    raw = deepir.run("multiview_nuc", frames=sim.frames, truth=sim.truth.scene, method="average").metrics
    assert result.metrics["psnr_aligned"] > raw["psnr_aligned"] + 9
    assert result.metrics["ssim_aligned"] > 0.93


def test_files_hold_all_scenes_and_pictures_show_some(folder, result):
    assert np.load(folder / "run/result.npz")["scene"].shape == (10, 64, 80)
    assert tifffile.imread(folder / "run/scene.tiff").shape == (10, 64, 80)
    with Image.open(folder / "run/scene_preview.png") as shown:
        assert shown.size == (160, 128)
    assert (folder / "run/summary.png").stat().st_size > 10_000


def test_frames_and_their_truths_are_selected_together():
    simulated = {"own_scenes": True, "n_frames": 4, "shape": [32, 40]}
    data = {"simulate": simulated, "frames": [0, 2, 3], "crop": [4, 28, 2, 38]}
    result = deepir.run("multiview_nuc", data=data, **QUICK)
    assert result.scene.shape == (3, 24, 36)
    assert "psnr" in result.metrics


# A penalty and a network; `test_matrix.py` runs all.
@pytest.mark.parametrize("prior", ["foe", "siren"])
def test_each_frame_has_a_scene_of_its_own_whatever_the_prior(prior):
    frames = np.random.default_rng(0).random((3, 24, 32))
    result = deepir.run("multiview_nuc", frames=frames, prior=prior, **QUICK)
    assert np.isfinite(result.scene).all()
    assert np.abs(result.scene[0] - result.scene[1]).max() > 0


def test_better_priors_give_better_scenes():
    sim = views(read_noise=0.03)
    error = {
        prior: np.std(deepir.run("multiview_nuc", frames=sim.frames, prior=prior, **ONE).scene - sim.truth.scene)
        for prior in ("pixels", "tv", "red")
    }
    assert error["red"] < error["tv"] < error["pixels"]


# ---- what it says ----


def test_one_frame_and_frames_that_are_all_the_same_are_refused(sim):
    noise = 0.003 * np.random.default_rng(0).standard_normal((6, 64, 80))
    with pytest.raises(DataError, match=r"1 frame\(s\), but this needs at least 2$"):
        deepir.run("multiview_nuc", frames=sim.frames[:1])
    with pytest.raises(DataError, match="the frames all show the same"):
        deepir.run("multiview_nuc", frames=sim.frames[:1] + noise)


def test_frames_of_one_scene_and_few_frames_are_warned_of_different_ones_are_not(sim, result):
    alike = simulate(None, Settings(n_frames=5, shape=(64, 80), max_shift=4.0), seed=1).frames
    of_one, of_few = (deepir.run("multiview_nuc", frames=each, **QUICK).messages for each in (alike, sim.frames[:3]))
    assert any("much alike" in each and "data.frames=::10" in each for each in of_one)
    assert any(each.startswith("3 frames: what each pixel has of its own") for each in of_few)
    assert result.messages == []


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("scene.shared=true", "scene.shared: 'multiview_nuc' is for frames of different scenes"),
        ("scene.shared=2", "scene.shared = 2: true or false is needed"),
        ("physics.sensor.offset=pixels", "physics.sensor.offset: 'multiview_nuc' finds sums of"),
        ("physics.sensor.gain=column+shading", "physics.sensor.gain: 'multiview_nuc' finds sums"),
        ("physics.sensor={gain: 1, offset: 0}", "gain and offset are both known"),
    ],
)  # fmt: skip
def test_what_cannot_work_is_refused(sim, change, message):
    with pytest.raises(ConfigError, match=message):
        deepir.run("multiview_nuc", change, frames=sim.frames)


# ---- recordings ----


def recording(kind, shape, count):
    """A camera whose shutter has closed just before."""
    settings = RecordingSettings(kind=kind, n_frames=count, frame_rate=15, shape=shape, shutter_every=60.0, drift=0.01)
    return simulate_recording(settings, seed=7)


@pytest.mark.slow
def test_a_drive_is_not_made_worse():
    drive = recording("drive", (96, 112), 120)
    result = deepir.run("multiview_nuc", frames=drive.frames, data={"frames": "::12"}, **QUICK)
    corrected = (drive.frames - result.offset) / result.gain
    assert residual_pattern(corrected, drive) < residual_pattern(drive.frames, drive)
    assert np.median(np.abs(corrected[::12] - result.scene)) < 10 * drive.truth.noise
    assert "without its low-order part" in result.messages[0]


def test_a_camera_at_rest_is_refused():
    with pytest.raises(DataError, match="from a camera at rest"):
        deepir.run("multiview_nuc", frames=recording("tripod", (64, 80), 48).frames[::6], **QUICK)
