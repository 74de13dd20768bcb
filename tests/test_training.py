"""What `deepir train` trains, and the network that takes off noise."""

import importlib
import json

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from safetensors import safe_open
from torch import nn

from deepir import weights
from deepir.cli import main
from deepir.denoisers.unet import UNet
from deepir.errors import DataError
from deepir.registry import components
from deepir.simulate.scenes.procedural import procedural
from deepir.training.training import BENCHMARK_PHOTOGRAPHS, FIRST_SCENE_SEED, PHOTOGRAPHS, Pictures, Training, train


class Line(Training):
    """The slope of a line through the origin, 3."""

    iterations, rate = 600, 0.05

    def network(self):
        return nn.Linear(1, 1, bias=False)

    def loss(self, network):
        x = torch.from_numpy(self.rng.standard_normal((16, 1), dtype=np.float32))
        return (network(x).float() - 3 * x).square().mean()


@pytest.mark.parametrize("name", components("training"))
def test_every_training_has_a_network_and_a_loss_with_a_slope(name, monkeypatch):
    monkeypatch.setattr("deepir.training.foe.BURSTS_PER_ITERATION", 2)  # a few show it as well
    monkeypatch.setattr("deepir.training.foe.DRAWN_COUNTS", {procedural: 1})
    training = components("training")[name](np.random.default_rng(0))
    network = training.network()
    loss = training.loss(network)
    assert loss.shape == ()
    loss.backward()
    assert all(p.grad is not None and p.grad.isfinite().all() for p in network.parameters())


def test_a_training_finds_what_is_to_be_learnt_by_its_seed_and_reports_where_it_is():
    assert train(Line).weight.item() == pytest.approx(3, rel=0.02)
    first, again, other = (train(Line, seed=seed, iterations=20).weight for seed in (1, 1, 2))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)
    said = []
    train(Line, iterations=3, report=said.append)
    assert [(each.iteration, each.iterations) for each in said] == [(1, 3), (2, 3), (3, 3)]
    assert all(np.isfinite(each.loss) and each.seconds >= 0 for each in said)


def test_nothing_is_learnt_from_pictures_that_are_kept_for_judging(benchmarks):
    # By name; drawn scenes of tuning and judging have seeds below a thousand.
    assert set(PHOTOGRAPHS) == {"brick", "cell", "chelsea", "coffee", "hubble_deep_field", "retina"}
    assert FIRST_SCENE_SEED >= 1000
    record = importlib.import_module("record_protocols")
    assert set(BENCHMARK_PHOTOGRAPHS) == set(PHOTOGRAPHS) & set(record.PICTURES)
    everything, fewer = (Pictures(np.random.default_rng(0), without) for without in ((), BENCHMARK_PHOTOGRAPHS))
    assert len(everything.photographs) - len(fewer.photographs) == 2 * 3 * 3  # two of three colours in three sizes


def test_crops_are_in_the_range_of_the_pictures_or_its_negative():
    crops = Pictures(np.random.default_rng(0)).crops(6, 32)
    assert crops.shape == (6, 1, 32, 32)
    assert crops.dtype == torch.float32
    assert float(crops.abs().max()) <= 1


@settings(max_examples=8, deadline=None)
@given(gain=st.floats(1e-3, 1e3), level=st.floats(-10, 10), seed=st.integers(0, 99))
def test_the_network_does_not_depend_on_units(gain, level, seed):
    torch.manual_seed(seed)
    network, x = UNet((4, 6)).double(), torch.randn(1, 1, 16, 12, dtype=torch.float64)
    with torch.no_grad():
        found = network(gain * (x + level), gain * 0.3)
        assert torch.allclose(found / gain - level, network(x, 0.3), atol=1e-9)


def about(path):
    """What a file of weights says of itself."""
    with safe_open(path, "pt") as file:
        return json.loads(file.metadata()["about"])


def test_weights_come_back_in_half_precision_and_those_of_another_network_are_refused(tmp_path):
    network, other, path = UNet((4, 6)), UNet((4, 6)), tmp_path / "w.safetensors"
    weights.save(network, path, {"seed": 3})
    weights.load(other, path)
    for mine, its in zip(network.parameters(), other.parameters(), strict=True):
        assert torch.allclose(mine, its, rtol=1e-3, atol=1e-6)
        assert not its.requires_grad
    assert about(path) == {"seed": 3}
    with pytest.raises(DataError, match="no weights of this network"):
        weights.load(UNet((4, 8)), path)
    with pytest.raises(DataError, match="nothing"):
        weights.load(network, tmp_path / "nothing.safetensors")


@pytest.mark.parametrize("name", components("training"))
def test_the_shipped_weights_are_small_and_say_how_they_were_made(name):
    path = weights.SHIPPED / f"{name}.safetensors"
    assert path.stat().st_size <= 2e6
    made = about(path)
    assert made["training"] == name
    assert made["iterations"] == components("training")[name].iterations
    assert {"seed", "threads", "torch"} <= made.keys()


def test_the_command_writes_weights_and_replaces_none(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["train", "denoiser", "--iterations", "1"]) == 0
    assert "weights: denoiser.safetensors" in capsys.readouterr().out
    weights.load(UNet(), tmp_path / "denoiser.safetensors")
    assert main(["train", "denoiser", "--iterations", "1"]) == 2
    assert "--overwrite" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "said"),
    [(["denoisr"], "did you mean 'denoiser'"), (["denoiser", "--out", "nowhere/w.safetensors"], "folder")],
)
def test_what_cannot_be_trained_or_written_is_refused_before_anything_is_done(arguments, said, capsys):
    assert main(["train", *arguments]) == 2
    assert said in capsys.readouterr().err
