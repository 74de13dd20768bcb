"""An optimiser of a plugin, named in a configuration."""

import pytest
import torch

import deepir
from deepir import registry
from deepir.errors import ConfigError
from deepir.optim import Optimiser

PLAN = {
    "plan": [
        {"name": "mine", "steps": [{"group": ["scene"], "method": "descent", "lr": 1e-3}], "iterations": 30}
    ]
}
BARE = {"prior": "tv", "physics": {}, "solver": PLAN, "threads": 1, "noise": {"read": 0.1}}


@pytest.fixture
def descent(monkeypatch):
    known = {kind: registry.components(kind) for kind in registry.COMPONENT_MODULES}
    monkeypatch.setattr(registry, "_components", known)

    @registry.register("optimiser", "descent")
    class Descent(Optimiser):
        """Gradient descent."""

        descends = False

        @torch.no_grad()
        def step(self, *, fresh):
            self.value, slopes = self.gradient()
            for parameter, slope in zip(self.parameters, slopes, strict=True):
                parameter.sub_(slope, alpha=self.lr[self.group[0]])


def test_it_takes_the_steps_that_a_configuration_names(descent):
    frames = torch.arange(320.0).reshape(1, 16, 20) % 7
    losses = [row["loss"] for row in deepir.run(BARE, frames=frames).history]
    assert len(losses) == 30
    assert losses[-1] < losses[0]


def test_one_that_is_not_there_is_refused_with_the_nearest_name():
    with pytest.raises(ConfigError, match=r"stage 'mine': method: no optimiser is called 'descent'; .*lbfgs"):
        deepir.run(BARE, frames=torch.rand(1, 16, 20))
