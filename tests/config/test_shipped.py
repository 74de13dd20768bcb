"""Everything that is shipped as YAML makes a problem."""

import pytest
import torch
from small_problems import tiny

from deepir.assembly import build
from deepir.config import SHIPPED_CONFIGS, headline, load, prior_names, shipped_names
from deepir.optim.solve import solve
from deepir.pipeline.schedule import plan
from deepir.registry import lookup

#: Each configuration with its own prior and with TV, and one with all.
PAIRS = dict.fromkeys(
    (name, prior)
    for name in shipped_names()
    for prior in (load(name).prior, "tv", *(prior_names() if name == "nuc" else ()))
)


@pytest.mark.usefixtures("few_trials")
@pytest.mark.parametrize(("name", "prior"), PAIRS)
def test_a_configuration_with_a_prior_makes_a_problem_that_a_solve_improves(name, prior):
    config = load(name, [f"prior={prior}", "solver.max_iterations=2"])
    problem, _ = build(config, *tiny())
    definition = lookup("problem", config.problem)()
    definition.initialise(problem, seed=0)
    solution = solve(problem, plan(problem, definition, config))
    assert all(value.isfinite().all() for value in solution.values.values())
    stages = dict.fromkeys(row["stage"] for row in solution.history)
    for stage in [each for each in stages if "sensor" in each or each == "scene"]:  # Adam's first steps may rise
        losses = [row["loss"] for row in solution.history if row["stage"] == stage]
        assert losses[-1] <= losses[0]


@pytest.mark.parametrize("name", [name for name in shipped_names() if name.startswith("paper/")])
def test_the_2021_formulation_is_one_descent_that_draws_its_scene_once_an_iteration(name):
    config = load(name, ["scene.width=4", "solver.max_iterations=3"])
    problem, _ = build(config, *tiny())
    definition = lookup("problem", config.problem)()
    definition.initialise(problem, seed=0)
    before = {unknown: value.detach() for unknown, value in problem.values().items()}
    solution = solve(problem, plan(problem, definition, config))
    assert solution.evaluations == solution.iterations == 3
    moved = {unknown for unknown, value in solution.values.items() if not torch.equal(value, before[unknown])}
    assert moved == {"scene", "gain", "motion"} | ({"offset"} if "offset" in problem.free() else set())


@pytest.mark.parametrize("path", sorted(SHIPPED_CONFIGS.rglob("*.yaml")), ids=lambda path: path.stem)
def test_a_shipped_file_says_in_its_first_line_what_it_is(path):
    assert 10 < len(headline(path)) <= 120
    assert headline(path).endswith(".")


@pytest.mark.parametrize("path", sorted((SHIPPED_CONFIGS / "prior").glob("*.yaml")), ids=lambda path: path.stem)
def test_a_preset_of_a_prior_holds_a_scene_and_nothing_else(path):
    from deepir.config.overrides import parse_yaml

    assert list(parse_yaml(path.read_text())) == ["scene"]
