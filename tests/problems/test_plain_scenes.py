"""The start of a burst, and plain scenes, whose motion is found with the pattern."""

import numpy as np
import pytest
import torch

import deepir
from deepir.assembly import build
from deepir.burst import Burst
from deepir.config import load
from deepir.metrics import scores
from deepir.problems.nuc import NUC
from deepir.simulate import Settings, simulate
from deepir.simulate.scenes.procedural import procedural, sky

WEAK = {f"{what}_{where}": 0.001 for what in ("gain", "offset") for where in ("pixel", "column", "row")}
CAMERA = Settings(n_frames=4, shape=(96, 128), max_rotation=1.0, read_noise=0.001, dead_pixels=0.0, shading=0.0, **WEAK)


def made(frames, motion):
    """The problem `nuc` of frames (N, h, w) at a motion."""
    frames = np.asarray(frames, np.float32)
    valid = np.ones(frames.shape, bool)
    problem, _ = build(load("nuc", ["prior=tv"]), Burst(frames, valid, ~valid.any(0)), torch.from_numpy(motion))
    return problem


def test_a_rigid_motion_that_may_bend_is_where_it_was():
    sim = simulate(procedural(2, (430, 500)), CAMERA, seed=4)
    field = made(sim.frames, sim.truth.motion).fields["motion"]
    before = field().detach()
    field.switch_to_homography()
    assert field.uses_homography
    assert torch.allclose(field(), before, atol=1e-5)


def plain_scenes():
    # Settings, scene, seeds, and least PSNR in dB, in their median: one alone depends on the processor.
    return {
        "turns": (Settings(
            n_frames=8, shape=(160, 192), max_shift=16.0, max_rotation=1.0, gain_pixel=0.03, gain_column=0.005,
            gain_row=0.01, offset_pixel=0.03, offset_column=0.01, offset_row=0.0, shading=0.3, photons=2000.0,
            noisy_pixels=0.002, psf_sigma=1.0, airy_radius=1.0, motion_blur=1.0,
        ), 7, (25,), 49),
        "bends": (Settings(
            n_frames=6, shape=(96, 128), counts=True, pedestal=4000.0, motion="homography", max_shift=10.0,
            gain_pixel=0.06, gain_column=0.02, gain_row=0.03, offset_pixel=0.06, offset_column=0.03, offset_row=0.0,
            read_noise=0.001, dead_pixels=0.0, psf_sigma=1.0,
        ), 4, (13, 14, 15), 60),
        "many times the noise": (Settings(
            n_frames=6, shape=(96, 128), counts=True, pedestal=3000.0, max_rotation=2.0, gain_pixel=0.01, gain_row=0.05,
            offset_row=0.03, offset_column=0.02, offset_pixel=0.02, shading=0.0, read_noise=0.0007,
        ), 4, (87,), 57),
    }  # fmt: skip


@pytest.mark.parametrize(("camera", "scene", "seeds", "least"), plain_scenes().values(), ids=plain_scenes())
def test_the_motion_of_a_plain_scene_is_found_once_the_pattern_is_known(camera, scene, seeds, least):
    sims = [simulate(sky(scene, (430, 500)), camera, seed=seed) for seed in seeds]
    found = [scores(deepir.run("nuc", frames=sim.frames, threads=1).scene, sim.truth.scene) for sim in sims]
    assert np.median([each["psnr_aligned"] for each in found]) > least


def test_what_is_known_to_move_is_not_in_the_start():
    sim = simulate(procedural(2, (430, 500)), CAMERA, seed=4)
    spoilt = np.array(sim.frames)
    spoilt[1, 20:60, 30:50] += 3 * np.ptp(sim.frames)
    scenes = []
    for frames in (sim.frames, spoilt):
        problem = made(frames, sim.truth.motion)
        problem.moving[1, 0, 20:60, 30:50] = True
        NUC().start(problem)
        scenes.append(problem.fields["scene"]().detach().numpy())
        inside = problem.precision[1, 0, 20:60, 30:50]
        assert inside.max() < 1e-4 * problem.precision.median()  # next to nothing, but known to be there
        seen = (problem.precision[:, 0, 20:60, 30:50] > 0).any(0)
        assert seen.float().mean() > 0.9
        assert inside[seen].min() > 0
    assert np.abs(scenes[1] - scenes[0]).max() < 0.05 * np.ptp(scenes[0])
