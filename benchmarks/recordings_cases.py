"""A recording with something to judge a correction by, and where the real data are."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from recordings_methods import Correction
from recordings_scores import Figures

#: Folder of real data; in the folder bench beside it are recordings that are drawn from them.
DATA = Path(os.environ.get("DEEPIR_DATA", "../shared/data"))
DRAWN = DATA.parent / "bench" / "recordings.py"
APART = 6  # frames at 60 Hz between two of a burst of one scene


@dataclass(frozen=True)
class Case:
    """A recording, and how a correction of it is judged.

    Attributes:
        frames: (N, h, w), as they are recorded.
        judged: Numbers of the frames that are judged.
        judge: Figures, from these frames corrected, float32, and from what the method states.
        apart: Frames between two of a burst of one scene.
    """

    frames: np.ndarray
    judged: np.ndarray
    judge: Callable[[np.ndarray, Correction], Figures]
    apart: int


def absent(*paths: Path) -> str:
    """Why recordings cannot be made; empty if they can."""
    missing = [str(path) for path in paths if not path.exists()]
    return f"{missing[0]} is not there; DEEPIR_DATA names the folder of the data" if missing else ""
