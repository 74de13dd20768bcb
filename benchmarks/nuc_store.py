"""What `make bench-nuc` keeps between its runs, in runs/bench-nuc: bursts, averages and oracles."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from nuc_regimes import picture

import deepir
from deepir.simulate import Settings, Simulation, Truth, simulate

FOLDER = Path(__file__).parent.parent / "runs" / "bench-nuc"
PACKAGE = Path(deepir.__file__).parent
CAMERA = ("simulate/*.py", "scenes.py", "drawing.py")  # A change of these makes other bursts
#: ... and one of these other averages. (What else an average may depend on is not looked at: see `--fresh`.)
REGISTRATION = ("registration/*.py", "operators/*.py", "baselines/rival.py")

Arrays = dict[str, np.ndarray]


def kept(kind: str, key: object, make: Callable[[], Arrays], *, fresh: bool = False) -> Arrays:
    """The arrays that are kept under this key; made, and kept from now on, if there are none (or `fresh`)."""
    found = None if fresh else finished(kind, key)
    if found is not None:
        return found
    made, path = make(), _path(kind, key)
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(f".{os.getpid()}")
    with part.open("wb") as file:
        np.savez(file, **made)
    part.replace(path)  # whole or not at all, whoever else runs
    return made


def finished(kind: str, key: object) -> Arrays | None:
    """The arrays that are kept under this key, if there are any."""
    path = _path(kind, key)
    if not path.exists():
        return None
    with np.load(path) as stored:
        return dict(stored)


def _path(kind: str, key: object) -> Path:
    name = hashlib.sha256(json.dumps(key, sort_keys=True).encode()).hexdigest()[:24]
    return FOLDER / kind / f"{name}.npz"


def code(*patterns: str) -> str:
    """A digest of files of the package."""
    digest = hashlib.sha256()
    for path in sorted(path for pattern in patterns for path in PACKAGE.glob(pattern)):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:24]


def burst(name: str, settings: Settings, seed: int, *, fresh: bool = False) -> tuple[Simulation, str]:
    """The burst of a picture, and a digest of it."""

    def make() -> Arrays:
        sim = simulate(picture(name), settings, seed=seed)
        truth = {each.name: np.asarray(getattr(sim.truth, each.name)) for each in dataclasses.fields(Truth)}
        return {"frames": sim.frames, **truth}

    asked = [name, dataclasses.asdict(settings), seed, code(*CAMERA)]
    arrays = kept("bursts", asked, make, fresh=fresh)
    digest = hashlib.sha256()
    for key in sorted(arrays):
        digest.update(np.ascontiguousarray(arrays[key]).tobytes())
    frames = arrays.pop("frames")
    truth: Any = {key: value if value.ndim else float(value) for key, value in arrays.items()}
    return Simulation(frames, Truth(**truth), settings, seed), digest.hexdigest()[:24]
