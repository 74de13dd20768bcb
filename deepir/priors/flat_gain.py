"""A gain that is measured before two uniform surfaces."""

from __future__ import annotations

import torch

from deepir.errors import ConfigError
from deepir.priors.constant import Constant, read
from deepir.priors.field import Shape
from deepir.registry import register


@register("field", "flat_gain")
class FlatGain(Constant):
    """A known gain from flat frames: what `hot` has over `cold`, in units of its mean (two-point calibration).

    Each is a file of frames of one uniform surface, which are averaged. Offset and stray flux, which both have, cancel.
    A pixel that does not answer has a gain of one: it is found to be bad by what it does in the burst.
    """

    def __init__(
        self, shape: Shape, neutral: float = 1.0, *, cold: str | None = None, hot: str | None = None
    ) -> None:
        super().__init__(shape, 1.0)
        if cold is None and hot is None:
            return
        if cold is None or hot is None:
            raise ConfigError("a gain needs flat frames of two surfaces: both 'cold' and 'hot'")
        first, second = (read(path).nanmean(0) for path in (cold, hot))
        if first.shape != second.shape or first.shape != tuple(shape[-2:]):
            raise ConfigError(
                f"flat frames of {tuple(shape[-2:])} px are wanted; {cold} has {tuple(first.shape)}, {hot} has "
                f"{tuple(second.shape)}"
            )
        rise = second - first
        typical = rise.nanmedian()
        if not typical > 0:
            raise ConfigError(
                f"{hot} is not hotter than {cold}: it rises by {float(typical):g} in the median"
            )
        gain = rise / typical
        answers = gain.isfinite() & (gain > 0.1) & (gain < 10)
        self.values.copy_(torch.where(answers, gain / gain[answers].mean(), torch.ones_like(gain)))

    @classmethod
    def example(cls) -> FlatGain:
        """A gain of one, for want of frames."""
        return cls((1, 1, 6, 7))
