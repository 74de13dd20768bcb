"""Dense motion: what it finds, and what it says of configurations that are not made for it."""

import numpy as np
import pytest
import torch
from small_problems import whole

import deepir
from deepir.errors import ConfigError
from deepir.fields.motion import Flow
from deepir.metrics import scores
from deepir.operators.motion_models import displacements
from deepir.operators.warp import project_pixels
from deepir.problems.optical_flow import optical_flow
from deepir.simulate import Settings, simulate
from deepir.storage.stored import FileCheckpoint

SIZE = (64, 80)
QUICK = {"threads": 1, "solver": {"max_iterations": 2}}


@pytest.fixture(scope="module")
def sim():
    """Four frames with parallax of up to 3 px, in counts."""
    settings = Settings(n_frames=4, shape=SIZE, counts=True, max_shift=6.0, shading=0.0, parallax=3.0, dead_pixels=0.0)
    return simulate(None, settings, seed=4)


@pytest.fixture
def quick(monkeypatch):
    """An optical flow that takes one step."""
    monkeypatch.setattr("deepir.problems.optical_flow.LEVEL_ITERATIONS", 1)


@pytest.fixture(scope="module")
def found(sim):
    return deepir.run("flow", frames=sim.frames, threads=1)


def end_point_error(flow, sim):
    beside = (flow - sim.truth.flow)[1:, :, 8:-8, 8:-8]
    return float(np.hypot(beside[:, 0], beside[:, 1]).mean())


def test_parallax_is_found_to_a_tenth_of_a_pixel_and_the_scene_is_better_for_it(sim, found):
    still = deepir.run("nuc", frames=sim.frames, physics={"warp": {"motion": {"type": "homography"}}}, threads=1)
    flat = displacements(project_pixels(torch.from_numpy(still.motion), SIZE)).numpy()
    assert end_point_error(found.extra["flow"], sim) < 0.1
    assert end_point_error(flat, sim) > 0.3
    quality = [scores(each.scene, sim.truth.scene)["psnr_aligned"] for each in (found, still)]
    assert quality[0] > quality[1] + 3


def test_the_flow_is_an_output_that_starts_at_nothing_and_the_motion_is_nearest_to_it(sim, found):
    flow = found.arrays()["flow"]
    assert flow.shape == (4, 2, *SIZE)
    assert flow.dtype == np.float32
    assert not flow[0].any()
    shift = flow[:, :, SIZE[0] // 2, SIZE[1] // 2] - found.motion[:, :2, 2]
    assert np.abs(shift).max() < 3.5  # the parallax


def test_a_frame_that_is_left_out_has_no_flow(sim, quick):
    frames = sim.frames.copy()
    frames[2] = np.random.default_rng(0).normal(frames.mean(), frames.std(), SIZE).astype(frames.dtype)
    result = deepir.run("flow", frames=frames, **QUICK)
    assert not result.frames_used[2]
    assert np.isnan(result.extra["flow"][2]).all()
    assert np.isfinite(result.extra["flow"][[0, 1, 3]]).all()


def test_optical_flow_goes_further_than_the_scenes_texture():
    generator = np.random.default_rng(0)
    texture = torch.from_numpy(generator.standard_normal((1, 1, 96, 96)).astype(np.float32))
    texture = torch.nn.functional.avg_pool2d(texture, 5, stride=1, padding=2)
    y, x = torch.meshgrid(torch.arange(96.0) - 47.5, torch.arange(96.0) - 47.5, indexing="ij")
    shift = 6 * torch.exp(-(x**2 + y**2) / (2 * 20**2))
    grid = torch.stack((x + shift, y - 0.5 * shift), -1)[None] / 48
    moved = torch.nn.functional.grid_sample(texture, grid, mode="bicubic", align_corners=False)
    frames = torch.cat((texture, moved))[:, 0]
    beside = optical_flow(frames, torch.ones_like(frames, dtype=torch.bool), Flow((2,), size=(96, 96)))
    error = (beside[1] - torch.stack((shift, -0.5 * shift)))[:, 12:-12, 12:-12]
    assert not beside[0].any()
    assert float(error.square().sum(0).sqrt().mean()) < 0.4


def test_a_flow_is_a_motion_for_other_problems_too(sim):
    flow = {"physics": {"warp": {"motion": {"type": "flow"}}}}
    for problem, method in (("nuc", "joint"), ("generic", "joint"), ("flow", "average")):
        result = deepir.run("nuc", frames=sim.frames, problem=problem, method=method, **flow, **QUICK)
        assert np.isfinite(result.scene).all()


def test_one_motion_of_the_whole_frame_is_refused(sim):
    with pytest.raises(ConfigError, match=r"take physics\.warp\.motion=flow, not fixed, or problem=nuc"):
        deepir.run("flow", frames=sim.frames, physics={"warp": {"motion": {"type": "rigid"}}}, **QUICK)


def test_an_interrupted_run_goes_on_to_the_same_result(sim, tmp_path, quick):
    from deepir.config import load
    from deepir.pipeline.reconstruct import joint

    def at_the_second_flow(progress):
        if progress.stage == "flow 2":
            raise InterruptedError

    config = load("flow", [], QUICK)
    burst = whole(sim.frames)
    wanted = joint(burst, config)
    with pytest.raises(InterruptedError):
        joint(burst, config, callbacks=[at_the_second_flow], checkpoint=FileCheckpoint(tmp_path / "state"))
    resumed = joint(burst, config, checkpoint=FileCheckpoint(tmp_path / "state"))
    assert np.array_equal(resumed.extra["flow"], wanted.extra["flow"])
    assert np.array_equal(resumed.scene, wanted.scene)
