"""How a function of arrays becomes a method: what it is given, and how frames are registered and averaged after it."""

from __future__ import annotations

import dataclasses
import functools
import inspect
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar

import numpy as np
import torch
from scipy import ndimage

from deepir.arrays import Array
from deepir.arrays.windows import fill_nearest
from deepir.assembly import build
from deepir.burst import Burst
from deepir.config import Config
from deepir.operators.motion_models import homographies
from deepir.optim.objective import held_out_error, hold_out
from deepir.pipeline.register import motion_messages, register_frames
from deepir.pipeline.schedule import registered_average
from deepir.registry import lookup, register
from deepir.result import Result, neutral, to_gauge

#: Motion (N, 3, 3) or None, used frames (N,) bool, and messages.
Ratio = float | Sequence[float]  # points per px, down and across if they differ
Registration = tuple[torch.Tensor | None, Array, list[str]]
State = TypeVar("State")
Function = TypeVar("Function", bound=Callable[..., Any])

GAIN_LIMITS = (0.2, 5.0)  # least and largest gain of a usable pixel, in medians of all gains


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
    offset = estimate(burst.frames)
    offset = offset - offset[~burst.bad_pixels].mean()
    result = average(dataclasses.replace(burst, frames=(burst.frames - offset).astype(np.float32)), config)
    result.offset = offset.astype(np.float32)
    return result


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


@register("method", "average")
def average(burst: Burst, config: Config) -> Result:
    """Register the frames of a scene and average them; gain and offset stay as they are."""
    found = register_burst(burst, config)
    result = average_frames(burst, config, burst.frames, found)
    if "scene" not in burst.truth and found[1].sum() > 1:
        result.metrics["held_out_rmse"] = _held_out_error(burst, config, found)
    return result


def register_burst(burst: Burst, config: Config) -> Registration:
    """Motion, used frames and messages of a burst; its fixed pattern does not disturb the registration."""
    recipe = lookup("problem", config.problem, "problem")()
    motion, used, messages = register_frames(burst, config, recipe)
    if recipe.motion and motion is not None:
        messages += motion_messages(motion[torch.from_numpy(used)], burst.size)
    return motion, used, messages


def average_frames(burst: Burst, config: Config, frames: Array, registration: Registration | None = None) -> Result:
    """Register a burst as recorded, unless its registration is known, and average its corrected frames (N, h, w).

    The average is the scene; the gain is one, the offset zero.
    """
    motion, used, messages = registration or register_burst(burst, config)
    kept = dataclasses.replace(burst, frames=frames[used].astype(np.float32), valid=burst.valid[used])
    problem, geometry = build(config, kept, None if motion is None else motion[used])
    if motion is not None:
        good = kept.valid & ~kept.bad_pixels
        scene = registered_mean(kept.frames, good, motion[used].numpy(), geometry.ratio)
    else:
        with torch.no_grad():
            mean, weight = problem.backproject(problem.values())
            scene = geometry.crop(fill_nearest(mean, weight > 0.3 * weight.max()))
    poses = None if motion is None else homographies(problem.values()["motion"]).detach().numpy()
    return result_of(burst, scene.numpy(), used, poses, messages=messages)


def result_of(
    burst: Burst, scene: Array, used: Array, motion: Array | None, *, iterations: int = 0, messages: Sequence[str] = ()
) -> Result:
    """A result with gain one, offset zero and a scene (H, W) of the K frames `used`, which have a motion (K, 3, 3)."""
    result = neutral(scene, len(used), burst.size, burst.bad_pixels)
    if motion is not None:
        result.motion[used], result.motion[~used] = motion, float("nan")
    result.frames_used, result.messages = used, list(messages)
    result.metrics = {"iterations": iterations, "evaluations": iterations, "stop_reason": "converged"}
    return result


@torch.no_grad()
def _held_out_error(burst: Burst, config: Config, registration: Registration) -> float:
    """Root mean square error at held-out samples, which the average of the others predicts: what stands for a truth."""
    motion, used, _ = registration
    kept = dataclasses.replace(burst, frames=burst.frames[used], valid=burst.valid[used], clipped=None)
    problem, _ = build(config, kept, None if motion is None else motion[used])
    hold_out(problem, config.seed)
    problem.fields["scene"].init_from(registered_average(problem))
    return held_out_error(problem)


def correct_and_average(
    burst: Burst, config: Config, gain: Array, offset: Array, registration: Registration | None = None
) -> Result:
    """Correct the frames for gain, in any gauge, and offset, (h, w) each; then register and average them.

    Pixels with a gain outside `GAIN_LIMITS` are bad. A known `registration` is that of the frames as recorded.
    """
    registration = registration or register_burst(burst, config)
    gain = gain / np.median(gain[~burst.bad_pixels])
    good = ~burst.bad_pixels & (gain > GAIN_LIMITS[0]) & (gain < GAIN_LIMITS[1])
    gain = np.where(good, gain, 1.0)
    burst = dataclasses.replace(burst, bad_pixels=~good)
    result = average_frames(burst, config, (burst.frames - offset) / gain, registration)
    result.gain, result.offset = gain, offset
    to_gauge(result)
    return result


def registered_mean(frames: Array, valid: Array, motion: Array, ratio: Ratio = 1.0) -> torch.Tensor:
    """Mean of registered frames on frame 0's grid or one `ratio` times as fine, by cubic spline interpolation.

    Of frames (N, h, w), their valid samples and their motion (N, 3, 3), pull homographies in px about the centre; gives
    (ratio h, ratio w), float64. Points that no frame shows take the nearest value.
    """
    height, width = np.rint(np.multiply(ratio, frames.shape[1:])).astype(int)
    total, count = np.zeros((2, height, width))
    for frame, good, back in zip(fill_invalid(frames, valid), valid, np.linalg.inv(motion), strict=True):
        at = to_indices(sampling_points(back, (height, width), ratio), frame.shape)
        seen = ndimage.map_coordinates(good.astype(np.float32), at, order=1, cval=0) > 0.99
        total += seen * ndimage.map_coordinates(frame, at, order=3, mode="mirror")
        count += seen
    mean = torch.from_numpy(total / count.clip(min=1))[None, None]
    return fill_nearest(mean, torch.from_numpy(count > 0)[None, None])[0, 0]


def sampling_points(motion: Array, size: tuple[int, ...], ratio: Ratio = 1.0) -> Array:
    """Points (2, h, w) of frame 0, y and x in px from the centre, at which the pixels of a frame look.

    By a pull homography (3, 3) in px about the centre, on a grid of `size` (h, w) with `ratio` points per px.
    """
    finer = np.broadcast_to(ratio, 2)
    y, x = ((np.arange(side) - (side - 1) / 2) / each for side, each in zip(size, finer, strict=True))
    at = motion @ np.stack([each.ravel() for each in np.broadcast_arrays(x, y[:, None], 1.0)])
    return np.asarray((at[1::-1] / at[2]).reshape(2, *size))


def to_indices(places: Array, shape: tuple[int, ...], ratio: Ratio = 1.0) -> Array:
    """Row and column (2, ...), in an array with `ratio` points per px, of y and x (2, ...) in px from the centre."""
    finer = np.broadcast_to(ratio, 2)
    return np.stack([each * place + (side - 1) / 2 for each, place, side in zip(finer, places, shape, strict=True)])


def fill_invalid(frames: Array, valid: Array) -> Array:
    """Frames (N, h, w) whose samples that are not `valid` (N, h, w) take the value of the nearest valid one."""
    pairs = zip(torch.from_numpy(frames), torch.from_numpy(valid), strict=True)
    return np.stack([fill_nearest(frame[None, None], good[None, None])[0, 0].numpy() for frame, good in pairs])


def filled_frames(burst: Burst) -> Array:
    """Frames (N, h, w) whose invalid samples and bad pixels take the nearest valid value."""
    return fill_invalid(burst.frames, burst.valid & ~burst.bad_pixels)


def normalise(frames: Array) -> tuple[Array, float, float]:
    """Frames from about zero to about one, and their lowest value and their range in the data's units."""
    low, high = np.percentile(frames, [0.1, 99.9])
    span = float(high - low) or 1.0
    return (frames.astype(np.float64) - low) / span, float(low), span


def last_of(states: Iterator[State]) -> State:
    """The state of an online method after all frames."""
    return deque(states, maxlen=1).pop()
