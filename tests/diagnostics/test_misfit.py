"""What the model has missed is named: score tests of the residuals."""

import numpy as np
import pytest
from scipy import ndimage

import deepir
from deepir.diagnostics.misfit import CAUSES, MIN_MISFIT, misfit
from deepir.simulate import Settings, simulate
from tests.effects.solved import burst, solved

CAMERA = {"n_frames": 6, "shape": (96, 128)}
N, H, W = 6, 72, 80


def named(result):
    return [each.name for each in result.messages if each.name in {cause.name for cause in CAUSES}]


def look(picture, at, dy=0.0, dx=0.0):
    """What a camera at `at` sees, its samples displaced by (dy, dx), px."""
    y, x = np.mgrid[:H, :W].astype(float)
    return ndimage.map_coordinates(picture, [y + 40 + at[0] + dy, x + 40 + at[1] + dx], order=3)


def displaced(rng, kind):
    """Frames of a moving camera, and the same with a fault and noise."""
    picture = ndimage.gaussian_filter(rng.normal(size=(160, 170)), 1.5) * 300
    at = rng.uniform(-8, 8, (N, 2))
    y, x = np.mgrid[:H, :W]
    right = np.stack([look(picture, each) for each in at])
    wrong = right.copy()
    for k in range(N):
        if kind == "rows-displaced":
            wrong[k] = look(picture, at[k], 0, rng.normal(0, 0.3, (H, 1)) + 0 * x)
        elif kind in ("interlaced-frames", "subpage-frames"):
            wrong[k] = look(picture, at[k], 0.4 * (((kind[0] == "s") * x + y) % 2 - 0.5))
        elif kind == "frames-bend":
            wrong[k] = look(picture, at[k], *(rng.uniform(-0.03, 0.03) * (each - each.mean()) for each in (y, x)))
        elif kind == "parallax":
            wrong[k] = look(picture, at[k], 0.3 * np.sin(x / 12), 0.3 * np.cos(y / 15))
        elif kind == "unsharp-frames" and k > 3:
            wrong[k] = ndimage.gaussian_filter(right[k], 0.8)
        elif kind == "thermal-lag" and k:
            wrong[k] = 0.8 * right[k] + 0.2 * wrong[k - 1]
        elif kind == "torn-frames" and k == 4:
            wrong[k, 30:] = right[3, 30:]
        elif kind == "shading-changes":
            wrong[k] += 12 * np.sin(x / 25 + rng.uniform(0, 6)) * np.cos(y / 25 + rng.uniform(0, 6))
    return right, wrong + rng.normal(0, 4, right.shape)


@pytest.mark.parametrize("kind", [*(cause.name for cause in CAUSES), ""])
@pytest.mark.parametrize("seed", range(3))
def test_each_cause_has_the_most_evidence_for_its_own_fault(kind, seed):
    right, wrong = displaced(np.random.default_rng(seed), kind)
    left = wrong - right
    precision = np.full_like(left, 1 / 16)
    message, nats, _ = misfit(left, precision, precision, right, np.ones((1, H, W)))
    assert (message.name if nats > MIN_MISFIT else "") == kind


@pytest.mark.parametrize(
    ("seed", "camera"), [(3, CAMERA), (4, CAMERA | {"n_frames": 8, "shading": 0.1, "dead_pixels": 0.002})]
)
def test_a_burst_without_a_fault_has_no_message_and_is_used_whole(seed, camera):
    result, _ = solved(seed=seed, **camera)
    assert result.messages == []
    assert result.frames_used.all()


def test_a_cloud_that_moves_by_itself_is_reported():
    k, y, x = np.mgrid[:6, :96, :128]
    frames = burst(**CAMERA).frames + 60 * np.exp(-((x - 20 - 12 * k) ** 2 + (y - 40) ** 2) / 800)
    assert named(deepir.run("nuc", frames=frames, threads=1)) == ["shading-changes"]


def test_slow_pixels_are_reported_as_such():
    frames = burst(**CAMERA).frames.astype(float)
    for k in range(1, len(frames)):
        frames[k] = 0.75 * frames[k] + 0.25 * frames[k - 1]
    assert named(deepir.run("nuc", frames=frames, threads=1)) == ["thermal-lag"]


def test_unsharp_frames_are_numbered():
    sim = burst(**CAMERA)
    flux = (sim.frames[4:] - sim.truth.offset) / sim.truth.gain
    frames = sim.frames + np.random.default_rng(0).normal(0, 1, sim.frames.shape)
    frames[4:] += sim.truth.gain * (ndimage.gaussian_filter(flux, (0, 1.2, 1.2)) - flux)
    (message,) = [each for each in deepir.run("nuc", frames=frames, threads=1).messages if "sharp" in each]
    assert message.name == "unsharp-frames"
    assert message.endswith("(frames 4, 5)")


@pytest.mark.parametrize("motion", [1.0, 3.0])
def test_interlaced_frames_are_reported_and_every_second_row_of_them_is_sound(motion):
    camera = Settings(n_frames=10, shape=(80, 96), max_shift=motion, shading=0.0, dead_pixels=0.0)
    frames = simulate(None, camera, seed=3).frames.astype(np.float32)
    both = frames[::2].copy()
    both[:, 1::2] = frames[1::2, 1::2]
    assert named(deepir.run("nuc", frames=both, threads=1)) == ["interlaced-frames"]
    assert named(deepir.run("nuc", frames=both[:, ::2], threads=1)) == []
