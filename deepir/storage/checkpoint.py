"""State of a solve on disk: tensors in safetensors, the rest as JSON in its header; no pickle."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from deepir.errors import DataError


@dataclass(frozen=True)
class FileCheckpoint:
    """File with the state of a solve, see `deepir.optim.objective.Checkpoint`.

    Attributes:
        path: The file.
        run: Identity of the run; a state that was saved with another one is not read.
    """

    path: Path
    run: str = ""

    def __str__(self) -> str:
        return str(self.path)

    def exists(self) -> bool:
        """True if there is a state to continue from."""
        return self.path.exists()

    def save(self, tensors: dict[str, Tensor], position: dict[str, Any]) -> None:
        """Replace the file atomically: an interruption leaves the old state or the new one.

        Args:
            tensors: Tensors by name.
            position: Stage, iteration ...; anything that JSON can hold.

        Raises:
            DataError: It cannot be written, for example on a full disk.
        """
        from safetensors import SafetensorError
        from safetensors.torch import save_file

        part = self.path.with_suffix(".part")
        # Also of one element: where that was expanded, its stride may be zero.
        contiguous = {
            name: tensor.detach().cpu().clone(memory_format=torch.contiguous_format)
            for name, tensor in tensors.items()
        }
        about = {"position": json.dumps(position), "run": self.run}
        try:
            save_file(contiguous, part, metadata=about | {"sha256": _checksum(contiguous, about)})
            part.replace(self.path)
        except (SafetensorError, OSError) as error:
            part.unlink(missing_ok=True)
            raise DataError(f"{self.path}: the state cannot be written: {error}") from error

    def load(self) -> tuple[dict[str, Tensor], dict[str, Any]]:
        """Tensors and position.

        Raises:
            DataError: The file is not a checkpoint, is damaged, or of another run.
        """
        from safetensors import SafetensorError, safe_open

        try:
            with safe_open(self.path, framework="pt") as file:
                about = dict(file.metadata() or {})
                # Cloned: in the file they lie unaligned, and sums would round differently from the interrupted run.
                tensors = {name: file.get_tensor(name).clone() for name in file.keys()}  # noqa: SIM118
            if about.pop("sha256", None) != _checksum(tensors, about):
                raise ValueError("its contents do not fit their checksum")
            if about["run"] != self.run:
                raise ValueError("it is of other frames, another configuration or another version")
            return tensors, json.loads(about["position"])
        except (SafetensorError, KeyError, ValueError, OSError) as error:
            raise DataError(f"{self.path}: this checkpoint cannot be used: {error}") from error


def _checksum(tensors: dict[str, Tensor], about: dict[str, str]) -> str:
    """SHA-256 of contiguous tensors with their names, types and shapes, and of the rest of the header."""
    found = hashlib.sha256(json.dumps(about, sort_keys=True).encode())
    for name, tensor in sorted(tensors.items()):
        found.update(f"{name} {tensor.dtype} {tuple(tensor.shape)}".encode())
        found.update(tensor.reshape(-1).view(torch.uint8).numpy().data)
    return found.hexdigest()
