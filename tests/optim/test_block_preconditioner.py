"""The preconditioner of several data sets."""

import copy

import torch

from deepir.joint_problem import JointProblem
from deepir.optim import free_parameters
from deepir.optim.preconditioner import BlockPreconditioner, Preconditioner, make_block_preconditioner

SENSOR = ("gain", "offset")


def two_bursts(first, second):
    """Two bursts of one sensor, and the parameters of their scenes and motions."""
    for name in SENSOR:
        second.fields[name] = first.fields[name]
    joint = JointProblem(first, {"second": second})
    return joint, free_parameters(joint, [name for name in joint.free() if name not in SENSOR])


def test_one_data_set_has_its_own(small_nuc):
    problem = small_nuc()
    parameters = free_parameters(problem, ["scene", "motion"])
    assert isinstance(make_block_preconditioner(problem, parameters, SENSOR), Preconditioner)


def test_that_of_bursts_of_one_sensor_is_symmetric_and_positive(small_nuc):
    joint, parameters = two_bursts(small_nuc(), small_nuc())
    found = make_block_preconditioner(joint, parameters, SENSOR)
    assert isinstance(found, BlockPreconditioner)
    assert found.one_sensor
    x, y = torch.randn(2, sum(p.numel() for p in parameters), dtype=torch.float64).unbind()
    assert torch.allclose(torch.dot(x, found.solve(y)), torch.dot(y, found.solve(x)), rtol=1e-6)
    assert torch.dot(x, found.solve(x)) > 0


def test_what_the_scenes_have_in_common_is_as_uncertain_as_in_one_burst(small_nuc):
    first = small_nuc()
    joint, parameters = two_bursts(first, copy.deepcopy(first))
    found = make_block_preconditioner(joint, parameters, SENSOR)
    own = free_parameters(joint.first, ["scene", "motion"])
    alone = make_block_preconditioner(joint.first, own, SENSOR)
    scene = torch.randn(joint.first.fields["scene"].values.numel(), dtype=torch.float64)
    each = [p.numel() for p in own]
    slope = torch.cat(
        [scene if k == alone.scene else torch.zeros(n, dtype=torch.float64) for k, n in enumerate(each)]
    )
    one = alone.solve(slope).split(each)[alone.scene]
    sizes = [p.numel() for p in parameters]
    scenes = [i for i, n in enumerate(sizes) if n == len(scene)]
    both = found.solve(
        torch.cat(
            [scene if i in scenes else torch.zeros(n, dtype=torch.float64) for i, n in enumerate(sizes)]
        )
    )
    for i in scenes:
        assert torch.allclose(both.split(sizes)[i], one, rtol=1e-6, atol=1e-9 * float(one.abs().max()))
