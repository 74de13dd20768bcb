"""The model of the objective's curvature, against the objective's own."""

import pytest
import torch

from deepir.curvature import Curvature
from deepir.penalties.ridge import Ridge
from deepir.solve import Stage, Step, objective, solve

SIGMA = 0.5  # of the pixels' pattern


@pytest.fixture
def problem(small_nuc):
    """A large burst with an offset at each pixel, and hardly any prior of the scene."""
    torch.manual_seed(2)
    made = small_nuc(n_frames=4, size=(40, 48), quadratic=True)
    made.penalties["scene"]["prior"].weight.fill_(1e-3)
    for name in ("gain", "offset"):
        for part in made.fields[name].parts():
            part.sigma.fill_(SIGMA if name == "offset" and part.along == () else 0.0)
    return made


def test_waves_curve_as_the_model_says(problem):
    stage = Stage("sensor", (Step(("scene",)), Step(("offset",), "eliminate")))
    evaluate, scene = objective(problem, stage), problem.fields["scene"]
    model = Curvature(problem, [scene.values], ["offset"])

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


def test_the_inverse_is_symmetric_and_positive(problem):
    parameters = [problem.fields["scene"].values, problem.fields["motion"].values]
    model = Curvature(problem, parameters, ["offset"])
    u, v = (torch.randn(sum(p.numel() for p in parameters), dtype=torch.float64) for _ in range(2))
    assert float(u @ model.solve(v)) == pytest.approx(float(v @ model.solve(u)), rel=1e-6)
    assert float(u @ model.solve(u)) > 0


def test_it_saves_iterations(problem, monkeypatch):
    stage = Stage("sensor", (Step(("scene",)), Step(("offset",), "eliminate")), iterations=8, tolerance=0.0)
    # A slow error, as the registered average of shaded frames has it.
    with torch.no_grad():
        y, x = (torch.linspace(-1, 1, side) for side in problem.fields["scene"].shape[-2:])
        problem.fields["scene"].values += 10 * (y[:, None] ** 2 - x**2)
    start = {name: value.clone() for name, value in problem.state_dict().items()}
    reached = {}
    for known in (True, False):
        problem.load_state_dict(start)
        if not known:
            monkeypatch.setattr("deepir.solve.curvature", lambda *_: None)
        reached[known] = solve(problem, [stage]).history[-1]["loss"]
    assert reached[True] < reached[False]


def test_it_stands_aside_for_other_scenes_than_pixels_behind_a_warp(problem):
    from deepir.curvature import curvature

    assert curvature(problem, [problem.fields["motion"].values], ["offset"]) is None
    assert isinstance(problem.penalties["scene"]["prior"], Ridge)
