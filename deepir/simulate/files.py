"""Files of simulated data and their truth."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from deepir.errors import DataError
from deepir.io import atomic_files


def save_with_truth(path: Path, truth: Any, settings: Mapping[str, Any], **arrays: Any) -> tuple[Path, Path]:
    """Write arrays, with the settings as JSON, and beside them STEM_truth.npz.

    Args:
        path: Of the arrays, .npz.
        truth: A dataclass; each of its fields becomes an array.
        settings: What made the data.
        arrays: By name.

    Returns:
        Both paths.

    Raises:
        DataError: The name does not end in .npz, or they cannot be written.
    """
    if path.suffix != ".npz":
        raise DataError(f"{path}: simulated data are saved as .npz")
    beside = path.with_name(f"{path.stem}_truth.npz")
    known = {field.name: getattr(truth, field.name) for field in fields(truth)}
    with atomic_files(path, beside) as (part, part_beside):
        np.savez(part, settings=np.array(json.dumps(settings)), **arrays)
        np.savez(part_beside, **known)
    return path, beside
