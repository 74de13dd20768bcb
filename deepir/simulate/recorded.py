"""The burst of `data.simulate` of a configuration."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from deepir.errors import ConfigError
from deepir.simulate.burst import Simulation, simulate
from deepir.simulate.scenes.procedural import load_picture
from deepir.simulate.settings import Settings, settings_from_mapping


def simulate_from_config(given: Mapping[str, Any], seed: int) -> Simulation:
    """Simulate the burst of a configuration.

    Args:
        given: `Settings` by name, `scene` and `seed`; missing or None: the default. The default scene is drawn.
        seed: Seed of the run, unless `given` has its own.

    Raises:
        ConfigError: An unknown setting, or a wrong value.
        DataError: The scene does not exist, or is too small for the frames and their motion.
    """
    settings = dict(given)
    scene, own = settings.pop("scene", None), settings.pop("seed", None)
    if own is not None and (isinstance(own, bool) or not isinstance(own, int) or own < 0):
        raise ConfigError(f"data.simulate.seed = {own!r}: a whole number, zero or more, is needed")
    name = None if scene is None else str(scene)
    changed = Path(name).stat().st_mtime_ns if name and Path(name).is_file() else 0
    return _recorded(
        settings_from_mapping(settings, extra=("scene", "seed")), name, seed if own is None else own, changed
    )


@functools.lru_cache(maxsize=2)  # a check of many configurations asks for the same burst again and again
def _recorded(settings: Settings, scene: str | None, seed: int, changed: int) -> Simulation:
    return simulate(None if scene is None else load_picture(scene), settings, seed=seed)


def truth_arrays(simulation: Simulation) -> dict[str, np.ndarray[Any, Any]]:
    """Arrays to compare a result with, float32; the scene is NaN where a walker covers frame 0."""
    found = simulation.truth
    scene = np.where(found.moving[0], np.nan, found.scene) if found.moving[0].any() else found.scene
    arrays = {"scene": scene, "gain": found.gain, "offset": found.offset, "motion": found.motion}
    arrays |= {"stray": found.stray} if simulation.settings.stray else {}
    return {name: array.astype(np.float32) for name, array in arrays.items()}
