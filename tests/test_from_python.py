"""deepir from Python: arrays and tensors in and out, and the caller's state is left alone."""

import contextlib
import json
import sys
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from documentation import ROOT, blocks

import deepir
from deepir import registry
from deepir.errors import ConfigError, DataError
from deepir.fields.base import Pixels
from deepir.fields.constant import Constant
from deepir.fields.motion import Shift
from deepir.fields.sensor_maps import Column, SumField
from deepir.operators import Sensor, Warp
from deepir.optim.solve import solve
from deepir.priors.penalties.tv import TV
from deepir.problem import Problem
from deepir.problems.initial_estimate import start_scene
from deepir.problems.recipe import Recipe
from deepir.result import Result, neutral
from deepir.simulate import Settings, simulate

QUICK = ("prior=tv", "threads=1", "solver.max_iterations=1")


@pytest.fixture(scope="module")
def result(burst):
    return deepir.run("nuc", *QUICK, frames=burst.frames, truth=burst.truth.scene)


def test_the_truth_may_be_an_array(result, burst):
    assert result.metrics["psnr"] > 0
    named = deepir.run("nuc", *QUICK, frames=burst.frames, truth={"scene": burst.truth.scene, "gain": burst.truth.gain})
    assert named.metrics["psnr"] == result.metrics["psnr"]
    assert named.metrics["gain_rmse"] > 0


def test_a_truth_of_another_size_is_refused(burst):
    with pytest.raises(DataError, match="truth: the scene is 39 x 48 px, expected 40 x 48 px"):
        deepir.run("nuc", *QUICK, frames=burst.frames, truth=burst.truth.scene[1:])
    with pytest.raises(ConfigError, match="not both"):
        deepir.run("nuc", *QUICK, "data.truth=x.npz", frames=burst.frames, truth=burst.truth.scene)


def test_a_result_says_what_it_is_in_a_few_lines():
    maps = {name: np.ones((6, 8)) for name in ("scene", "gain", "offset")}
    used = np.array([True, False, True])
    found = Result(
        **maps,
        motion=np.tile(np.eye(3), (3, 1, 1)),
        level=np.zeros(3),
        bad_pixels=np.eye(6, 8) > 0,
        frames_used=used,
        history=[{"loss": 1.0}] * 100,
        messages=["frame 1 does not register"],
    )
    assert repr(found) == (
        "Result: scene 6 x 8 of 2 frames, gain σ 0, offset σ 0, 6 bad pixels\n- frame 1 does not register"
    )
    assert found != Result(**maps, motion=found.motion, level=used, bad_pixels=used, frames_used=used)


def test_a_result_is_saved_by_itself(result, tmp_path):
    result.save(str(tmp_path / "mine" / "run"))
    found = np.load(tmp_path / "mine" / "run" / "result.npz")
    assert np.array_equal(found["scene"], result.scene)
    assert (tmp_path / "mine" / "run" / "report.html").exists()
    assert json.loads((tmp_path / "mine" / "run" / "metrics.json").read_text())["psnr"] > 0


def test_a_result_made_by_hand_is_saved_without_a_report(tmp_path):
    neutral(np.ones((6, 7)), 2, (6, 7), np.zeros((6, 7), bool)).save(tmp_path)
    assert {"result.npz", "scene.tiff"} < {each.name for each in tmp_path.iterdir()}
    assert not (tmp_path / "report.html").exists()


def test_a_folder_that_cannot_be_made_is_named(result, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(DataError, match="the folder cannot be made"):
        result.save(tmp_path / "file" / "run")


def test_the_callers_random_numbers_are_unchanged(burst):
    torch.manual_seed(5)
    wanted = torch.rand(3)
    torch.manual_seed(5)
    found = deepir.run("nuc", *QUICK, "prior=siren", frames=burst.frames)
    assert torch.equal(torch.rand(3), wanted)
    assert not any("is a network" in each for each in found.messages)  # see below


def test_tensors_give_tensors_of_their_type(burst, result):
    frames = torch.from_numpy(burst.frames).double()
    found = deepir.run("nuc", *QUICK, frames=frames).tensors(frames)
    assert found["scene"].dtype == torch.float64
    assert found["bad_pixels"].dtype == torch.bool
    assert torch.equal(found["scene"].float(), torch.from_numpy(result.scene))
    assert result.tensors(frames.int())["scene"].dtype == torch.float32


def test_frames_of_several_channels_are_refused_in_a_sentence_where_one_is_wanted(burst):
    two = np.stack([burst.frames, burst.frames], 1)
    with pytest.raises(DataError, match=r"frames of 2 bands; problem 'sr' takes one band, frames\[:, 0\]"):
        deepir.run("sr", frames=two)
    with pytest.raises(DataError, match=r"give one channel, frames\[\.\.\., 0\]"):
        deepir.run("nuc", frames=np.moveaxis(two, 1, -1))


def test_two_bands_are_solved_together_from_parts():
    frames, size, canvas = 4, (16, 20), (24, 28)
    maps, motions = (1, 2, *size), (frames, 3, 3)
    y, x = torch.meshgrid(*(torch.arange(side) / 3.0 for side in canvas), indexing="ij")
    scene = torch.stack([50 + 5 * x.sin() * (1.3 * y).cos(), 30 + 3 * ((x.sin() + y.cos()) > 0.4)])[None]
    motion = torch.eye(3).repeat(frames, 1, 1)
    motion[1:, :2, 2] = torch.tensor([[2.3, -1.6], [-2.1, 1.4], [0.7, 2.8]])
    offset = 0.5 * torch.randn(1, 2, 1, size[1])
    chain = Sensor() @ Warp(size, canvas, (4, 4))
    truth = {"warp.motion": motion, "sensor.gain": torch.ones(maps), "sensor.offset": offset.expand(maps)}
    data = chain(scene, **truth, **{"sensor.level": torch.zeros(frames, 1, 1, 1)})
    data = data + 0.1 * torch.randn_like(data)
    fields = {
        "scene": Pixels((1, 2, *canvas)),
        "motion": Shift(motions, size=size),
        "gain": Constant(maps, 1.0),
        "offset": SumField(maps, 0.0, {"column": Column(maps, sigma=0.5)}),
        "level": Constant((frames, 1, 1, 1)),
    }
    penalties = {"scene": {"tv": TV(weight=3.0)}}
    problem = Problem(chain, fields, data, torch.full_like(data, 100.0), penalties=penalties)
    fields["motion"].init_from(motion + 0.3 * (motion != torch.eye(3)))
    start_scene(problem)
    solve(problem, Recipe([]).plan(problem))
    with torch.no_grad():
        values = problem.values()
    off = (values["offset"] - offset)[:, :, :1]
    off = off - off.mean(-1, keepdim=True)
    assert off.square().mean((0, 2, 3)).sqrt().max() < 0.3 * float(offset.std())
    assert float((values["motion"] - motion)[:, :2, 2].abs().max()) < 0.1


def test_no_physics_is_plain_denoising():
    scene = np.kron(np.arange(12.0).reshape(3, 4), np.full((12, 12), 10.0))
    noisy = scene + 5 * np.random.default_rng(0).standard_normal(scene.shape)
    found = deepir.run({"prior": "tv", "physics": {}}, "threads=1", "noise.read=5", frames=noisy)
    assert np.std(found.scene - scene) < 0.6 * np.std(noisy - scene)


def test_a_network_that_moves_with_the_sensor_is_named(burst, own_components):
    @registry.register("field", "tiny_network")
    class TinyNetwork(Pixels):
        """A network that a stranger wrote, without the base class."""

        def __init__(self, shape, neutral=0.0):
            super().__init__(shape, neutral)
            self.layer = torch.nn.Linear(1, 1)

        def forward(self):
            return super().forward() + 0 * self.layer.weight.sum()

    found = deepir.run("nuc", "prior=tiny_network", *QUICK[1:], frames=burst.frames)
    assert any("is a network, and moves by L-BFGS" in each for each in found.messages)


class Trial:
    """A trial as Optuna makes one, at a given weight."""

    def __init__(self, weight):
        self.params = {"weight": weight}

    def suggest_float(self, name, low, high, *, log):
        assert low <= self.params[name] <= high
        return self.params[name]


class Study:
    """A study that tries a few weights in order."""

    def optimize(self, objective, n_trials):
        errors = {weight: objective(Trial(weight)) for weight in (1.0, 10.0, 100.0)}
        self.best_params = {"weight": min(errors, key=errors.__getitem__)}


class Log(contextlib.AbstractContextManager):
    """A run as W&B makes one."""

    def __init__(self, config):
        self.config, self.summary, self.logged = config, {}, []

    def __exit__(self, *error):
        return None

    def log(self, values):
        self.logged.append(values)


def shown(package):
    """The example of a package in docs/how-to/ablations.md."""
    page = ROOT / "docs/how-to/ablations.md"
    return next(text for _, text in blocks(page, "python") if f"import {package}" in text)


def test_optuna_finds_a_weight_by_the_held_out_error(monkeypatch):
    study = Study()
    monkeypatch.setitem(sys.modules, "optuna", SimpleNamespace(create_study=lambda: study))
    y, x = np.mgrid[:32, :40]
    truth = np.float32((x - 20) ** 2 + (y - 16) ** 2 < 80)
    noisy = truth + 0.1 * np.random.default_rng(0).standard_normal(truth.shape).astype(np.float32)
    exec(shown("optuna"), {"frames": noisy})
    assert study.best_params == {"weight": 10.0}


def test_the_course_of_a_run_is_logged(monkeypatch):
    logs = []
    wandb = SimpleNamespace(init=lambda project, config: logs.append(Log(config)) or logs[0])
    monkeypatch.setitem(sys.modules, "wandb", wandb)
    burst = simulate(settings=Settings(shape=(32, 40), n_frames=3), seed=0)
    exec(shown("wandb"), {"frames": burst.frames})
    assert len(logs[0].logged) > 10
    assert logs[0].summary["noise"] > 0
