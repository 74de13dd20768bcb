"""Frames of a closed shutter are left out: of all frames they alone show no scene."""

import numpy as np
import pytest
import torch
from registered import camera_of_tones

from deepir.registration import register
from deepir.simulate import simulate
from deepir.simulate.scenes.procedural import procedural, sky

COUNTS = {"counts": True, "photons": 0.0, "read_noise": 0.003}
SCENES = {
    "people": procedural(3, (430, 500)),
    "texture": procedural(5, (430, 500)),
    "sky": sky(2, (430, 500)),
}


def burst(scene, shut=(), seed=4):
    """Frames, some of which are of a closed shutter."""
    sim = simulate(SCENES[scene], camera_of_tones(n_frames=7, **COUNTS), seed=seed)
    frames, rng = sim.frames.astype(np.float64), np.random.default_rng(seed)
    level = float(frames.mean()) / float(np.mean(sim.truth.gain)) - float(np.mean(sim.truth.offset))
    for k in shut:
        pattern = sim.truth.gain * level + sim.truth.offset
        frames[k] = np.round(pattern + 3 * rng.normal(size=pattern.shape))
    return torch.from_numpy(frames.astype(np.float32))


@pytest.mark.parametrize("shut", [(0,), (3,), (6,), (2, 3), (0, 1, 2)])
@pytest.mark.parametrize("scene", ["people", "texture"])
def test_frames_of_a_closed_shutter_are_left_out(scene, shut):
    frames = burst(scene, shut)
    result = register(frames)
    assert (~result.used).nonzero()[:, 0].tolist() == list(shut)
    said = [message for message in result.messages if "shutter" in message]
    assert [int(message.split()[1]) for message in said] == list(shut)
    others = result.used.numpy()
    alone = register(frames[others])
    assert torch.allclose(result.motion[others], alone.motion, atol=0.02)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("scene", SCENES)
def test_frames_of_a_scene_are_not(scene, seed):
    frames = burst(scene, seed=seed)
    assert register(frames).used.all()
