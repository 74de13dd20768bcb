"""A point-spread function that is known."""

from __future__ import annotations

from deepir.errors import ConfigError
from deepir.priors.constant import Constant
from deepir.priors.field import Shape
from deepir.registry import register


@register("field", "kernel")
class Kernel(Constant):
    """A known point-spread function from a file, (2 r + 1, 2 r + 1), scaled to sum one; one pixel without."""

    def __init__(self, shape: Shape, neutral: float = 0.0, *, path: str | None = None) -> None:
        super().__init__(shape, neutral, path=path)
        if path is None:
            self.values[..., shape[-2] // 2, shape[-1] // 2] = 1
        total = float(self.values.sum())
        if not 0 < total < float("inf"):
            raise ConfigError(f"{path}: a point-spread function has a positive sum, not {total:g}")
        self.values /= total

    @classmethod
    def example(cls) -> Kernel:
        """A kernel of 3 x 3 px."""
        return cls((1, 1, 3, 3))
