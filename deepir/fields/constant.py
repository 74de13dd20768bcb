"""An unknown that is known."""

from __future__ import annotations

from contextlib import suppress
from typing import Self

import torch
from torch import Tensor

from deepir.arrays.samples import as_float32
from deepir.errors import ConfigError
from deepir.fields.base import Field, Shape
from deepir.paths import expanded
from deepir.registry import register


@register("field", "constant")
class Constant(Field):
    """A given value that is never changed: a number, or an array from a file (a calibrated gain map).

    `key` names the array in an `.npz` of several.
    """

    values: Tensor

    def __init__(
        self,
        shape: Shape,
        neutral: float = 0.0,
        *,
        value: float | None = None,
        path: str | None = None,
        key: str | None = None,
    ) -> None:
        super().__init__(shape, neutral)
        if value is not None and path is not None:
            raise ConfigError("give either 'value' or 'path', not both")
        given = torch.tensor(float(neutral if value is None else value)) if path is None else read_map(path, key)
        if given.ndim == 3 and len(self.shape) == 4:  # one channel
            given = given[:, None]
        # Of another shape a slot says whether it takes that, such as points for a motion.
        with suppress(RuntimeError):
            given = given.expand(self.shape)
        self.shape = tuple(given.shape)
        self.register_buffer("values", given.clone())

    def forward(self) -> Tensor:
        """The given value."""
        return self.values

    def starting_at(self, value: Tensor) -> Self:
        """The field itself, of this value."""
        self.values = value
        return self

    def init_from(self, value: Tensor) -> None:
        """Nothing: what is known stays."""


def read_map(path: str, key: str | None = None) -> Tensor:
    """The array of a file: one of more than three axes as it is stored, else maps (N, h, w)."""
    from deepir.io import frames, readers  # not above: they are slow to import

    stored = readers.opened(expanded(path), key).read()
    whole = stored.ndim > 3 and stored.dtype.kind in "fiub"
    return torch.from_numpy(as_float32(stored if whole else frames.to_stack(stored, path)))
