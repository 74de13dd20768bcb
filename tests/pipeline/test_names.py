"""Stages may have any name: what they are is their type."""

import numpy as np

import deepir
from deepir.simulate import Settings, simulate

PARTS = {"type": "column+row+shading+pixel"}
PHYSICS = {
    "pose": {"type": "warp", "motion": {"type": "auto", "init": "register"}},
    "camera": {
        "type": "sensor",
        "gain": PARTS,
        "offset": PARTS,
        "level": {"type": "drift+row_noise+column_noise"},
    },
}


def test_a_warp_and_a_sensor_of_other_names_give_the_same_scene():
    frames = simulate(None, Settings(n_frames=4, shape=(64, 80), counts=True), seed=1).frames
    usual = deepir.run("nuc", frames=frames, threads=1)
    named = deepir.run({"problem": "nuc", "prior": "foe", "physics": PHYSICS}, frames=frames, threads=1)
    np.testing.assert_array_equal(named.scene, usual.scene)
