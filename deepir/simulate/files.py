"""Files of simulated data and their truth."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from deepir.errors import DataError


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
        DataError: The name does not end in .npz.
    """
    if path.suffix != ".npz":
        raise DataError(f"{path}: simulated data are saved as .npz")
    beside = path.with_name(f"{path.stem}_truth.npz")
    np.savez(path, settings=np.array(json.dumps(settings)), **arrays)
    np.savez(beside, **{field.name: getattr(truth, field.name) for field in fields(truth)})
    return path, beside
