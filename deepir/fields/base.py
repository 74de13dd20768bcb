"""The interface of fields, and the plain ones: pixels, between bounds or not, and a number."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, ClassVar, Self

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from deepir.registry import register

if TYPE_CHECKING:
    from deepir.fields.sensor_maps import GaussianMap

Shape = tuple[int, ...]
LAYERS = (nn.Linear, nn.Conv1d, nn.Conv2d, nn.ConvTranspose2d)
#: Nearest that a start comes to a bound, relative to the range, or to the spread of the start where that is infinite.
MARGIN = 0.02


class Field(nn.Module):
    """Parametrisation of an unknown: `forward()` returns its value, a tensor of `shape`.

    Keyword-only arguments of the constructor are the options of a configuration. Parameters are scaled so that a unit
    change of each has an effect of the same order on the data: one L-BFGS step can then move scene and motion together.

    Args:
        shape: Of the value.
        neutral: Value that leaves the data unchanged (1 for a gain).
    """

    #: Whether `init_from` reproduces any value that the field can represent; a network cannot.
    can_represent: ClassVar[bool] = True
    #: Motion model of the registration that initialises the field; None unless it is a motion.
    model: ClassVar[str | None] = None
    example_shape: ClassVar[Shape] = (1, 1, 6, 7)  # shape and options of `example`
    example_options: ClassVar[dict[str, Any]] = {}

    def __init__(self, shape: Shape, neutral: float = 0.0) -> None:
        super().__init__()
        self.shape, self.neutral = tuple(shape), neutral

    def forward(self) -> Tensor:
        """The value, of `shape`."""
        raise NotImplementedError

    def init_from(self, value: Tensor) -> None:
        """Represent `value` as well as the field can; its shape must broadcast to `shape`."""
        raise NotImplementedError

    def starting_at(self, value: Tensor) -> Self:
        """The field itself, after `init_from`."""
        self.init_from(value)
        return self

    def penalty(self) -> Tensor | None:
        """The field's own negative log-prior in nats, or None."""
        return None

    def parts(self) -> Sequence[GaussianMap]:
        """Gaussian maps whose sum is the deviation from neutral, for a solution in closed form; () without one."""
        return ()

    @property
    def is_network(self) -> bool:
        """Whether layers of a network draw the value."""
        return not self.can_represent or any(isinstance(each, LAYERS) for each in self.modules())

    @classmethod
    def example(cls) -> Self:
        """A small instance: the test-suite collects it from the registry."""
        return cls(cls.example_shape, **cls.example_options)


def demand_deviation(sigma: float | None) -> None:
    """Raise `ValueError` if a given prior standard deviation is negative or not finite."""
    if sigma is not None and not (sigma >= 0 and math.isfinite(sigma)):
        raise ValueError(f"sigma must be a number of at least 0, not {sigma}")


def check_counts(**counts: tuple[int, int]) -> None:
    """Check that integers are in the range 1 to a maximum.

    Args:
        counts: Name -> (value, maximum).

    Raises:
        ValueError: A value is out of range.

    >>> check_counts(width=(64, 1024))
    """
    for name, (value, most) in counts.items():
        if not 1 <= value <= most:
            raise ValueError(f"{name} must be 1 to {most}, not {value}")


def check_positive(**values: float) -> None:
    """Raise `ValueError` for a number, given by its name, that is not positive and finite."""
    for name, value in values.items():
        if not 0 < value < math.inf:
            raise ValueError(f"{name} must be a positive number, not {value}")


class GaussianField(Field):
    """Zero-mean Gaussian deviation from neutral; neutral if `sigma` is zero.

    Args:
        shape: Of the value.
        neutral: Value that leaves the data unchanged.
        sigma: Prior standard deviation, data units; estimated if None.

    Raises:
        ValueError: `sigma` is negative or not finite.
    """

    sigma: Tensor
    preconditioning_scale: Tensor
    values: Tensor  # the parameters

    def __init__(self, shape: Shape, neutral: float = 0.0, *, sigma: float | None = None) -> None:
        super().__init__(shape, neutral)
        demand_deviation(sigma)
        self.sigma_is_fixed = sigma is not None
        self.register_buffer("sigma", torch.tensor(sigma or 0.0))
        #: Change of the value per unit of a parameter, see `Field`.
        self.register_buffer("preconditioning_scale", torch.tensor(1.0))

    def penalty(self) -> Tensor | None:
        """`½ Σ value² / sigma²` of the values in data units, which are those of the parameters times their scale."""
        return (self.preconditioning_scale * self.values / self.sigma).square().sum() / 2 if self.sigma > 0 else None


class StandardisedField(Field):
    """A field in units of the standard deviation of its start, from the mean of that."""

    center: Tensor
    scale: Tensor

    def __init__(self, shape: Shape, neutral: float = 0.0) -> None:
        super().__init__(shape, neutral)
        self.register_buffer("center", torch.tensor(float(neutral)))
        self.register_buffer("scale", torch.tensor(1.0))

    def standardise(self, value: Tensor) -> Tensor:
        """Set centre and scale to mean and deviation of a value, and return it in these units, of `shape`."""
        value = value.to(self.center).expand(self.shape)
        deviation = value.std() if value.numel() > 1 else value.new_zeros(())
        self.center.copy_(value.mean())
        self.scale.copy_(torch.where(deviation > 0, deviation, torch.ones_like(deviation)))
        return (value - self.center) / self.scale


@register("field", "pixels")
class Pixels(StandardisedField):
    """One free value for each element: the scene's pixels, or the level of each frame."""

    def __init__(self, shape: Shape, neutral: float = 0.0) -> None:
        super().__init__(shape, neutral)
        self.values = nn.Parameter(torch.zeros(self.shape))

    def forward(self) -> Tensor:
        """`center + scale * values`."""
        return self.center + self.scale * self.values

    @torch.no_grad()
    def init_from(self, value: Tensor) -> None:
        """Take the value over; its mean and deviation become centre and scale."""
        self.values.copy_(self.standardise(value))


@register("field", "uniform")
class Scalar(Field):
    """One number for all elements, such as a time constant that all pixels share."""

    def __init__(self, shape: Shape, neutral: float = 0.0) -> None:
        super().__init__(shape, neutral)
        self.value = nn.Parameter(torch.tensor(float(neutral)))

    def forward(self) -> Tensor:
        """The number, expanded."""
        return self.value.expand(self.shape)

    @torch.no_grad()
    def init_from(self, value: Tensor) -> None:
        """The mean."""
        self.value.copy_(value.to(self.value).mean())


@register("field", "bounded")
class Bounded(Field):
    """One free value for each element, above `low` and, where it is given, below `high`: positive unless given.

    A value is `low + scale softplus(p)`, or `low + (high - low) sigmoid(p)`, of a free parameter p.

    Raises:
        ValueError: A bound is not finite, or `high` is not above `low`.
    """

    scale: Tensor

    def __init__(self, shape: Shape, neutral: float = 0.0, *, low: float = 0.0, high: float | None = None) -> None:
        super().__init__(shape, neutral)
        if not math.isfinite(low) or (high is not None and not low < high < math.inf):
            raise ValueError(f"low = {low}, high = {high}: finite numbers are needed, and high above low")
        self.low, self.high = low, high
        self.values = nn.Parameter(torch.zeros(self.shape))
        self.register_buffer("scale", torch.tensor(1.0 if high is None else high - low))
        self.init_from(torch.tensor(float(neutral)))

    def forward(self) -> Tensor:
        """The values."""
        rise = F.softplus(self.values) if self.high is None else torch.sigmoid(self.values)
        return self.low + self.scale * rise

    @torch.no_grad()
    def init_from(self, value: Tensor) -> None:
        """Take the value over, as near to the bounds as `MARGIN`."""
        value = value.to(self.values).expand(self.shape) - self.low
        if self.high is None:
            spread = value.std() if value.numel() > 1 else value.new_zeros(())
            self.scale.copy_(torch.where(spread > 0, spread, value.abs().mean().clamp(min=1.0)))
        share = (value / self.scale).clamp(min=MARGIN)
        if self.high is None:
            self.values.copy_(share + (-torch.expm1(-share)).log())  # the inverse of softplus
        else:
            self.values.copy_(torch.logit(share.clamp(max=1 - MARGIN)))
