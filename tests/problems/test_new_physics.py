"""Physics of a few lines of YAML, with the prior's weight from held-out samples."""

from pathlib import Path

import numpy as np
import pytest
import skimage.data
import skimage.transform
import torch
from documentation import ROOT, files

import deepir
from deepir import operators as op
from deepir import priors as pr

PAGE = files(ROOT / "docs/how-to/extending.md")
NOISE = 0.02
SIZE = (64, 64)


def picture(name, size=SIZE):
    """A public picture in [0, 1]."""
    return skimage.transform.resize(getattr(skimage.data, name)().astype(float) / 255, size, anti_aliasing=True)


@pytest.fixture
def noisy(tmp_path, monkeypatch):
    """A folder to work in; saves arrays, and adds noise to frames."""
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(0)

    def save(frames, noise=NOISE, **arrays):
        for name, array in ({"frames": frames + noise * rng.standard_normal(frames.shape)} | arrays).items():
            np.save(f"{name}.npy", np.asarray(array, np.float32))

    return save


def run(text, **options):
    """The result of a configuration given as YAML."""
    Path("problem.yaml").write_text(text, encoding="utf-8")
    return deepir.run("problem.yaml", threads=1, output={"dir": None}, **options)


def psnr(found, truth):
    return -10 * np.log10(np.mean((np.squeeze(found) - truth) ** 2))


@pytest.mark.parametrize("unit", [1, 1000])
def test_two_scenes_are_told_apart_by_a_filter_wheel_whatever_the_unit(noisy, unit):
    x, s, a = picture("camera"), picture("coins"), np.array([1, 0.7, 0.4, 0.1])[:, None, None]
    noisy(unit * (a * x + (1.1 - a) * s), unit * NOISE, a=a, b=1.1 - a)
    result = run(PAGE["wheel.yaml"])
    direct = np.linalg.lstsq(
        np.stack([a.ravel(), 1.1 - a.ravel()], 1), np.load("frames.npy").reshape(4, -1), rcond=None
    )[0]
    for found, truth, unregularised in zip((result.scene, result.extra["s"]), (x, s), direct, strict=True):
        assert psnr(found / unit, truth) > psnr(unregularised.reshape(SIZE) / unit, truth) + 1


def test_the_weight_that_held_out_samples_choose_is_near_the_best(noisy):
    scene = picture("camera", (96, 96))
    path = np.cumsum(np.random.default_rng(1).standard_normal((3, 12, 2)), 1) * 0.9
    path -= path[:, :1]
    blur = op.PathBlur(margin=16)
    frames = blur(torch.from_numpy(scene)[None, None], path=torch.from_numpy(path)[:, None])[:, 0].numpy()
    noisy(frames, paths=path)
    text, truth = PAGE["shake.yaml"], scene[16:-16, 16:-16]
    found = run(text)
    tried = {weight: run(text, scene={"penalties": {"tv": weight}}) for weight in (2.0, 8.0, 32.0)}
    best = max(psnr(each.scene, truth) for each in tried.values())
    assert psnr(found.scene, truth) > best - 0.5
    least = min(tried.values(), key=lambda each: each.metrics["held_out_rmse"])
    assert psnr(least.scene, truth) == best


def test_a_single_pixel_sees_a_picture(noisy):
    scene, rng = picture("camera", (24, 24)), np.random.default_rng(2)
    matrix = rng.choice([-1, 1], (288, 576)) / 24
    noisy((matrix @ scene.ravel())[:, None], 0.005, matrix=matrix)
    result = run(
        "physics: {matrix: {height: 24, width: 24, rows: 288, matrix: {type: constant, path: matrix.npy}}}\n"
        "data: {path: frames.npy}\nprior: tv"
    )
    least_norm = np.linalg.lstsq(matrix, np.load("frames.npy").ravel(), rcond=None)[0].reshape(24, 24)
    assert psnr(result.scene, scene) > psnr(least_norm, scene) + 3


def test_a_mosaic_of_bands_is_filled_in(noisy):
    x, s = picture("camera"), picture("coins")
    bands = np.stack([x, (x + s) / 2, s])
    seen = np.arange(64 * 64).reshape(64, 64) % 3 == np.arange(3)[:, None, None]
    noisy(np.where(seen, bands, np.nan))
    result = run("physics: {}\nscene: {shared: false}\ndata: {path: frames.npy}\nprior: tv")
    mean = np.where(seen, np.load("frames.npy"), 0).sum((1, 2), keepdims=True) / seen.sum((1, 2), keepdims=True)
    assert psnr(result.scene, bands) > psnr(np.broadcast_to(mean, bands.shape), bands) + 6


def test_a_motion_of_each_pixel_is_read_from_a_file(noisy):
    scene = picture("camera", (96, 96))
    rows, columns = np.mgrid[:64, :64] - 31.5
    shift = np.arange(64)[None, :, None] / 64 * np.array([0, 12, -12.0])[:, None, None]
    points = np.stack(np.broadcast_arrays(columns + shift, rows), -1)
    warp = op.Warp.around(torch.from_numpy(points), SIZE)
    coefficients = torch.from_numpy(scene)[None, None]
    canvas = torch.nn.functional.interpolate(coefficients, warp.canvas, mode="bilinear")
    noisy(warp(canvas, motion=torch.from_numpy(points))[:, 0].numpy(), points=points)
    text = "data: {path: frames.npy}\nprior: tv\nphysics: {warp: {motion: {type: constant, path: points.npy}}}"
    truth = warp.to_pixels(canvas)[0, 0].numpy()[8:72, warp.origin[1] : warp.origin[1] + 64]
    assert (
        psnr(run(text).scene, truth) > psnr(run("data: {path: frames.npy}\nprior: tv\nphysics: {}").scene, truth) + 10
    )


def test_exposures_show_what_the_long_one_cuts_off(noisy):
    scene, times = 1.5 * picture("camera") + 0.02, np.array([0.2, 2.0])[:, None, None]
    noisy(np.zeros((2, *SIZE)), 0.01, time=times)
    frames = np.minimum(times * scene + np.load("frames.npy"), 1)
    np.save("frames.npy", frames.astype(np.float32))
    result = run(
        "physics: {exposure: {time: {type: constant, path: time.npy}}}\nnoise: {read: 0.01}\n"
        "data: {path: frames.npy}\nprior: tv"
    )
    weights = times**2 * (frames < 1)
    assert psnr(result.scene, scene) > psnr((weights * frames / times).sum(0) / weights.sum(0), scene) + 2


def jittered(frames=5, size=SIZE, sigma=4.0):
    """A scene, and the motions of frames that show it; the scene reaches far beyond them."""
    motion = torch.eye(3, dtype=torch.float64).repeat(frames, 1, 1)
    motion[1:, :2, 2] = sigma * torch.from_numpy(np.random.default_rng(3).standard_normal((frames - 1, 2)))
    reach = 24
    canvas = (size[0] + 2 * reach, size[1] + 2 * reach)
    scene = torch.from_numpy(picture("camera", canvas))[None, None]
    return scene, motion, {"size": size, "canvas": canvas, "origin": (reach, reach)}


def seen_by_frame_0(warp, scene):
    y, x = warp.origin
    return warp.to_pixels(scene)[0, 0, y : y + warp.size[0], x : x + warp.size[1]].numpy()


def test_a_rolling_shutter_is_undone_and_its_readout_found(noisy):
    scene, motion, place = jittered()
    shutter = op.RollingShutter(**place)
    readout = torch.full((1, 1, 1, 1), 0.8, dtype=torch.float64)
    noisy(shutter(scene, motion=motion, readout=readout)[:, 0].numpy(), 0.01)
    truth, text = seen_by_frame_0(shutter, scene), "data: {path: frames.npy}\nprior: tv\nphysics: "
    moved = "motion: {type: shift, init: register}"
    whole = run(f"{text}{{warp: {{{moved}}}}}")
    rows = run(f"{text}{{rolling_shutter: {{{moved}, readout: {{type: uniform, init: 0.4}}}}}}")
    assert rows.extra["readout"] == pytest.approx(0.8, abs=0.05)
    assert psnr(rows.scene[4:-4, 4:-4], truth[4:-4, 4:-4]) > psnr(whole.scene[4:-4, 4:-4], truth[4:-4, 4:-4]) + 6


def test_frames_of_different_sharpness_give_one_sharp_scene(noisy):
    radius = 5
    scene, motion, place = jittered(size=(64 + 2 * radius, 64 + 2 * radius))
    warp = op.Warp(**place)
    shape = (1, 1, 2 * radius + 1, 2 * radius + 1)
    psf = torch.cat([pr.Gaussian(shape, size=SIZE, sigma=sigma)() for sigma in (0.5, 0.7, 1.2, 1.7, 2.0)])
    blurred = (op.Blur(radius=radius, per_frame=True) @ warp)(
        scene, **{"warp.motion": motion, "blur.psf": psf.detach().double()}
    )
    noisy(blurred[:, 0].numpy(), 0.005)
    truth = seen_by_frame_0(warp, scene)[radius:-radius, radius:-radius]
    text = "data: {path: frames.npy}\nprior: tv\nphysics:\n  warp: {motion: {type: shift, init: register}}\n"
    one = run(text)
    each = run(f"{text}  blur: {{radius: {radius}, per_frame: true, psf: {{type: gaussian}}}}")
    assert psnr(each.scene[4:-4, 4:-4], truth[4:-4, 4:-4]) > psnr(one.scene[4:-4, 4:-4], truth[4:-4, 4:-4]) + 4


def test_frames_that_are_registered_have_a_least_size(noisy):
    noisy(np.zeros((3, 8, 8)))
    with pytest.raises(deepir.DeepIRError, match="8 x 8 px is too small"):
        run("data: {path: frames.npy}\nprior: tv\nphysics: {warp: {motion: {type: shift}}}")
