"""Deconvolution: known blur, blur whose width is found, and a sensor that is unknown as well."""

import dataclasses

import numpy as np
import pytest
import torch
from cameras import clean
from scipy import signal
from skimage import data
from skimage.restoration import richardson_lucy, wiener

import deepir
from deepir.errors import ConfigError
from deepir.estimation.psf_from_spectrum import fit_psf, spectral_noise
from deepir.fields.psf import Airy, Defocus, Gaussian, MotionBlur
from deepir.metrics import scores
from deepir.simulate import simulate
from deepir.simulate.scenes.procedural import procedural


def camera(picture=None, **more):
    """A frame of 80 x 96 px with noise 30 dB below its standard deviation, and a truth without blur."""
    settings = clean(**{"n_frames": 1, "shape": (80, 96), "sharp": True, "psf_sigma": 1.5} | more)
    picture = procedural(5, (430, 500)) if picture is None else picture
    noise = float(simulate(picture, settings, seed=3).frames[0].std()) * 10**-1.5
    return simulate(picture, dataclasses.replace(settings, read_noise=noise), seed=3)


def psnr(scene, sim):
    return scores(scene, sim.truth.scene)["psnr"]


@pytest.fixture(scope="module")
def sim():
    return camera()


@pytest.fixture(scope="module")
def known(sim):
    """Its blur given."""
    psf = "physics.blur.psf={type: gaussian, sigma: 1.5, fixed: true}"
    return deepir.run("deconv", psf, frames=sim.frames, threads=1)


# ---- the result ----


def test_it_beats_richardson_lucy_and_wiener_tuned_on_the_truth(sim, known):
    psf = Gaussian((1, 1, 17, 17), size=(80, 96), sigma=1.5)().detach().numpy()[0, 0]
    frame = np.pad(sim.frames[0].astype(float), 16, mode="symmetric") + 0.05
    inside = np.s_[16:-16, 16:-16]
    lucy = [richardson_lucy(frame, psf, num_iter=n, clip=False) for n in (10, 20, 40, 80, 160)]
    wieners = [wiener(frame, psf, balance, clip=False) for balance in np.logspace(-4, -1, 13)]
    best = max(psnr(each[inside] - 0.05, sim) for each in (*lucy, *wieners))
    assert psnr(known.scene, sim) > best + 0.5
    assert best > psnr(sim.frames[0], sim) + 2


def test_a_width_that_is_found_is_as_good_as_the_true_one(sim, known):
    found = deepir.run("deconv", frames=sim.frames, threads=1)
    at = np.arange(17) - 8
    assert np.sqrt((found.extra["psf"] * at**2).sum()) == pytest.approx(1.5, rel=0.1)
    assert psnr(found.scene, sim) > psnr(known.scene, sim) - 0.5
    assert found.messages[0].startswith("one frame does not separate the sensor's pattern from the scene")
    assert np.array_equal(found.gain, np.ones((80, 96)))


def test_plug_and_play_is_better_than_total_variation():
    sim = camera(data.camera()[:430, :500] / 255, shape=(96, 128), psf_sigma=1.0)
    psf = "physics.blur.psf={type: gaussian, sigma: 1, fixed: true}"
    total_variation, pnp = (
        deepir.run("deconv", psf, f"prior={prior}", frames=sim.frames, threads=1) for prior in ("tv", "pnp")
    )
    assert psnr(pnp.scene, sim) > psnr(total_variation.scene, sim) + 0.3


def test_a_frame_that_is_sharp_is_reported_so():
    picture = data.camera()[:430, :500] / 255
    found = deepir.run("deconv", "solver.max_iterations=1", frames=camera(picture, psf_sigma=0.0).frames, threads=1)
    assert any("hardly any blur is found" in message for message in found.messages)


def test_a_burst_gives_a_sharp_scene_and_the_pattern():
    pattern = {"gain_pixel": 0.03, "offset_pixel": 0.03, "offset_column": 0.04}
    sim = camera(n_frames=4, shape=(64, 80), max_shift=6.0, motion="shift", **pattern)
    found = {name: deepir.run(name, frames=sim.frames, threads=1) for name in ("deconv", "nuc")}
    quality = {name: scores(each.scene, sim.truth.scene)["psnr_aligned"] for name, each in found.items()}
    assert quality["deconv"] > quality["nuc"] + 2
    level = sim.truth.scene.mean()
    true, ours = (each.gain * level + each.offset for each in (sim.truth, found["deconv"]))
    assert np.corrcoef(true.ravel(), ours.ravel())[0, 1] > 0.95


def test_what_lies_at_one_edge_does_not_come_out_at_the_other():
    scene = np.full((66, 80), 10.0)
    scene[:, :12] = 30.0  # light that falls in from the left
    psf = np.outer(*[signal.windows.gaussian(17, 2.0)] * 2)
    frame = signal.convolve2d(scene, psf / psf.sum(), mode="valid")[None]
    noisy = frame + 0.05 * np.random.default_rng(0).standard_normal(frame.shape)
    options = ["physics.blur.psf={type: gaussian, sigma: 2, fixed: true}", "noise={read: 0.05}"]
    found = deepir.run("deconv", *options, frames=noisy, threads=1)
    assert np.abs(found.scene - scene[8:-8, 8:-8])[:, 8:].max() < 0.3


def test_a_blur_of_any_shape_is_found_of_a_target_that_is_known(tmp_path):
    rng = np.random.default_rng(0)
    target = rng.random((70, 70))
    psf = np.zeros((7, 7))
    psf[1:4, 2], psf[4, 2:6] = 1, (2, 1, 1, 3)  # an L
    psf /= psf.sum()
    frame = signal.convolve2d(target, psf, mode="valid") + 0.01 * rng.standard_normal((64, 64))
    np.save(tmp_path / "target.npy", target)
    config = {
        "problem": "deconv", "noise": {"read": 0.01}, "threads": 1,
        "physics": {"blur": {"radius": 3, "psf": "simplex"}},
        "scene": {"type": "constant", "path": str(tmp_path / "target.npy"), "penalties": {"tv": None}},
    }  # fmt: skip
    found = deepir.run(config, frames=frame[None]).extra["psf"]
    assert np.abs(found - psf).max() < 0.01
    assert found.min() >= 0
    assert found.sum() == pytest.approx(1)


# ---- the width ----


@pytest.mark.parametrize(
    ("kind", "blur", "width"),
    [
        (Gaussian, {"psf_sigma": 1.0}, 1.0),
        (Gaussian, {"psf_sigma": 2.0}, 2.0),
        (Airy, {"psf_sigma": 0.0, "airy_radius": 3.0}, 3.0),
        (Defocus, {"psf_sigma": 0.0, "defocus_radius": 3.0}, 3.0),
        (MotionBlur, {"psf_sigma": 0.0, "motion_blur": 5.0}, 5.0),
    ],
)
def test_the_spectrum_of_one_frame_tells_the_width_to_ten_per_cent(kind, blur, width):
    sim = camera(data.camera() / 255, shape=(96, 128), **blur)
    field = kind((1, 1, 17, 17), size=(96, 128))
    frames = torch.from_numpy(sim.frames)[:, None]
    fit_psf(field, frames, torch.ones_like(frames) > 0)
    assert field.width.item() == pytest.approx(width, rel=0.1)


@pytest.mark.parametrize("texture", [data.gravel(), data.camera()])
def test_behind_a_blur_the_spectrum_tells_noise_from_texture(texture):
    sim = camera(texture / 255, shape=(96, 128), psf_sigma=1.0)
    psf = Gaussian((1, 1, 17, 17), size=(96, 128), sigma=1.0)().detach()
    frames = torch.from_numpy(sim.frames)[:, None]
    found = spectral_noise(psf, frames, torch.ones_like(frames) > 0)
    assert found == pytest.approx(sim.settings.read_noise, rel=0.2)


# ---- what it says ----


def test_a_blur_that_is_wider_than_its_array_is_reported(sim):
    psf = "physics.blur.psf={type: gaussian, sigma: 3, fixed: true}"
    with pytest.raises(ConfigError, match=r"^physics\.blur\.psf: .* radius of 4 px .* physics\.blur\.radius=8"):
        deepir.run("deconv", psf, "physics.blur.radius=4", frames=sim.frames)


def test_a_kernel_that_does_not_fit_is_reported(sim, tmp_path):
    np.save(tmp_path / "psf.npy", np.ones((4, 5)))
    with pytest.raises(ConfigError, match=r"psf\.npy: .* odd sides of up to 17 px, not \(4, 5\)"):
        deepir.run("deconv", f"physics.blur.psf={{type: kernel, path: {tmp_path / 'psf.npy'}}}", frames=sim.frames)


def test_without_a_blur_there_is_nothing_to_undo(sim):
    with pytest.raises(ConfigError, match="'deconv' needs a stage 'blur'"):
        deepir.run("deconv", "physics.blur=null", frames=sim.frames)
