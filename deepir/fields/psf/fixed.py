"""A point-spread function that is known."""

from __future__ import annotations

import torch

from deepir.errors import ConfigError
from deepir.fields.base import Shape
from deepir.fields.constant import Constant, read_map
from deepir.registry import register


@register("field", "kernel")
class Kernel(Constant):
    """A known point-spread function from a file, scaled to sum one; one pixel without.

    Its sides are odd, and up to the slot's (2 r + 1, 2 r + 1), in whose middle it is put.
    """

    def __init__(self, shape: Shape, neutral: float = 0.0, *, path: str | None = None) -> None:
        super().__init__(shape, 0.0)
        given = torch.ones(1, 1, 1) if path is None else read_map(path)
        rest = [whole - side for whole, side in zip(shape[-2:], given.shape[-2:], strict=True)]
        if len(given) > 1 or min(rest) < 0 or any(each % 2 for each in rest):
            raise ConfigError(
                f"{path}: a point-spread function has odd sides of up to {shape[-2]} px, "
                f"not {tuple(given.shape[-2:])}; the blur's radius is half of that"
            )
        total = float(given.sum())
        if not 0 < total < float("inf"):
            raise ConfigError(f"{path}: a point-spread function has a positive sum, not {total:g}")
        top, left = (each // 2 for each in rest)
        self.values[..., top : shape[-2] - top, left : shape[-1] - left] = given / total

    @classmethod
    def example(cls) -> Kernel:
        """A kernel of 3 x 3 px."""
        return cls((1, 1, 3, 3))
