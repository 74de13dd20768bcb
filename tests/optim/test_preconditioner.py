"""The model of the objective's curvature, against the objective's own."""

import copy

import numpy as np
import pytest
import torch

from deepir.assembly import build
from deepir.burst import Burst
from deepir.closed_form.variable_projection import COLUMN
from deepir.config import load
from deepir.fields.base import Pixels
from deepir.fields.basis_expansion import DCT
from deepir.fields.motion import Shift
from deepir.joint_problem import JointProblem
from deepir.operators import Add, Sensor, Warp
from deepir.optim import free_parameters
from deepir.optim.objective import objective
from deepir.optim.preconditioner import BlockPreconditioner, Preconditioner, low_frequencies, make_block_preconditioner
from deepir.optim.solve import solve
from deepir.priors.penalties.distance import Ridge
from deepir.problem import Problem
from deepir.problems.initial_estimate import start_scene
from deepir.schedule import Stage, Step
from deepir.simulate import Settings, simulate
from deepir.simulate.scenes.procedural import procedural

SIGMA = 0.5  # of the pixels' pattern
SENSOR = ("gain", "offset")


def two_bursts(first, second):
    """Two bursts of one sensor, and the parameters of their scenes and motions."""
    for name in SENSOR:
        second.fields[name] = first.fields[name]
    joint = JointProblem(first, {"second": second})
    return joint, free_parameters(joint, [name for name in joint.free() if name not in SENSOR])


@pytest.fixture
def problem(small_nuc):
    """A large burst with an offset at each pixel, and hardly any prior of the scene."""
    torch.manual_seed(2)
    made = small_nuc(n_frames=4, size=(40, 48), quadratic=True)
    made.penalties["scene"]["prior"].weight.fill_(1e-3)
    for name in ("gain", "offset"):
        for part in made.fields[name].parts():
            part.sigma.fill_(SIGMA if name == "offset" and part.constant_axes == () else 0.0)
    return made


def test_waves_curve_as_the_model_says(problem):
    stage = Stage("sensor", (Step(("scene",)), Step(("offset",), "eliminate")))
    evaluate, scene = objective(problem, stage), problem.fields["scene"]
    model = Preconditioner(problem, [scene.values], ["offset"])

    def slope():
        with torch.enable_grad():
            return torch.autograd.grad(evaluate(("scene",))[0], scene.values)[0]

    before = slope()
    y, x = torch.meshgrid(*(torch.arange(side).double() for side in scene.shape[-2:]), indexing="ij")
    inside = torch.sin(torch.pi * y / y.max()) * torch.sin(torch.pi * x / x.max())
    for cycles_y, cycles_x in ((3, 5), (8, 6), (1, 12)):
        wave = inside * torch.cos(2 * torch.pi * (cycles_y * y / len(y) + cycles_x * x / x.shape[1]))
        with torch.no_grad():
            scene.values += 1e-3 * wave
            change = (slope() - before) / 1e-3
            scene.values -= 1e-3 * wave
        back = model.solve(change.flatten()).reshape(wave.shape)
        assert float((back * wave).sum() / wave.square().sum()) == pytest.approx(1, abs=0.35)


@pytest.mark.parametrize("bursts", [1, 2])
def test_the_inverse_is_symmetric_and_positive(problem, small_nuc, bursts):
    parameters = [problem.fields["scene"].values, problem.fields["motion"].values]
    if bursts == 2:
        problem, parameters = two_bursts(small_nuc(), small_nuc())
    model = make_block_preconditioner(problem, parameters, SENSOR)
    assert isinstance(model, BlockPreconditioner if bursts == 2 else Preconditioner)
    u, v = (torch.randn(sum(p.numel() for p in parameters), dtype=torch.float64) for _ in range(2))
    assert float(u @ model.solve(v)) == pytest.approx(float(v @ model.solve(u)), rel=1e-6)
    assert float(u @ model.solve(u)) > 0


def test_it_saves_iterations(problem, monkeypatch):
    stage = Stage("sensor", (Step(("scene",)), Step(("offset",), "eliminate")), iterations=8, tolerance=0.0)
    # A low-order error, as the registered average of shaded frames has it.
    with torch.no_grad():
        y, x = (torch.linspace(-1, 1, side) for side in problem.fields["scene"].shape[-2:])
        problem.fields["scene"].values += 10 * (y[:, None] ** 2 - x**2)
    start = {name: value.clone() for name, value in problem.state_dict().items()}
    reached = {}
    for known in (True, False):
        problem.load_state_dict(start)
        if not known:
            monkeypatch.setattr("deepir.optim.objective.make_block_preconditioner", lambda *_, **__: None)
        reached[known] = solve(problem, [stage]).history[-1]["loss"]
    assert reached[True] < reached[False]


def test_it_is_diagonal_for_other_scenes_than_pixels_behind_a_warp(problem):
    motion = problem.fields["motion"].values
    assert make_block_preconditioner(problem, [motion], ["offset"]).tensors["scales"].shape == (motion.numel(),)
    assert isinstance(problem.penalties["scene"]["prior"], Ridge)


def test_it_separates_a_slow_scene_from_stray_flux(monkeypatch):
    size, canvas = (40, 48), (60, 68)
    chain = Sensor() @ Add() @ Warp(size, canvas, (10, 10))
    maps, motion = (1, 1, *size), torch.eye(3).repeat(4, 1, 1)
    motion[1:, :2, 2] = torch.tensor([[6.0, -3.0], [-5.0, 4.0], [2.0, 7.0]])
    fields = {
        "scene": Pixels((1, 1, *canvas)),
        "motion": Shift((4, 3, 3), size=size),
        "value": DCT(maps, sigma=50.0, order=6),
    }
    y, x = torch.meshgrid(*(torch.linspace(-1, 1, side) for side in canvas), indexing="ij")
    stray = torch.linspace(-10, 10, 48).expand(maps)
    data = chain((x.sin() + y * x)[None, None], **{"warp.motion": motion, "add.value": stray})
    reached = {}
    for known in (True, False):
        problem = Problem(chain, fields, data, torch.full_like(data, 100.0))
        fields["motion"].init_from(motion)
        fields["value"].init_from(torch.zeros(maps))
        fields["scene"].init_from(data[:1].mean().expand(1, 1, *canvas))
        if not known:
            monkeypatch.setattr("deepir.optim.objective.make_block_preconditioner", lambda *_, **__: None)
        solve(problem, [Stage("stray", (Step(("scene", "value")),), 15, tolerance=0.0)])
        reached[known] = float((fields["value"]().detach() - stray).std())
    assert reached[True] < 0.2
    assert reached[True] < 0.5 * reached[False]


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_strong_column_gains_are_modelled_as_the_scene_times_a_wave(seed, monkeypatch):
    camera = Settings(
        shape=(64, 80), n_frames=5, gain_distribution="uniform", gain_column=0.5, gain_pixel=0.0, photons=1000.0,
        offset_pixel=0.0, offset_column=0.0, offset_row=0.0, shading=0.0, dead_pixels=0.0, max_shift=6.0,
    )  # fmt: skip
    sim = simulate(procedural(seed, (200, 240)) ** 3, camera, seed=seed)
    good, bad = np.ones(sim.frames.shape, bool), np.zeros(sim.frames.shape[1:], bool)
    burst = Burst(sim.frames.astype(np.float32), good, bad)
    free = Step(("scene",)), Step(("gain", "offset"), "eliminate")
    reached = {}
    for strong in (0.05, 9.0):
        monkeypatch.setattr("deepir.optim.low_order_model.MAX_ADDITIVE_LINE_GAIN", strong)
        made, _ = build(load("nuc"), burst, torch.from_numpy(sim.truth.motion))
        made.precision.fill_(1e3)
        for name in ("gain", "offset"):
            for part in made.fields[name].parts():
                part.sigma.fill_(0.2 if name == "gain" and part.constant_axes == COLUMN else 0.0)
        start_scene(made)
        made.penalties["scene"]["tv"].weight.fill_(1.0)
        reached[strong] = solve(made, [Stage("sensor", free, 10, tolerance=0.0)]).history[-1]["loss"]
    assert reached[0.05] < reached[9.0] - 50


def fitted(problem, *, fine):
    """How the scene changes in a few iterations."""
    steps, scene = (Step(("scene",)), Step(("offset",), "eliminate")), problem.fields["scene"]
    before = scene().detach()
    solve(problem, [Stage("scene", steps, iterations=8, tolerance=0.0, fine=fine)])
    return (scene().detach() - before)[0, 0]


def test_a_fine_stage_keeps_low_frequencies(problem, monkeypatch):
    monkeypatch.setattr(
        "deepir.optim.preconditioner.MIN_FRAMES_SEEN", -1.0
    )  # a rim that stays has slow waves of its own
    shape = problem.fields["scene"].shape
    slow, start = low_frequencies(shape, torch.device("cpu")), copy.deepcopy(problem.state_dict())
    moved = {}
    for fine in (True, False):
        problem.load_state_dict(start)
        change = torch.fft.rfft2(fitted(problem, fine=fine)).abs().square()
        moved[fine] = float(change[slow].sum()), float(change[~slow].sum())
    assert moved[True][0] < 0.05 * moved[False][0]
    assert moved[True][1] > 0.5 * moved[False][1]


def test_a_fine_stage_keeps_what_no_frame_shows(problem):
    problem.precision[..., :20, :] = 0
    change = fitted(problem, fine=True).abs()
    assert float(change[:16].max()) == 0
    assert float(change[28:-8, 8:-8].min()) > 0


def test_what_scenes_of_one_sensor_share_is_as_uncertain_as_in_one_burst(small_nuc):
    first = small_nuc()
    joint, parameters = two_bursts(first, copy.deepcopy(first))
    found = make_block_preconditioner(joint, parameters, SENSOR)
    own = free_parameters(joint.first, ["scene", "motion"])
    alone = make_block_preconditioner(joint.first, own, SENSOR)
    scene = torch.randn(joint.first.fields["scene"].values.numel(), dtype=torch.float64)

    def solved(model, parameters):
        """For a slope of `scene` in each scene, and of nothing elsewhere: what is found of each scene."""
        sizes = [p.numel() for p in parameters]
        slope = torch.cat([scene if n == len(scene) else torch.zeros(n).double() for n in sizes])
        return [each for each in model.solve(slope).split(sizes) if len(each) == len(scene)]

    (one,) = solved(alone, own)
    for both in solved(found, parameters):
        assert torch.allclose(both, one, rtol=1e-6, atol=1e-9 * float(one.abs().max()))
