"""The compiled loops, their twins in torch, and a device that is not the CPU give the same results."""

import json
import subprocess
import sys
from pathlib import Path

import on_card
import pytest
import torch
from small_problems import PROBLEMS, difference, frames_of, solved

from deepir.assembly import build
from deepir.burst import load as load_burst
from deepir.config import load
from deepir.kernels import threads
from deepir.optim.objective import objective
from deepir.pipeline.schedule import make_recipe, plan
from deepir.registry import components

#: Difference of whole solves, relative to the range: rounding errors of float32 after some tens of iterations.
ROUNDING = 2e-3


pytestmark = pytest.mark.usefixtures("few_trials")


@pytest.fixture(
    scope="module",
    params=["card", pytest.param("cuda", marks=pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU"))],
)
def card(request):
    """The differences and errors on a device, by kind and name: a pretended one, and a GPU where there is one."""
    command = [sys.executable, str(Path(on_card.__file__)), request.param]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return {(each["kind"], each["name"]): each for each in map(json.loads, done.stdout.splitlines())}


def test_every_problem_is_here():
    of_films = {"recording"}  # `nuc` over several bursts: the same loops
    assert PROBLEMS.keys() | {"generic"} | of_films == components("problem").keys()


#: Where all stages of these are right, a whole solve of the others adds no kernel.
WHOLE = ("nuc", "deblur_lag", "multiview_nuc")


@pytest.mark.parametrize(
    "name", [name if name in WHOLE else pytest.param(name, marks=pytest.mark.slow) for name in PROBLEMS]
)
def test_a_whole_solve_by_torch_is_that_of_the_compiled_loops(monkeypatch, name):
    wanted = solved(name, iterations=3)
    monkeypatch.setattr(threads, "ENABLED", False)
    found = solved(name, iterations=3)
    assert difference(found, wanted) < ROUNDING
    assert found.messages == wanted.messages


@pytest.mark.parametrize("name", PROBLEMS)
def test_the_objective_by_torch_is_that_of_the_compiled_loops(monkeypatch, name):
    config = load(name, PROBLEMS[name][0])
    burst = load_burst(config.data, frames=frames_of(name))
    recipe = make_recipe(config)
    problem, _ = build(config, burst, torch.eye(3, dtype=torch.float64).repeat(len(burst.frames), 1, 1))
    recipe.initialise(problem, 0)
    problem.double()

    def evaluate(stage):
        free = [each for step in stage.steps if step.method != "eliminate" for each in step.group]
        parameters = [p for each in free for p in problem.fields[each].parameters() if p.requires_grad]
        value, _ = objective(problem, stage)(free)
        found = torch.autograd.grad(value, parameters, allow_unused=True)
        return value.detach(), torch.cat([each.flatten() for each in found if each is not None])

    for stage in plan(problem, recipe, config):
        if stage.change is None:
            monkeypatch.setattr(threads, "ENABLED", True)
            wanted, slope = evaluate(stage)
            monkeypatch.setattr(threads, "ENABLED", False)
            found, other = evaluate(stage)
            assert abs(found - wanted) < 1e-9 * abs(wanted)
            assert (other - slope).abs().max() < 1e-6 * slope.abs().max()


@pytest.mark.parametrize(
    ("kind", "name"), [(kind.__name__, name) for kind in on_card.EVALUATED for name in on_card.names_of(kind.__name__)]
)
def test_nothing_mixes_devices_and_all_is_as_on_the_cpu(card, kind, name):
    assert "error" not in card[kind, name], card[kind, name]["error"]
    assert card[kind, name]["difference"] < ROUNDING
