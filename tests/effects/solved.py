"""Small bursts and their results: each is solved once for all tests, which leave them as they are."""

import functools

import deepir
from deepir.metrics import scores
from deepir.simulate import Settings, simulate

#: Five frames in counts, without shading and dead pixels.
PLAIN = {"n_frames": 5, "shape": (80, 96), "counts": True, "shading": 0.0, "dead_pixels": 0.0}


@functools.cache
def burst(seed=3, **camera):
    return simulate(None, Settings(**PLAIN | camera), seed=seed)


@functools.cache
def solved(*settings, seed=3, **camera):
    """The result of `nuc`, and the burst."""
    sim = burst(seed, **camera)
    return deepir.run("nuc", *settings, frames=sim.frames, threads=1), sim


def error(result, sim):
    """Standard deviation of the scene's error."""
    return (result.scene - sim.truth.scene).std()


def psnr(result, sim):
    return scores(result.scene, sim.truth.scene)["psnr_aligned"]
