"""deepir: inverse problems of thermal cameras."""

from __future__ import annotations

import importlib
import os
from typing import TYPE_CHECKING, Any

__version__ = "0.2.0"

# The threads of OpenMP and OpenBLAS wait by spinning: as soon as another program wants a core, a solve takes many times
# as long. So they sleep soon; those of OpenMP after a tenth of a millisecond or so, as to wake them takes nearly as
# long, and torch's next operation is mostly there by then. Read when torch and scipy are first imported.
os.environ.setdefault("GOMP_SPINCOUNT", "3000")
os.environ.setdefault("OPENBLAS_THREAD_TIMEOUT", "12")  # the logarithm of cycles

if TYPE_CHECKING:
    from deepir.api import run
    from deepir.correct_recording import correct
    from deepir.errors import DeepIRError
    from deepir.io import read_frames
    from deepir.live.corrector import Corrector
    from deepir.problem import Problem
    from deepir.result import Result

# Looked up on first use: `import deepir` and `deepir --help` do without torch.
_HOMES = {
    "Corrector": "live.corrector",
    "DeepIRError": "errors",
    "Problem": "problem",
    "Result": "result",
    "correct": "correct_recording",
    "read_frames": "io",
    "run": "api",
}
__all__ = ["Corrector", "DeepIRError", "Problem", "Result", "correct", "read_frames", "run"]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'deepir' has no attribute {name!r}")
    return getattr(importlib.import_module(f"deepir.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
