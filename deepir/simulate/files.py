"""Simulated data with their truth, and their files."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from deepir.errors import DataError
from deepir.io import atomic_files


@dataclass(frozen=True)
class Simulated:
    """Frames (N, H, W), their truth, and what made them."""

    frames: np.ndarray
    truth: Any
    settings: Any
    seed: int

    def save(self, path: str | Path) -> tuple[Path, Path]:
        """Write `path` (arrays; settings as JSON) and, beside it, STEM_truth.npz (the fields of the truth).

        Returns:
            Both paths.

        Raises:
            DataError: The name does not end in .npz, or the files cannot be written.
        """
        path = Path(path)
        if path.suffix != ".npz":
            raise DataError(f"{path}: simulated data are saved as .npz")
        beside = path.with_name(f"{path.stem}_truth.npz")
        arrays = {each.name: getattr(self, each.name) for each in fields(self)}
        truth, seed, settings = (arrays.pop(name) for name in ("truth", "seed", "settings"))
        made = np.array(json.dumps({"seed": seed, **asdict(settings)}))
        with atomic_files(path, beside) as (part, part_beside):
            np.savez(part, settings=made, **arrays)
            np.savez(part_beside, **{each.name: getattr(truth, each.name) for each in fields(truth)})
        return path, beside
