"""State of a solve on disk: tensors in safetensors, the rest as JSON in its header; no pickle."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from torch import Tensor

from deepir.errors import DataError


@dataclass(frozen=True)
class FileCheckpoint:
    """File with the state of a solve, see `deepir.optim.position.Checkpoint`."""

    path: Path

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
        contiguous = {name: tensor.detach().contiguous().cpu().clone() for name, tensor in tensors.items()}
        try:
            save_file(contiguous, part, metadata={"position": json.dumps(position)})
            part.replace(self.path)
        except (SafetensorError, OSError) as error:
            raise DataError(f"{self.path}: the state cannot be written: {error}") from error

    def load(self) -> tuple[dict[str, Tensor], dict[str, Any]]:
        """Tensors and position.

        Raises:
            DataError: The file is not a checkpoint.
        """
        from safetensors import SafetensorError, safe_open

        try:
            with safe_open(self.path, framework="pt") as file:
                position = json.loads((file.metadata() or {})["position"])
                # Cloned: in the file they lie unaligned, and sums would round differently from the interrupted run.
                return {name: file.get_tensor(name).clone() for name in file.keys()}, position  # noqa: SIM118
        except (SafetensorError, KeyError, ValueError, OSError) as error:
            raise DataError(
                f"{self.path}: not a readable checkpoint ({error}); delete it to start again"
            ) from error
