"""A benchmark's report: printed line by line as it comes, and written to a file."""

from __future__ import annotations

import platform
from collections.abc import Iterable
from pathlib import Path

import torch

import deepir


def write(lines: Iterable[str], script: str, output: Path | None) -> None:
    """Print lines of markdown; to `output` they go with a comment that says which script made them, and with what."""
    versions = f"deepir {deepir.__version__}, torch {torch.__version__}, python {platform.python_version()}"
    kept = [f"<!-- written by {script}: {versions} -->"]
    for line in lines:
        print(line, flush=True)
        kept.append(line)
    if output:
        output.write_text("\n".join(kept) + "\n")
