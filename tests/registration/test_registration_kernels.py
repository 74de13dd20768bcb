"""The compiled loops of the registration."""

import functools

import pytest
import torch
from registered import COUNTS, simulated
from torch.testing import assert_close

from deepir.kernels import threads
from deepir.operators.motion_models import rotation
from deepir.registration import register
from deepir.registration.preprocess import Level, sample


@pytest.mark.parametrize("camera", [{"n_frames": 3, "max_rotation": 5.0}, {**COUNTS, "dead_pixels": 0.02}])
def test_the_number_of_threads_makes_no_difference_but_of_rounding(camera):
    frames, _ = simulated("camera", **camera)
    found = []
    for number in (1, 3):
        with threads.for_samples(threads.MIN_PARALLEL_SAMPLES, number):
            found.append(register(frames))
    assert_close(found[0].motion, found[1].motion, rtol=0, atol=1e-4)  # torch adds up by threads
    assert_close(found[0].confidence, found[1].confidence, rtol=0, atol=1e-5)


@pytest.mark.parametrize("bad", [0, 300])
@pytest.mark.parametrize("shape", [(2, 2), (9, 4), (30, 41)])
def test_samples_are_those_of_torch(shape, bad):
    """Also beyond the edge, under rotation and perspective; those on the very edge are left to rounding."""
    generator = torch.Generator().manual_seed(3)
    image, weight = torch.rand(shape, generator=generator), torch.ones(shape)
    weight.view(-1)[torch.randint(weight.numel(), (bad,), generator=generator)] = 0
    level = Level(1, image[None], weight, bad == 0, shape)
    motion = rotation(torch.tensor([0.0, 0.1, -0.4], dtype=torch.float64))
    motion[:, :2, 2] = torch.tensor([[0.3, -0.4], [3.2, 1.3], [-40.0, 0.2]])
    motion[1, 2, :2] = torch.tensor([1e-3, -2e-3])
    values, known = sample(image[None], motion, level)
    points = motion @ level.index_to_px @ indices(shape).flatten(1)
    points = (points[:, :2] / points[:, 2:]).reshape(3, 2, *shape).float()
    unit = points / torch.tensor(shape[::-1])[:, None, None] * 2
    ask = functools.partial(torch.nn.functional.grid_sample, grid=unit.movedim(1, -1), align_corners=False)
    wanted = ask(image.expand(3, 1, *shape), mode="bilinear")[:, 0]
    there = ask(weight.expand(3, 1, *shape), mode="nearest")[:, 0]
    edge = (torch.tensor(shape[::-1])[:, None, None] - 1) / 2
    there = there * (points.abs() <= edge).all(1)
    assert torch.equal(known, there)
    assert torch.allclose(values, wanted * there, atol=1e-5)


def indices(shape):
    y, x = torch.meshgrid(*(torch.arange(side, dtype=torch.float64) for side in shape), indexing="ij")
    return torch.stack((x, y, torch.ones_like(x)))
