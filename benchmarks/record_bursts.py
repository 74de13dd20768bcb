"""The bursts of the benchmark of record: simulated once, kept as files with their truth, and found again."""

from __future__ import annotations

import dataclasses
import functools
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from nuc_oracle import noise_variance
from nuc_regimes import picture

import deepir
from deepir.simulate import Settings, Simulation, simulate

DATA = os.environ.get("DEEPIR_DATA", "")
H30T = "dji_h30t/H30T_DJI_000{}_R_1280x1024_u16.npz"


@dataclass(frozen=True)
class Simulated:
    """A picture seen by a camera (settings of the simulator), with a seed."""

    picture: str
    seed: int
    camera: Mapping[str, Any]
    settings: tuple[str, ...] = ()  # settings of the runs on it; STEM stands for the burst's path without its ending

    @property
    def range(self) -> float:
        """Of the scene, in the data's units."""
        return Settings(**self.camera).range

    def missing(self) -> str:
        """Why it cannot be simulated here; empty if it can."""
        return lacking(H30T.format(self.picture[-1])) if self.picture.startswith("H30T") else ""

    def written(self, stem: Path) -> list[str]:
        """Write the burst, truth, noise, bad pixels and black bodies, unless they are there; the settings of a run."""
        path = stem.with_name(f"{stem.name}.npz")
        if not path.exists():
            stem.parent.mkdir(parents=True, exist_ok=True)
            write(path, self.picture, Settings(**self.camera), self.seed)
        beside = [f"data.path={path}", f"data.truth={stem}_truth.npz", f"data.mask={stem}_bad.npy"]
        return [*beside, *(each.replace("STEM", str(stem)) for each in self.settings)]


@dataclass(frozen=True)
class Recorded:
    """A real burst: a file in the folder of the data, and how it is read."""

    file: str
    settings: tuple[str, ...] = ()
    key: str = ""  # of the array of frames, where there are several
    shutter: str = ""  # of frames of the closed shutter; pixels of no counts are then blind
    range = 1.0

    def missing(self) -> str:
        """Why it cannot be read here; empty if it can."""
        return lacking(self.file)

    def written(self, stem: Path) -> list[str]:
        """Write the shutter and the blind pixels; the settings of a run."""
        path = Path(DATA) / self.file
        found = [f"data.path={path}", *self.settings, *([f"data.key={self.key}"] if self.key else [])]
        if not self.shutter:
            return found
        stem.parent.mkdir(parents=True, exist_ok=True)
        frames, closed = (deepir.read_frames(path, key=key).frames for key in (self.key, self.shutter))
        np.save(f"{stem}_shutter.npy", closed)
        np.save(f"{stem}_bad.npy", (frames == 0).any(0))
        return [*found, f"data.mask={stem}_bad.npy"]


def lacking(file: str) -> str:
    """Why a file of the data is not to be had; empty if it is."""
    if not DATA:
        return "DEEPIR_DATA does not name the folder of the data"
    return "" if (Path(DATA) / file).exists() else f"the folder of the data has no {file}"


def write(path: Path, name: str, settings: Settings, seed: int) -> None:
    """Simulate a burst into `path` and the files beside it; the burst itself goes last, so that it is all there."""
    scene = looked_at(name)
    sim = simulate(scene, settings, seed=seed)
    stem = str(path.with_suffix(""))
    truth = sim.truth
    flats = black_bodies(sim)
    np.save(f"{stem}_bad.npy", truth.bad_pixels)
    for body, frames in flats.items():
        np.save(f"{stem}_{body}.npy", frames)
    # What is large and says nothing here is left out; an oracle wants the noise.
    small = dataclasses.replace(truth, flow=np.zeros(0), housing=np.zeros(0))
    part = path.with_name(f"{path.stem}.part.npz")
    _, beside = dataclasses.replace(sim, truth=small).save(part)
    with np.load(beside) as stored:
        known = dict(stored)
    np.savez(f"{stem}_truth.npz", **known, noise_variance=noise_variance(sim, scene).astype(np.float32))
    beside.unlink()
    part.replace(path)


@functools.cache
def looked_at(name: str) -> np.ndarray:
    """A grey picture in [0, 1]: one of nuc_regimes.py's, or `H30T N`, a clean thermal one of the data."""
    if not name.startswith("H30T"):
        return picture(name)
    raw = deepir.read_frames(Path(DATA) / H30T.format(name[-1])).frames[0].astype(float)
    low, high = np.percentile(raw, [0.1, 99.9])
    return ((raw - low) / (high - low)).clip(0, 1)


def black_bodies(sim: Simulation) -> dict[str, np.ndarray]:
    """Sixteen frames each of a cold and a hot black body, at the ends of the scene's range."""
    truth, rng, found = sim.truth, np.random.default_rng(sim.seed), {}
    for name, flux in (("cold", truth.scene.min()), ("hot", truth.scene.max())):
        clean = truth.gain * (flux + truth.stray)
        shot = clean.clip(min=0) / truth.photons_per_unit if truth.photons_per_unit else 0.0
        noise = np.sqrt(truth.read_noise**2 + shot) * rng.standard_normal((16, *clean.shape))
        found[name] = (clean + truth.offset + noise).astype(np.float32)
    return found
