"""Unknowns bound to slots and data."""

import pytest
import torch

from deepir.fields.base import Pixels
from deepir.fields.constant import Constant
from deepir.fields.sensor_maps import Column, Pixel, SumField
from deepir.likelihoods import Huber
from deepir.operators import Blur, Chain, Sensor, Warp
from deepir.priors.penalties.distance import Ridge
from deepir.problem import Problem

SHAPE = (1, 1, 6, 7)


def sensor_problem(gain=None, **more):
    gain = gain or Pixel(SHAPE, 1.0, sigma=0.1)
    fields = {"scene": Pixels(SHAPE), "gain": gain, "offset": Pixel(SHAPE, 0.0, sigma=1.0)}
    return Problem(Sensor(), fields, torch.rand(2, 1, 6, 7), **more)


def test_the_terms_are_named_and_add_up(small_nuc):
    problem = small_nuc()
    terms = problem.losses(problem.values())
    assert sorted(terms) == ["data", "gain", "offset", "scene.prior"]
    values = problem.values()
    residual = problem.predict(values) - problem.data
    assert torch.allclose(terms["data"], (problem.precision * residual.square()).sum() / 2)
    assert torch.equal(terms["scene.prior"], problem.penalties["scene"]["prior"](values["scene"]))
    assert torch.equal(terms["gain"], problem.fields["gain"].penalty())


def test_penalties_stack_on_any_unknown():
    gain = {"near": Ridge(weight=2.0, center=1.0), "far": Ridge(weight=3.0)}
    penalties = {"gain": gain, "scene": {"r": Ridge()}}
    terms = sensor_problem(penalties=penalties).losses(sensor_problem().values())
    assert {"gain.near", "gain.far", "scene.r"} <= terms.keys()
    assert float(terms["gain.near"].detach()) == 0
    assert float(terms["gain.far"].detach()) == pytest.approx(3 * 42 / 2)


def test_what_is_no_part_of_a_problem_is_refused():
    parts = {"operator": Sensor(), "fields": {"scene": Pixels(SHAPE)}, "data": torch.rand(2, 1, 6, 7)}
    more = parts["fields"] | {"gian": Pixels(SHAPE)}
    for wrong in ({"penalties": {"scen": {}}}, {"fields": more}, {"fields": {}}, {"data": torch.zeros(6, 7)}):
        with pytest.raises(ValueError, match=r"'(scen|gian|scene)' has no field|a tensor of floats"):
            Problem(**parts | wrong)


def test_a_field_is_evaluated_once_a_step_and_carries_a_gradient_only_if_it_is_free(small_nuc, monkeypatch):
    problem, calls = small_nuc(), []
    forward = type(problem.fields["scene"]).forward
    monkeypatch.setattr(Pixels, "forward", lambda field: calls.append(1) or forward(field))
    problem.losses(problem.values(), ("gain", "offset"))
    assert len(calls) == 1
    values = problem.values(["motion"])
    assert values["motion"].requires_grad
    assert not values["scene"].requires_grad


def test_held_out_samples_have_no_influence(small_nuc):
    problem = small_nuc()
    problem.held_out[:, :, ::3, ::2] = True
    everything = ("gain", "offset")

    def outcome(**options):
        terms = problem.losses(problem.values(), everything, **options)
        return torch.stack([term.detach() for term in terms.values()]), problem.values()["gain"].detach()

    before, gain = outcome()
    problem.data[problem.held_out] += 100
    after, same_gain = outcome()
    assert torch.equal(before, after)
    assert torch.equal(gain, same_gain)
    assert not torch.equal(outcome(precision=problem.precision)[0], after)


@pytest.mark.parametrize("group", [("gain",), ("offset",), ("gain", "offset")])
def test_elimination_finds_where_the_gradient_is_zero(small_nuc, group):
    # The unknown that is not in the group keeps a value of its own, and the level one, too.
    problem = small_nuc()
    for name in ("gain", "offset"):
        problem.fields[name].init_from(problem.truth[name])
    problem.fields["level"].values.copy_(torch.tensor([0.1, -0.2, 0.1]).reshape(3, 1, 1, 1))
    values = problem.values()
    problem.solved(values, group)
    for name in group:
        assert torch.allclose(values[name], problem.fields[name](), rtol=1e-12)
    total = torch.stack(list(problem.losses(problem.values()).values())).sum()
    for name in group:
        for parameter in problem.fields[name].parameters():
            (slope,) = torch.autograd.grad(total, parameter, retain_graph=True)
            assert slope.abs().max() < 1e-6


def test_what_is_free_and_what_can_be_eliminated():
    assert sensor_problem().free() == ["scene", "gain", "offset"]
    assert sensor_problem().closed_form() == ["gain", "offset"]
    mixed = SumField(SHAPE, 1.0, {"column": Column(SHAPE, sigma=0.1), "pixels": Pixels(SHAPE)})
    for gain in (Constant(SHAPE, 1.0), Pixels(SHAPE, 1.0), mixed):
        assert sensor_problem(gain=gain).closed_form() == ["offset"]
    assert sensor_problem(penalties={"gain": {"near": Ridge()}}).closed_form() == ["offset"]
    assert sensor_problem(fidelity=Huber()).closed_form() == []
    fixed = sensor_problem()
    fixed.fields["gain"].requires_grad_(False)
    assert fixed.closed_form() == ["offset"]
    fields = {"scene": Pixels((1, 1, 8, 9)), "psf": Constant((1, 1, 3, 3), value=1 / 9)}
    data = torch.rand(1, 1, 6, 7)
    assert Problem(Chain({"blur": Blur(radius=1)}), fields, data, torch.ones_like(data)).closed_form() == []


def test_a_slot_without_a_field_is_named():
    operator, x, _ = Blur.example()
    with pytest.raises(ValueError, match=r"'blur\.psf' has no field.*scene"):
        Problem(operator, {"scene": Pixels(tuple(x.shape))}, torch.rand(2, 1, 4, 5))


def test_slots_without_a_field_are_neutral():
    data = torch.rand(2, 1, 6, 7)
    problem = Problem(Sensor(), {"scene": Pixels((2, 1, 6, 7))}, data)
    problem.fields["scene"].init_from(data)
    torch.testing.assert_close(problem.predict(problem.values()), data)
    assert problem.free() == ["scene"]


def test_a_problem_is_solved_as_a_registered_one_is():
    data = torch.rand(1, 1, 16, 20)
    problem = Problem(Sensor(), {"scene": Pixels((1, 1, 16, 20))}, data, penalties={"scene": {"ridge": Ridge()}})
    solution = problem.solve()
    assert 0 < float(solution.values["scene"].std()) <= float(data.std())
    assert solution.held_out > 0


def test_two_slots_may_share_an_unknown():
    chain = Chain({"first": Blur(radius=1), "second": Blur(radius=1)})
    fields = {"scene": Pixels((1, 1, 10, 11)), "psf": Constant((1, 1, 3, 3), value=1 / 9)}
    data = torch.rand(1, 1, 6, 7)
    slots = {"first.psf": "psf", "second.psf": "psf"}
    assert Problem(chain, fields, data, torch.ones_like(data), slots=slots).predict(
        {"scene": torch.ones(1, 1, 10, 11), "psf": fields["psf"]()}
    ) == pytest.approx(torch.ones(1, 1, 6, 7))


def test_the_average_puts_shifted_frames_on_top_of_each_other():
    # Of a flat scene the average is the scene itself, whatever the sensor did.
    scene = torch.full((1, 1, 12, 14), 0.7)
    motion = torch.eye(3).repeat(3, 1, 1)
    motion[1:, :2, 2] = torch.tensor([[2.0, -1.0], [-1.0, 2.0]])
    level = torch.tensor([0.1, -0.3, 0.2]).reshape(3, 1, 1, 1)
    known = {"motion": motion, "gain": 0.5 + torch.rand(SHAPE), "offset": torch.rand(SHAPE), "level": level}
    fields = {"scene": Pixels(scene.shape)} | {name: Constant(value.shape) for name, value in known.items()}
    for name, value in known.items():
        fields[name].values.copy_(value)
    chain = Sensor() @ Warp((6, 7), (12, 14), (3, 3))
    data = chain(scene, **{slot: known[slot.rpartition(".")[2]] for slot in chain.slots(scene.shape, 3)})
    data[1, 0, 2, 3] = 1e6  # a sample that does not count
    precision = torch.ones_like(data)
    precision[1, 0, 2, 3] = 0
    problem = Problem(chain, fields, data, precision)
    average, weight = problem.backproject(problem.values())
    seen = weight > 0.1
    assert seen[..., 3:9, 3:10].all()
    assert torch.allclose(average[seen], scene[seen], atol=1e-4)
    assert not seen.all()
