"""Several data sets that share unknowns."""

import numpy as np
import pytest
import torch

from deepir.fields.base import Pixels
from deepir.fields.constant import Constant
from deepir.fields.sensor_maps import Column, Pixel, SumField
from deepir.joint_problem import JointProblem
from deepir.operators import Chain, Sensor
from deepir.optim.objective import Position, restore_state, save_state
from deepir.optim.solve import solve
from deepir.priors.penalties.distance import Ridge
from deepir.problem import Problem
from deepir.schedule import Stage, Step
from deepir.storage.stored import FileCheckpoint

H, W = 5, 6
SHAPE = (1, 1, H, W)
SENSOR = ("gain", "offset")


def maps(neutral, sigma):
    """Columns and pixels of a gain or an offset."""
    parts = {"column": Column(SHAPE, sigma=2 * sigma), "pixel": Pixel(SHAPE, sigma=sigma)}
    return SumField(SHAPE, neutral, parts)


def data_set(n_frames, seed, **sensor):
    """Frames, each of a scene of its own, by a sensor."""
    generator = torch.Generator().manual_seed(seed)
    frames = 8 + torch.randn(n_frames, 1, H, W, generator=generator, dtype=torch.float64)
    weight = 0.5 + torch.rand(frames.shape, generator=generator, dtype=torch.float64)
    level = Constant((n_frames, 1, 1, 1), value=0.3 * seed)
    fields = {"scene": Pixels(tuple(frames.shape)), "level": level, **sensor}
    problem = Problem(Chain({"sensor": Sensor()}), fields, frames, weight).double()
    with torch.no_grad():
        problem.fields["scene"].init_from(7 + torch.randn(frames.shape, generator=generator, dtype=torch.float64))
    return problem


@pytest.fixture
def joint():
    """Three frames and two, of one sensor."""
    gain, offset = maps(1.0, 0.05), maps(0.0, 0.4)
    first, second = (data_set(n, seed, gain=gain, offset=offset) for n, seed in ((3, 1), (2, 2)))
    return JointProblem(first, {"second": second})


def dense(joint):
    """Gain and offset of the stacked least-squares problem, by NumPy, (2, h w)."""
    each = [(one.flux(v := one.values()), one.data - v["level"], one.precision) for one in joint.data_sets]
    z, y, w = (torch.cat(parts).detach().numpy().reshape(-1, H * W) for parts in zip(*each, strict=True))
    columns, pixels = np.tile(np.eye(W), (H, 1)), np.eye(H * W)
    spread = {
        name: np.hstack([2 * sigma * columns, sigma * pixels]) for name, sigma in (("gain", 0.05), ("offset", 0.4))
    }
    design = np.vstack([np.hstack([z_k[:, None] * spread["gain"], spread["offset"]]) for z_k in z])
    root = np.sqrt(w.ravel())
    a = np.vstack([root[:, None] * design, np.eye(design.shape[1])])
    b = np.concatenate([root * (y - z).ravel(), np.zeros(design.shape[1])])
    found = np.split(np.linalg.lstsq(a, b, rcond=None)[0], 2)
    return np.stack([spread[name] @ white for name, white in zip(SENSOR, found, strict=True)])


def test_elimination_is_the_dense_solution_of_the_stacked_problem(joint):
    values = joint.values(without=SENSOR)
    joint.misfit(values, SENSOR, joint.fitted())
    found = [values]
    for each in joint.data_sets:  # which know their sensor from all samples
        found.append(each.values())
        each.solved(found[-1], SENSOR)
    for values in found:
        sensor = torch.stack([values[name].flatten() for name in SENSOR]).detach().numpy()
        assert sensor - [[1], [0]] == pytest.approx(dense(joint), abs=1e-9)


def test_the_gradient_is_that_of_the_eliminated_objective(joint):
    def objective():
        values = joint.values(without=SENSOR)
        terms = joint.losses(values, SENSOR)
        return sum(terms.values())

    scenes = [each.fields["scene"].values for each in joint.data_sets]
    gradients = torch.autograd.grad(objective(), scenes)
    for scene, gradient in zip(scenes, gradients, strict=True):
        change, before = torch.zeros_like(scene), scene.detach().clone()
        change[0, 0, 2, 3] = 1e-5
        sides = []
        for sign in (1, -1):
            with torch.no_grad():
                scene.copy_(before + sign * change)
            sides.append(float(objective().detach()))
        with torch.no_grad():
            scene.copy_(before)
        assert float(gradient[0, 0, 2, 3]) == pytest.approx((sides[0] - sides[1]) / 2e-5, rel=1e-5)


def test_the_sum_is_that_of_the_parts(joint):
    assert sorted(joint.values()) == ["gain", "level", "offset", "scene", "second_level", "second_scene"]
    terms = joint.losses(joint.values())
    apart = sum(each.losses(each.values())["data"] for each in joint.data_sets)
    assert float(terms["data"].detach()) == pytest.approx(float(apart.detach()))
    assert [name for name in terms if name != "data"] == ["gain", "offset"]  # counted once


def test_penalties_are_named_by_the_unknown(joint):
    joint.represent("second_scene", Pixels((2, *SHAPE[1:])).double(), {"near": Ridge(weight=2.0, center=1.0)})
    terms = joint.losses(joint.values())
    assert float(terms["second_scene.near"].detach()) == pytest.approx(2 * 2 * H * W / 2)
    assert list(joint.penalties) == ["second_scene"]


def test_a_gain_beside_offsets_that_differ_has_no_closed_form():
    gain = maps(1.0, 0.05)
    sets = [data_set(2, seed, gain=gain, offset=maps(0.0, 0.4)) for seed in (1, 2)]
    joint = JointProblem(sets[0], {"second": sets[1]})
    assert joint.closed_form() == ["offset", "second_offset"]
    values = joint.values(without=joint.closed_form())
    joint.misfit(values, joint.closed_form(), joint.fitted())
    assert not torch.equal(values["offset"], values["second_offset"])


def test_a_solve_goes_on_from_where_it_was_kept(joint, tmp_path):
    plan = [Stage("joint", (Step(("scene", "second_scene")), Step(SENSOR, "eliminate")), 5)]
    kept = FileCheckpoint(tmp_path / "state.safetensors")
    save_state(joint, [], Position(stage=1), kept)
    before = {name: value.detach().clone() for name, value in joint.values().items()}
    solve(joint, plan)
    assert not torch.equal(joint.values()["gain"], before["gain"])
    restore_state(joint, plan, kept)
    assert all(torch.equal(value, before[name]) for name, value in joint.values().items())
