"""Methods of the benchmark of record that deepir itself has no use for; its workers load them as a plugin.

Two of them are told what no user knows: `oracle` everything but the scene, the peers from scikit-image and deepinv the
point-spread function and the setting that is best on the truth.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
from deconv import best, kernel
from nuc_oracle import best_scene

from deepir.burst import Burst
from deepir.config import Config
from deepir.errors import ConfigError
from deepir.registry import register
from deepir.result import Result, neutral
from deepir.simulate import Settings, Simulation, Truth

#: Methods by name, and what deconv.py calls them.
PEERS = {"richardson_lucy": "Richardson-Lucy", "wiener": "Wiener", "unsupervised_wiener": "unsupervised Wiener"}
DONE = {"iterations": 0, "evaluations": 0, "stop_reason": "converged"}


@register("method", "one_frame")
def one_frame(burst: Burst, config: Config) -> Result:
    """The first frame as it is."""
    return plain(burst, burst.frames[0])


@register("method", "oracle")
def oracle(burst: Burst, config: Config) -> Result:
    """Total variation that is given the true sensor, motion and noise, and the weight that is best on the truth."""
    n = len(burst.frames)
    sim, variance = stored(Path(str(config.data.path)), n)
    result = plain(burst, best_scene(sim, variance[:n]))
    result.gain, result.offset = sim.truth.gain, sim.truth.offset
    return result


def peer(name: str) -> Callable[..., Result]:
    """A method of scikit-image's for one frame behind a Gaussian blur of `sigma` px."""

    def method(burst: Burst, config: Config, *, sigma: float) -> Result:
        psf = kernel("gaussian", sigma=sigma)
        return plain(burst, best(PEERS[name], burst.frames[0], burst.truth["scene"], psf).astype(np.float32))

    method.__doc__ = f"scikit-image's {PEERS[name]}, with the setting that is best on the truth."
    return method


for each in PEERS:
    register("method", each)(peer(each))


def plain(burst: Burst, scene: np.ndarray) -> Result:
    """A scene, and a sensor without a pattern."""
    result = neutral(scene, len(burst.frames), burst.size, burst.bad_pixels)
    result.frames_used[1:], result.motion[1:] = False, np.nan
    result.metrics = dict(DONE)
    return result


def stored(path: Path, n: int) -> tuple[Simulation, np.ndarray]:
    """The first frames of a simulation that record_bursts.py wrote, and the variance of their noise."""
    beside = path.with_name(f"{path.stem}_truth.npz")
    if not beside.is_file():
        raise ConfigError(f"method 'oracle': {beside} is missing; only a simulated burst has an oracle")
    with np.load(path) as burst, np.load(beside) as known:
        frames, asked = burst["frames"][:n], json.loads(str(burst["settings"]))
        arrays = dict(known)
    for name in ("motion", "level", "moving", "failed"):
        arrays[name] = arrays[name][:n]
    seed = asked.pop("seed")
    settings = Settings(**asked | {"shape": tuple(asked["shape"]), "n_frames": n})
    variance = arrays.pop("noise_variance")
    truth = Truth(**{key: value if value.ndim else float(value) for key, value in arrays.items()})
    # It sees `g (M x + s) + o` as a sensor of offset `g s + o`.
    truth = dataclasses.replace(truth, offset=truth.offset + truth.gain * truth.stray)
    return Simulation(frames, truth, settings, seed), variance
