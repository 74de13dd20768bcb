"""Weights of trained networks: written by `deepir train`, shipped with the package."""

from __future__ import annotations

import functools
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import torch
from torch import nn

from deepir.errors import DataError
from deepir.io import atomic_file

SHIPPED = Path(__file__).parent
N = TypeVar("N", bound=nn.Module)


def save(network: nn.Module, path: Path, about: dict[str, Any]) -> None:
    """Write the weights in half precision, and what is to be known `about` them.

    Raises:
        DataError: The file cannot be written.
    """
    from safetensors import SafetensorError
    from safetensors.torch import save_file

    tensors = {name: value.detach().half().contiguous() for name, value in network.state_dict().items()}
    try:
        with atomic_file(path) as part:
            save_file(tensors, part, metadata={"about": json.dumps(about)})
    except SafetensorError as error:
        raise DataError(f"{path}: the weights cannot be written: {error}") from error


@functools.cache
def shipped(make: Callable[[], nn.Module], name: str) -> Any:
    """The network that `make` returns with the weights of a training that come with the package."""
    return load(make(), SHIPPED / f"{name}.safetensors")


def load(network: N, path: Path) -> N:
    """The network with the weights of a file, to be used and not trained.

    Raises:
        DataError: The file is not there, or holds the weights of another network.
    """
    from safetensors import SafetensorError
    from safetensors.torch import load_file

    try:
        network.load_state_dict({name: value.float() for name, value in load_file(path).items()})
    except (SafetensorError, RuntimeError, OSError) as error:
        raise DataError(f"{path}: no weights of this network: {str(error).splitlines()[0]}") from error
    network.eval().requires_grad_(False).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    return network
