"""Correct a burst from Python."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from deepir.burst import Truth
from deepir.config import Config, load
from deepir.result import Result
from deepir.runner import Callbacks, execute, prepare
from deepir.storage.stored import run_into


def run(
    config: str | Path | Mapping[str, Any] | Config,
    *overrides: str,
    frames: np.ndarray[Any, Any] | None = None,
    truth: Truth | None = None,
    callbacks: Callbacks = (),
    overwrite: bool = False,
    **options: Any,
) -> Result:
    """Correct a burst: `run("nuc", frames=array, prior="tv")`.

    Nothing is written unless the configuration names a folder: `output={"dir": "runs/mine"}`.

    Args:
        config: A shipped name, a path, a mapping, or a configuration already loaded.
        overrides: `key=value`, as on the command line: `"scene.penalties.foe.weight=50"`.
        frames: (N, h, w), or (N, C, h, w) of several bands, in place of `data.path`: an array or a tensor;
            `Result.tensors(frames)` gives tensors back.
        truth: The known scene, (h, w), a multiple of it, or (N, h, w), in place of `data.truth`; or arrays by name:
            `{"scene": ..., "gain": ...}`.
        callbacks: Called with a `Progress` after each iteration.
        overwrite: Replace a former run in the output folder.
        options: Top-level keys of the configuration: `prior="tv"`, `seed=1`, `data={"path": ...}`.

    Raises:
        DeepIRError: The configuration or the data are wrong; the message says what and where.
    """
    checked = config if isinstance(config, Config) else load(config, overrides, options)
    if checked.output.dir is not None:
        folder = Path(checked.output.dir)
        return run_into(checked, folder, frames, truth=truth, overwrite=overwrite, callbacks=callbacks)
    return execute(checked, prepare(checked, frames, truth), callbacks=callbacks)
