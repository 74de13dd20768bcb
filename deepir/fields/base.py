"""What a field is: the representation of one unknown."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, ClassVar

from torch import Tensor, nn

if TYPE_CHECKING:
    from deepir.fields.sensor_maps import GaussianMap

Shape = tuple[int, ...]


class Field(nn.Module):
    """How an unknown is represented: `forward()` gives its value, a tensor of `shape`.

    `neutral` is the value that leaves the data as they are (1 for a gain). Options that a configuration may
    set are the keyword-only arguments of the constructor. Parameters are stored so that a change of one in
    each of them is of the same order in the data: that is what lets one L-BFGS step move scene and motion
    together.
    """

    #: Whether `init_from` takes any value over that the field can represent; a network cannot.
    can_represent: ClassVar[bool] = True
    #: Of a motion: the registration's model at which it starts.
    model: ClassVar[str | None] = None

    def __init__(self, shape: Shape, neutral: float = 0.0) -> None:
        super().__init__()
        self.shape, self.neutral = tuple(shape), neutral

    def forward(self) -> Tensor:
        """The value, of `shape`."""
        raise NotImplementedError

    def init_from(self, value: Tensor) -> None:
        """Represent `value` as well as the field can; its shape must broadcast to `shape`."""
        raise NotImplementedError

    def penalty(self) -> Tensor | None:
        """The field's own negative log-prior in nats, or None."""
        return None

    def parts(self) -> Sequence[GaussianMap]:
        """Gaussian parts that add up to the deviation from neutral: what can be solved in closed form."""
        return ()

    @classmethod
    def example(cls) -> Field:
        """A small instance: the test-suite collects it from the registry."""
        return cls((1, 1, 6, 7))


def check_counts(**counts: tuple[int, int]) -> None:
    """Raise `ValueError` for a number, given with the most that is allowed, that is not 1 to that.

    >>> check_counts(width=(64, 1024))
    """
    for name, (value, most) in counts.items():
        if not 1 <= value <= most:
            raise ValueError(f"{name} must be 1 to {most}, not {value}")
