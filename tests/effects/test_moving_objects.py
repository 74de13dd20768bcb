"""Who walks through a burst is separated from the scene, also where most frames show him."""

import dataclasses

import numpy as np
import pytest
import torch
from skimage.data import camera
from small_problems import whole

import deepir
from deepir.assembly import build
from deepir.config import load
from deepir.effects.moving_objects import _restore_weight, down_weight_moving, foreground
from deepir.metrics import scores
from deepir.optim.solve import solve
from deepir.problems.nuc import NUC
from deepir.simulate import Settings, simulate
from deepir.simulate.scenes.procedural import procedural

TONES = Settings(shape=(96, 128), shading=0.0, dead_pixels=0.0, photons=1000.0, read_noise=0.002)
WALKER = {"walker": 0.5, "walker_contrast": 0.3}
COUNTS = Settings(shape=(96, 128), shading=0.0, dead_pixels=0.0, counts=True)


def after_the_first_round(sim):
    """The problem of a burst, its motion known, as the second round of the sensor finds it."""
    problem, _ = build(load("nuc"), whole(sim.frames), torch.from_numpy(sim.truth.motion))
    nuc = NUC()
    nuc.initialise(problem, 0)
    solve(problem, nuc.plan(problem)[:1])
    return problem


def doubted(sim):
    """Samples (N, H, W) that are found to show something that moves."""
    problem = after_the_first_round(sim)
    before = problem.precision.clone()
    down_weight_moving(problem, settled=False)
    return (problem.precision < before)[:, 0].numpy()


@pytest.mark.parametrize("settings", [TONES, COUNTS], ids=["tones", "counts"])
def test_where_nothing_moves_nothing_is_doubted(settings):
    assert doubted(simulate(procedural(3, (300, 380)), settings, seed=4)).mean() < 1e-3


@pytest.mark.parametrize("speed", [4.0, 8.0])
def test_a_walker_is_found_though_his_ways_overlap(speed):
    """He is 10 px wide and more: at 4 px from frame to frame some places show him in three frames of five and more."""
    sim = simulate(camera() / 255, dataclasses.replace(TONES, walker_speed=speed, **WALKER), seed=13)
    found = doubted(sim)
    assert found[sim.truth.moving].mean() > 0.7  # edges count as moving, too
    assert found[~sim.truth.moving].mean() < 0.02


def test_stuck_pixels_that_he_covers_in_one_frame_are_found():
    sim = simulate(camera() / 255, dataclasses.replace(TONES, walker_speed=8.0, **WALKER), seed=13)
    covered = sim.truth.moving[0] & ~sim.truth.moving[1:].any(0)
    stuck = np.argwhere(covered)[::17]
    assert len(stuck) > 5
    sim.frames[:, *stuck.T] = 2.0
    problem = after_the_first_round(sim)
    assert problem.moving[0, 0, *stuck.T].any()
    assert not problem.alive()[*stuck.T].any()


def test_who_walks_through_five_frames_is_said_and_shown_and_costs_little():
    costs = []
    picture, walked = procedural(2, (300, 380)), dataclasses.replace(TONES, walker_speed=4.0, **WALKER)
    for seed in (13, 14):
        walker, quality = simulate(picture, walked, seed=seed).truth.moving[0], []
        for settings in (TONES, walked):
            sim = simulate(picture, settings, seed=seed)
            result = deepir.run("nuc", frames=sim.frames, threads=1)
            walks = settings is walked
            assert any("moves" in message for message in result.messages) == walks
            assert ("moving" in result.extra) == walks
            if walks:
                assert any("moves by itself" in message for message in result.messages)
                assert (result.extra["moving"] & sim.truth.moving).sum() > 0.7 * sim.truth.moving.sum()
            quality.append(scores(result.scene, np.where(walker, np.nan, sim.truth.scene))["psnr_aligned"])
        costs.append(quality[0] - quality[1])
    assert np.mean(costs) < 1.8


def test_who_alone_sees_the_scene_is_not_doubted_for_that():
    problem = after_the_first_round(simulate(procedural(1, (300, 380)), TONES, seed=3))
    problem.precision[0, :, 10, 10:13] = torch.tensor([0.0, 0.01, 1e9])
    before, usual = problem.precision.clone(), float(problem.precision.median())
    samples = torch.zeros_like(before, dtype=torch.bool)
    samples[0, :, 10, 10:13] = True
    _restore_weight(problem, samples)
    assert problem.precision[0, 0, 10, [10, 12]].tolist() == before[0, 0, 10, [10, 12]].tolist()
    assert 0.9 * usual < float(problem.precision[0, 0, 10, 11]) < 1.1 * usual
    assert torch.equal(problem.precision.where(~samples, 0), before.where(~samples, 0))


@pytest.mark.parametrize("seed", [1, pytest.param(6, marks=pytest.mark.slow)])
def test_who_is_far_above_the_noise_is_not_built_into_scene_and_pattern(seed):
    settings = Settings(shape=(160, 208), n_frames=5, walker=0.5, walker_speed=8.0, read_noise=0.001)
    sim = simulate(procedural(1, (700, 900)), settings, seed=seed)
    result = deepir.run("nuc", frames=sim.frames, threads=1)
    truth = np.where(sim.truth.moving[0], np.nan, sim.truth.scene)
    assert scores(result.scene, truth)["psnr_aligned"] > 45
    assert (result.gain < 0.5).mean() < 1e-3


SHAPE = (60, 80)  # of drawn places, at which the groups of frames are known


def walk(scene, his, at, size=(24, 14)):
    """Frames (N, H, W) in which a rectangle of `his` flux stands `at` some (row, column), and where it does."""
    flux, where = scene.expand(len(at), *SHAPE).clone(), torch.zeros(len(at), *SHAPE, dtype=torch.bool)
    for k, (row, column) in enumerate(at):
        where[k, row : row + size[0], column : column + size[1]] = True
    return torch.where(where, his, flux), where


def found(flux, where):
    """What is found of `where` in its places, and which of these some frame shows without him."""
    torch.manual_seed(0)
    flux = flux + 0.01 * torch.randn(flux.shape)
    places = where.any(0) & ~where.all(0)
    middle = (flux.amin(0) + flux.amax(0)) / 2
    known = torch.ones_like(where)
    shown = foreground(flux, known, places & (flux > middle), places & (flux <= middle))
    assert not shown[:, ~places].any()
    return shown == where & places, places


def test_places_that_he_covers_in_most_frames_are_his_too():
    at = [(20, 20 + step) for step in (0, 4, 8, 12, 16)]
    flux, where = walk(torch.full(SHAPE, 0.3), torch.tensor(0.8), at)
    assert (where.sum(0) == 4).any()
    right, places = found(flux, where)
    assert right[:, places].float().mean() > 0.99


def test_a_foot_that_stands_in_four_frames_of_five_is_detected_by_how_bright_it_is():
    """Four frames are the more; where he is in few, beside it, tells how bright he is."""
    his = torch.tensor(0.8)
    flux, where = walk(torch.full(SHAPE, 0.3), his, [(20, 20)] * 4 + [(20, 60)], (10, 8))
    flux, stood = walk(flux, his, [(30, 4 + 13 * k) for k in range(5)], (26, 12))
    right, places = found(flux, where | stood)
    foot = torch.zeros_like(places)
    foot[20:30, 20:28] = True
    assert right[:, foot & places].float().mean() > 0.95


def test_whether_he_is_warm_or_cold_does_not_matter():
    at = [(20, 10 + step) for step in (0, 6, 12, 18, 24)]
    flux, where = walk(torch.linspace(0.2, 0.5, SHAPE[1]).expand(SHAPE), torch.tensor(0.9), at)
    (warm, _), (cold, _) = found(flux, where), found(1 - flux, where)
    assert (warm == cold).float().mean() > 0.999


def test_without_places_nobody_is_shown():
    flux = torch.rand(3, *SHAPE)
    nowhere = torch.zeros(3, *SHAPE, dtype=torch.bool)
    assert not foreground(flux, ~nowhere, nowhere, nowhere).any()


def test_what_no_frame_knows_takes_no_part():
    at = [(20, 20 + step) for step in (0, 5, 10, 15, 20)]
    flux, where = walk(torch.full(SHAPE, 0.3), torch.tensor(0.8), at)
    known = torch.ones_like(where)
    known[:, :15] = known[4] = False
    places = (where & known).any(0) & ~(where | ~known).all(0)
    groups = [places & known & group for group in (flux > 0.5, flux <= 0.5)]
    clean = foreground(flux, known, *groups)
    assert torch.equal(clean, foreground(flux.where(known, torch.rand(flux.shape) * 1e3), known, *groups))
    assert not (clean & ~known).any()
