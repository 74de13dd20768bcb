"""How far off the motion of simulated bursts is found: patterns, weak texture, objects that move, small and large."""

import itertools

import numpy as np
import pytest
import torch
from registered import COUNTS, FAINT, SHAPE, TONES, TONES_IN_COUNTS, WALKER, errors, recorded, simulated

import deepir
from deepir.errors import DataError
from deepir.registration import motion_search, register
from deepir.simulate import optics
from deepir.simulate.scenes.procedural import procedural

PLAIN = {"shading": 0.0, "dead_pixels": 0.0}
DARK = PLAIN | {"n_frames": 3, "counts": True, "read_noise": 0.003, "offset_pixel": 0.04}
LARGE_WALKER = TONES_IN_COUNTS | {"shape": (96, 128), "walker": 0.6, "walker_contrast": 0.5}
SMALL = {"n_frames": 3, "counts": True, "max_shift": 4.0}


def bursts(kind, names, seeds, camera, *, most=0.4, marks=()):
    """Rows of the table: scenes, seeds, the camera, and how far off (px) a frame's corner may be."""
    return [
        pytest.param(name, seed, camera, most, id=f"{kind}-{name}-{seed}", marks=marks)
        for name, seed in itertools.product(names, seeds)
    ]


@pytest.mark.parametrize(
    ("name", "seed", "camera", "most"),
    [
        *bursts("faint", ["camera", "moon", "grass"], [1], FAINT | {"shape": SHAPE}),
        *bursts(
            "half the gain in columns",
            ["camera", "grass"],
            [1],
            {"gain_column": 0.5, "gain_distribution": "uniform", "gain_pixel": 0.0, "shape": SHAPE},
        ),
        *bursts("a tenth of the gain in pixels", ["grass"], [1], {"gain_pixel": 0.1, "shape": SHAPE}),
        *bursts("few photons", ["camera"], [1], {"photons": 150.0, "shape": SHAPE}),
        *bursts(
            "a quarter of the frame and eight degrees",
            ["camera", "astronaut", "grass"],
            [1],
            {"shape": SHAPE, "max_shift": 32.0, "max_rotation": 8.0},
            most=0.2,
        ),
        *bursts("clouds below the pattern", ["sky 1"], [12], PLAIN | {"n_frames": 3}),
        *bursts("clouds below the pattern", ["sky 2"], [12], PLAIN),
        *bursts("clouds below the pattern in counts", ["sky 3"], [12], PLAIN | {"n_frames": 3, "counts": True}),
        *bursts("bright slope", ["sky 1", "sky 2", "sky 4"], [31], TONES | {"n_frames": 3}),
        *bursts("clouds that look still", ["sky 1"], [30, 35], TONES_IN_COUNTS | {"n_frames": 3}),
        *bursts(
            "two of three frames are close",
            ["moon"],
            [31],
            TONES | {"n_frames": 3, "gain_row": 0.05, "offset_row": 0.05},
        ),
        *bursts("two of three frames are close", ["drawn 5 ** 4", "drawn 9 ** 6"], [79], DARK),
        *bursts("clouds that turn", ["sky 2"], [32], {"counts": True, "max_rotation": 6.0}),
        *bursts("figure", ["camera"], [41], TONES | {"n_frames": 3, "gain_column": 0.05, "max_rotation": 6.0}),
        *bursts("object", ["drawn 6"], [76], TONES | WALKER | {"n_frames": 10}),
        *bursts("object", ["moon"], [61], TONES | WALKER | {"n_frames": 10}),
        *bursts("object", ["moon"], [62], TONES | WALKER),
        *bursts("object", ["sky 6"], [52], TONES | WALKER | {"n_frames": 3}),
        *bursts("object", ["sky 1"], [30], TONES | WALKER, marks=pytest.mark.slow),
        *bursts("object", ["sky 5"], [1], TONES_IN_COUNTS | WALKER, marks=pytest.mark.slow),
        *bursts("object", ["sky 2"], [19], TONES_IN_COUNTS | WALKER | {"n_frames": 20}, marks=pytest.mark.slow),
        *bursts("quick object", ["moon"], [51], TONES_IN_COUNTS | WALKER | {"n_frames": 3, "walker_speed": 4.0}),
        *bursts("object before a camera at rest", ["drawn 5"], [5], LARGE_WALKER | {"max_shift": 0.0}, most=0.05),
        *bursts("object before a slow camera", ["drawn 5"], [5], LARGE_WALKER | {"max_shift": 2.0}),
        *bursts("24 x 32 px", [None], [1, 9], PLAIN | SMALL | {"shape": (24, 32)}),
        *bursts("33 x 47 px", [None], [1, 5, 7], PLAIN | SMALL | {"shape": (33, 47)}),
        *bursts("five of 33 x 47 px", [None], [7], PLAIN | SMALL | {"shape": (33, 47), "n_frames": 5}),
        *bursts("40 x 48 px with shading", [None], [1, 2, 3], SMALL | {"shape": (40, 48)}),
    ],
)
def test_the_motion_is_found_to_a_part_of_a_pixel(name, seed, camera, most):
    sim, frames = recorded(name, seed, **camera)
    result = register(frames)
    assert result.used.all()
    assert errors(result, sim.truth.motion, frames.shape[1:]).max() < most


@pytest.mark.parametrize(("seed", "step", "count"), [(2, 12, 8), (4, 15, 10), (5, 10, 14)])
def test_a_pan_by_up_to_the_whole_frame_is_followed_to_its_end(seed, step, count):
    scene, rng = procedural(seed, (130, 170 + step * count)), np.random.default_rng(seed)
    pattern = 1 + 0.03 * rng.normal(size=(120, 160)) + 0.03 * rng.normal(size=160)
    frames = np.stack([scene[k % 3 :, step * k :][:120, :160] * pattern for k in range(count)])
    frames += 0.004 * rng.normal(size=frames.shape)
    result = register(torch.from_numpy(frames.astype(np.float32)))
    assert result.used.all()
    true = np.array([(step * k, k % 3) for k in range(count)])
    assert np.abs(result.motion.numpy()[:, :2, 2] - true).max() < 0.3


def test_a_large_frame_is_registered_from_half_its_size(monkeypatch):
    frames, truth = simulated("camera", **COUNTS)
    monkeypatch.setattr(motion_search, "SEARCH_SIDE", 40)
    assert errors(register(frames), truth).max() < 0.3
    monkeypatch.setattr(motion_search, "MAX_FINAL_PIXELS", SHAPE[0] * SHAPE[1] // 3)
    assert errors(register(frames), truth).max() < 0.5


@pytest.mark.parametrize("shape", [(20, 400), (400, 20)])
def test_a_strip_is_registered_at_its_own_size(shape):
    _, frames = recorded(None, **PLAIN | SMALL | {"n_frames": 6, "shape": shape})
    assert register(frames).used.sum() > 2


@pytest.mark.parametrize("n_frames", [3, 5, 10])
def test_small_frames_that_do_not_move_are_refused(n_frames):
    camera = PLAIN | SMALL | {"n_frames": n_frames, "shape": (24, 32), "max_shift": 0.0}
    with pytest.raises(DataError, match=r"do not move|is it one scene"):
        deepir.run("nuc", frames=recorded(None, **camera)[0].frames, threads=1)


@pytest.mark.parametrize("settings", [{}, FAINT], ids=["unit", "faint"])
def test_a_burst_that_stands_still_is_found_still(settings):
    frames, _ = simulated("camera", **settings, n_frames=1)
    result = register(frames + 0.01 * frames.std() * torch.randn(5, *SHAPE))
    assert result.used.all()
    assert torch.equal(result.motion, torch.eye(3, dtype=torch.float64).expand(5, 3, 3))


@pytest.mark.parametrize(("name", "seed"), [("camera", 5), ("moon", 6)])
def test_pixels_that_flicker_do_not_set_a_still_burst_in_motion(name, seed):
    _, frames = recorded(name, seed, shape=(120, 160), counts=True, max_shift=0.0)
    result = register(frames)
    assert np.abs((result.motion.numpy() - np.eye(3))[result.used.numpy()]).max() < 0.1


@pytest.mark.parametrize("name", ["camera", "gravel"])
def test_frames_that_bend_are_registered_as_homographies(name):
    frames, truth = simulated(name, motion="homography", photons=1000.0)
    assert errors(register(frames), truth).max() > 1
    assert errors(register(frames, model="auto"), truth).max() < 0.3


def test_a_thousandth_of_keystone_is_found_in_three_frames(monkeypatch):
    monkeypatch.setattr(optics, "MAX_DEFORMATION", 0.002)
    frames, truth = simulated("gravel", n_frames=3, motion="homography", counts=True, offset_pixel=0.04)
    rigid = errors(register(frames), truth).max()
    assert errors(register(frames, model="auto"), truth).max() < min(0.2, rigid / 2)


@pytest.mark.parametrize(
    ("name", "seed", "camera"),
    [
        *[("camera", 1, {"shape": SHAPE, "n_frames": n, "max_rotation": 3.0}) for n in (2, 5)],
        ("sky 4", 33, TONES),  # lines and noise that look like a bend
        ("sky 5", 32, TONES_IN_COUNTS),
    ],
)
def test_frames_that_do_not_bend_are_rigid_to_the_bit(name, seed, camera):
    _, frames = recorded(name, seed, **{"photons": 1000.0} | camera)
    assert torch.equal(register(frames, model="auto").motion, register(frames).motion)
