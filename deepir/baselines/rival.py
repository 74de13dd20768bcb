"""How a function that corrects frames, or estimates pattern or scene, becomes a method."""

from __future__ import annotations

import dataclasses
import functools
import inspect
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

import numpy as np

from deepir.baselines.average import Array, average, average_frames, correct_and_average, fill_invalid, register_burst
from deepir.burst import Burst
from deepir.config import Config
from deepir.registry import register
from deepir.result import Result

State = TypeVar("State")
Function = TypeVar("Function", bound=Callable[..., Any])


def rival(name: str, how: Callable[[Burst, Config, Callable[..., Any]], Result]) -> Callable[[Function], Function]:
    """Decorator that registers a method and leaves the function as it is.

    Args:
        name: Name of the method.
        how: What the function is given, and how the burst is corrected by what it returns: `correct_frames`,
            `estimate_pattern`, `estimate_offset`, `estimate_registered_pattern` or `estimate_scene`.

    Returns:
        The decorator; keyword-only arguments of the function are the options of the method.
    """

    def add(function: Function) -> Function:
        @functools.wraps(function)
        def method(burst: Burst, config: Config, **options: Any) -> Result:
            return how(burst, config, functools.partial(function, **options))

        context = inspect.signature(method, follow_wrapped=False).parameters.values()
        options = inspect.signature(function).parameters.values()
        method.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
            [*list(context)[:2], *(each for each in options if each.kind is each.KEYWORD_ONLY)]
        )
        register("method", name)(method)
        return function

    return add


def correct_frames(burst: Burst, config: Config, correct: Callable[[Array], Array]) -> Result:
    """Correct each frame (h, w) by itself, then register and average."""
    return average_frames(burst, config, np.stack([correct(frame) for frame in filled_frames(burst)]))


def estimate_pattern(burst: Burst, config: Config, estimate: Callable[[Array], tuple[Array, Array]]) -> Result:
    """Correct for the gain and offset (h, w) of frames (N, h, w), then register and average."""
    return correct_and_average(burst, config, *estimate(filled_frames(burst)))


def estimate_offset(burst: Burst, config: Config, estimate: Callable[[Array], Array]) -> Result:
    """Subtract the offset (h, w) of frames (N, h, w), then as `average`; the gain stays one."""
    return subtract_and_average(burst, config, estimate(burst.frames))


def estimate_registered_pattern(
    burst: Burst, config: Config, estimate: Callable[[Array, Array, Array | None], tuple[Array, Array]]
) -> Result:
    """Register, correct for the gain and offset of frames, valid samples and motion (N, 3, 3) or None; average."""
    found = motion, used, _ = register_burst(burst, config)
    valid = (burst.valid & ~burst.bad_pixels)[used]
    pattern = estimate(burst.frames[used], valid, None if motion is None else motion[used].numpy())
    return correct_and_average(burst, config, *pattern, found)


def estimate_scene(
    burst: Burst, config: Config, estimate: Callable[[Array, Array, Array, tuple[int, ...]], Array]
) -> Result:
    """Register and estimate the scene from frames, valid samples, motion (N, 3, 3) and the scene's height and width.

    Gain and offset stay as they are. Without motion, the frames are averaged.
    """
    found = motion, used, _ = register_burst(burst, config)
    result = average_frames(burst, config, burst.frames, found)
    if motion is not None:
        valid = (burst.valid & ~burst.bad_pixels)[used]
        result.scene = estimate(burst.frames[used], valid, motion[used].numpy(), result.scene.shape)
    return result


def subtract_and_average(burst: Burst, config: Config, offset: Array) -> Result:
    """Subtract an offset (h, w) from the frames, then as `average`."""
    offset = offset - offset[~burst.bad_pixels].mean()
    frames = (burst.frames - offset).astype(np.float32)
    result: Result = average(dataclasses.replace(burst, frames=frames), config)
    result.offset = offset.astype(np.float32)
    return result


def filled_frames(burst: Burst) -> Array:
    """Frames (N, h, w) whose invalid samples and bad pixels take the nearest valid value."""
    return fill_invalid(burst.frames, burst.valid & ~burst.bad_pixels)


def normalise(frames: Array) -> tuple[Array, float, float]:
    """Frames in units of their range.

    Args:
        frames: (N, h, w), in the data's units.

    Returns:
        Frames from about zero to about one, their lowest value and their range, in the data's units.
    """
    low, high = np.percentile(frames, [0.1, 99.9])
    span = float(high - low) or 1.0
    return (frames.astype(np.float64) - low) / span, float(low), span


def last_of(states: Iterator[State]) -> State:
    """The state of an online method after all frames."""
    return deque(states, maxlen=1).pop()
