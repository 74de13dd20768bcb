"""Linear problems that are a YAML file only."""

import numpy as np
import pytest
import torch

import deepir
from deepir.assembly import build
from deepir.burst import Burst
from deepir.config import load
from deepir.simulate.scenes.procedural import procedural

BLUR = {"radius": 2, "psf": {"type": "gaussian", "sigma": 0.8, "fixed": True}}
CHAINS = {
    "mask": {"blur": BLUR | {"radius": 0}},
    "blur": {"blur": BLUR},
    "blur, then pixels": {"blur": BLUR, "downsample": {"factor": 2}},
    "pixels, then blur": {"downsample": {"factor": 2}, "blur": BLUR},
    "two blurs": {"lens": BLUR | {"type": "blur"}, "downsample": {"factor": 2}, "film": BLUR | {"type": "blur"}},
}


def problem_of(physics, frames, mask):
    config = load({"physics": physics, "prior": "pixels"})
    burst = Burst(frames, np.ones(frames.shape, bool), mask)
    return build(config, burst)[0]


@pytest.mark.parametrize("physics", CHAINS.values(), ids=CHAINS)
def test_a_quadratic_problem_has_the_solution_of_its_dense_matrix(physics, tmp_path):
    rng = np.random.default_rng(0)
    frames, mask = rng.random((1, 16, 18)).astype(np.float32), rng.random((16, 18)) < 0.3
    noise, weight = 0.1, 2.0
    np.save(tmp_path / "mask.npy", mask)
    config = {
        "physics": physics, "prior": "pixels", "noise": {"read": noise}, "data": {"mask": str(tmp_path / "mask.npy")},
        "scene": {"penalties": {"ridge": weight, "smooth": weight}}, "threads": 1,
    }  # fmt: skip
    found = deepir.run(config, frames=frames)

    problem = problem_of(physics, frames, mask)
    values = {name: value.double() for name, value in problem.values().items()}
    shape = values["scene"].shape
    units = torch.eye(values["scene"].numel(), dtype=torch.float64).reshape(-1, *shape[1:])
    slots = {slot: values[name] for slot, name in problem.slots.items()}
    matrix = problem.operator(units, **slots).flatten(1).T[~mask.ravel()]
    down, right = (units.diff(dim=axis).flatten(1).T for axis in (-2, -1))
    data = torch.from_numpy(frames).double().flatten()[~mask.ravel()]
    penalty = weight * (torch.eye(len(units)) + down.T @ down + right.T @ right)
    scene = torch.linalg.solve(matrix.T @ matrix / noise**2 + penalty, matrix.T @ data / noise**2)
    y, x = ((whole - side) // 2 for whole, side in zip(shape[-2:], found.scene.shape, strict=True))
    inside = scene.reshape(shape[-2:])[y : y + found.scene.shape[0], x : x + found.scene.shape[1]]
    np.testing.assert_allclose(found.scene, inside, atol=2e-3)


@pytest.mark.parametrize("physics", [CHAINS["blur, then pixels"], CHAINS["pixels, then blur"]])
def test_what_is_masked_is_filled_in_and_what_is_blurred_is_sharper(physics, tmp_path):
    rng = np.random.default_rng(0)
    truth = procedural(1, (64, 80))
    margin = problem_of(physics, np.zeros((1, 32, 40), np.float32), np.zeros((32, 40), bool))
    extra = [(whole - side) // 2 for whole, side in zip(margin.fields["scene"].shape[-2:], truth.shape, strict=True)]
    padded = np.pad(truth, [(each, each) for each in extra], mode="edge").astype(np.float32)
    with torch.no_grad():
        frame = margin.predict(margin.values() | {"scene": torch.from_numpy(padded)[None, None]})[0, 0].numpy()
    mask = rng.random(frame.shape) < 0.3
    np.save(tmp_path / "mask.npy", mask)
    noisy = np.where(mask, 9.0, frame + 0.005 * rng.standard_normal(frame.shape))
    options = {"data": {"mask": str(tmp_path / "mask.npy")}, "noise": {"read": 0.005}, "threads": 1}
    found = deepir.run({"physics": physics} | options, frames=noisy[None])

    def error(scene):
        return np.sqrt(np.mean((scene - truth) ** 2))

    assert found.scene.shape == truth.shape
    assert error(found.scene) < 0.95 * error(np.kron(frame, np.ones((2, 2))))  # even of all of the frame


@pytest.mark.parametrize("prior", ["dip", "deep_decoder"])
def test_a_network_starts_at_the_scale_of_a_scene_that_is_seen_by_signed_sums(prior, tmp_path):
    rng, truth = np.random.default_rng(0), procedural(1, (16, 16))
    matrix = rng.choice([-1, 1], (100, 256)) / 16
    np.save(tmp_path / "matrix.npy", matrix.astype(np.float32))
    given = {"type": "constant", "path": str(tmp_path / "matrix.npy")}
    physics = {"matrix": {"height": 16, "width": 16, "rows": 100, "matrix": given}}
    frame = (matrix @ truth.ravel()).astype(np.float32)[:, None]
    settings = {"prior": prior, "physics": physics, "noise": {"read": 0.01}, "solver": {"max_iterations": 60}}
    found = deepir.run(settings, frames=frame)
    assert np.abs(found.scene - truth).max() < 2 * np.ptp(truth)
