"""Run a configuration, in memory or into a folder."""

from __future__ import annotations

import platform
import resource
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

import deepir
from deepir import burst as bursts
from deepir.config import Config, load
from deepir.errors import ConfigError
from deepir.metrics import scores
from deepir.registry import lookup
from deepir.result import Result
from deepir.solve import Progress

CHECKPOINT = "checkpoint.safetensors"


def run(
    config: str | Path | Mapping[str, Any] | Config,
    *overrides: str,
    frames: np.ndarray[Any, Any] | None = None,
    callbacks: Sequence[Callable[[Progress], None]] = (),
    **options: Any,
) -> Result:
    """Correct a burst: `run("nuc", frames=array, prior="tv")`.

    Args:
        config: A shipped name, a path, a mapping, or a configuration already loaded.
        overrides: `key=value`, as on the command line: `"scene.penalties.tv.weight=50"`.
        frames: (N, h, w) in place of `data.path`.
        callbacks: Called with a `Progress` after each iteration.
        options: Top-level keys of the configuration, for example `prior="tv"`, `seed=1`, `data={"path": ...}`.

    Raises:
        DeepIRError: The configuration or the data are wrong; the message says what and where.
    """
    checked = config if isinstance(config, Config) else _load(config, overrides, options)
    data = prepare(checked, frames)
    return execute(checked, data, callbacks=callbacks)


def prepare(config: Config, frames: np.ndarray[Any, Any] | None = None) -> bursts.Burst:
    """Check all that can be checked without solving, and read the data."""
    definition = lookup("problem", config.problem, "problem")
    lookup("method", config.method, "method")
    _device(config)
    return bursts.load(config.data, frames=frames, needs=definition.frames)


def execute(
    config: Config,
    data: bursts.Burst,
    *,
    callbacks: Sequence[Callable[[Progress], None]] = (),
    checkpoint: Path | None = None,
) -> Result:
    """Run the method on data in memory; adds time, memory and scores to the metrics."""
    torch.manual_seed(config.seed)
    if config.threads is not None:
        torch.set_num_threads(config.threads)
    start = time.perf_counter()
    result: Result = lookup("method", config.method)(data, config, callbacks=callbacks, checkpoint=checkpoint)
    seconds = time.perf_counter() - start
    result.metrics = {"seconds": round(seconds, 3), "peak_memory_mb": peak_memory()} | result.metrics
    if "scene" in data.truth and data.truth["scene"].shape == result.scene.shape:
        result.metrics |= scores(result.scene, data.truth["scene"])
    result.metrics |= {
        "method": config.method,
        "prior": config.prior,
        "frames": len(result.frames_used),
        "frames_used": int(result.frames_used.sum()),
        "messages": result.messages,
        "input_sha256": data.sha256,
        "versions": {"deepir": deepir.__version__, "torch": torch.__version__, "python": platform.python_version()},
    }
    return result


def peak_memory() -> float:
    """Most memory that this process has held, MB."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return round(peak / (1 if sys.platform == "darwin" else 1024) / (1024 if sys.platform == "darwin" else 1), 1)


def _load(config: Any, overrides: Sequence[str], options: Mapping[str, Any]) -> Config:
    import json

    extra = [f"{key}={json.dumps(value)}" for key, value in options.items()]
    return load(config, [*overrides, *extra])


def _device(config: Config) -> None:
    try:
        torch.zeros(1, device=config.device)
    except (RuntimeError, AssertionError) as error:
        raise ConfigError(f"device: '{config.device}' cannot be used here: {str(error).splitlines()[0]}") from None


