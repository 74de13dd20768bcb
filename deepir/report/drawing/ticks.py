"""Numbers along a scale."""

from __future__ import annotations

import itertools
import math

STEPS = (1, 2, 5, 10)  # between ticks, times a power of ten
MAX_DECIMALS = 5  # of a label; beyond, and from a million on, it has an exponent


def linear_ticks(low: float, high: float, most: int = 7) -> list[float]:
    """At most `most` round numbers at equal steps in [low, high]."""
    if not 0 < (span := high - low) < math.inf:
        return []
    power = 10.0 ** math.floor(math.log10(span / most))
    step = next(each * power for each in STEPS if each * power * most >= span * (1 - 1e-9))
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [k * step for k in range(first, last + 1)][:most]


def log_ticks(low: float, high: float) -> list[float]:
    """Powers of ten in [low, high], both positive; with their doubles and fivefolds where they are few."""
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    for factors in ((1,), (1, 2, 5)):
        found = [f * 10.0**k for k in powers for f in factors if low * 0.999 <= f * 10.0**k <= high * 1.001]
        if len(found) > 2:
            return found
    return found if len(found) > 1 else linear_ticks(low, high)


def labels(ticks: list[float]) -> list[str]:
    """The numbers as text, with as many decimals as make them different."""
    if not ticks:
        return []
    steps = [b - a for a, b in itertools.pairwise(ticks)] or [abs(ticks[0]) or 1.0]
    decimals = max(0, -math.floor(math.log10(min(steps)) + 1e-9))
    if max(steps) > 1.5 * min(steps):  # a logarithmic scale
        return [f"{each:g}" for each in ticks]
    if decimals > MAX_DECIMALS or max(map(abs, ticks)) >= 1e6:
        return [f"{each:.3g}" for each in ticks]
    return [f"{each:.{decimals}f}" for each in ticks]
