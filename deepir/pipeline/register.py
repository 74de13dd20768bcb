"""The motion that a problem starts from: registered frames; and what to say of how frames move."""

from __future__ import annotations

import dataclasses

import numpy as np
import torch
from torch import Tensor

from deepir.analysis import MIN_MOTION_SPAN
from deepir.arrays.windows import fill_nearest
from deepir.burst import Burst
from deepir.config import Config
from deepir.diagnostics.fit import longest_shutter_segment, shutter_message
from deepir.errors import DataError
from deepir.messages import Message
from deepir.problems.recipe import Recipe
from deepir.registration import register
from deepir.registry import components

MAX_STILL_MOTION = 0.5  # px at the frame's edge: a burst at rest moves by less
MAX_OVERLAY_SHARE = 0.5  # of the pixels that hold one value in all frames, up to which they are an overlay


def register_frames(burst: Burst, config: Config, recipe: Recipe) -> tuple[Tensor | None, np.ndarray, list[str]]:
    """Motion (N, 3, 3) of each frame, which frames are used, and messages; no motion if no slot wants it.

    Raises:
        DataError: Too few frames register, or the burst is still and the problem needs motion.
    """
    everything = np.ones(len(burst.frames), bool)
    model = motion_model(config)
    if model is None or len(burst.frames) == 1:
        return None, everything, []
    if burst.motion is not None:
        known = np.asarray(np.isfinite(burst.motion).all((1, 2)))
        return torch.from_numpy(burst.motion), known, []
    ignore, valid = torch.from_numpy(burst.bad_pixels), torch.from_numpy(burst.valid | burst.bad_pixels)
    frames = torch.from_numpy(burst.frames)
    if not burst.valid.all():  # zeros would stand out
        frames = fill_nearest(frames[:, None], torch.from_numpy(burst.valid)[:, None])[:, 0]
    part = longest_shutter_segment(frames, torch.from_numpy(burst.valid & ~burst.bad_pixels))
    found = register(frames[part], model=model, ignore=ignore, valid=valid[part], start=part.start)
    drawn = (frames == frames[0]).all(0)
    still = _spans(found.motion[found.used], burst.size).max() < MAX_STILL_MOTION
    if still and 0 < drawn.double().mean() < MAX_OVERLAY_SHARE:
        # Before a plain scene what the camera draws over its pictures keeps all of them at rest.
        found = register(frames[part], model=model, ignore=ignore | drawn, valid=valid[part], start=part.start)
    if part != slice(0, len(frames)) and _spans(found.motion[found.used], burst.size).max() < MIN_MOTION_SPAN:
        part = slice(0, len(frames))  # a camera that rests here, and there: no shutter
        found = register(frames, model=model, ignore=ignore, valid=valid)
    used, motion = ~everything, torch.full((len(frames), 3, 3), torch.nan, dtype=torch.float64)
    used[part], motion[part] = found.used.numpy(), found.motion
    if used.sum() < max(recipe.frames, 1):
        raise DataError(
            f"{burst.source}: only {used.sum()} of {len(used)} frames register with each other, "
            f"{recipe.frames} are needed; is it one scene? {'; '.join(found.messages)}"
        )
    kept = torch.from_numpy(used)
    messages = shutter_message(part, len(frames)) + found.messages
    at = _places(motion[kept], burst.size)
    if recipe.motion and (at - at[0]).abs().amax() < MAX_STILL_MOTION:
        raise DataError(
            f"{burst.source}: the frames do not move as a whole, or show too little to register, so that scene and "
            "fixed pattern cannot be separated. Move the camera between frames, by 3 to 10 px in x and in y, "
            "over something with edges; what stands still before it (a bonnet, a frame) is left out by data.crop or "
            "data.mask"
        )
    return motion, used, messages


def frames_of_burst(burst: Burst, which: np.ndarray) -> Burst:
    """Some frames of a burst, by a mask (N,) or their numbers, without those beside it."""
    clipped = None if burst.clipped is None else burst.clipped[which]
    return dataclasses.replace(
        burst, frames=burst.frames[which], valid=burst.valid[which], clipped=clipped, beside=None
    )


def motion_model(config: Config) -> str | None:
    """The type of the first motion that starts where the frames are registered: each does, unless it says otherwise."""
    for stage in config.physics.values():
        slot = (stage or {}).get("motion")
        settings = slot if isinstance(slot, dict) else {"type": slot}
        kind = settings.get("type")
        model = getattr(components("field").get(str(kind)), "model", None)
        if settings.get("init", "register" if model else None) == "register":
            return str(model or kind)
    return None


def motion_messages(motion: Tensor, size: tuple[int, int]) -> list[str]:
    """What motions (N, 3, 3) of frames (h, w) leave open: a message for each axis along which they are small, or if
    they are along a line.
    """
    few: list[str] = [
        Message(
            "motion-small",
            f"the frames move by only {float(span):.1f} px along {axis}: the {lines}' fixed pattern is hard to "
            "separate from the scene. Move the camera between frames, by 3 to 10 px in x and in y",
        )
        for axis, lines, span in zip("xy", ("columns", "rows"), _spans(motion, size), strict=True)
        if span < MIN_MOTION_SPAN
    ]
    return few or _along_a_line(_places(motion, size))


def _places(motion: Tensor, size: tuple[int, int]) -> Tensor:
    """Where the corners of frames (h, w) look, (N, 4, 2), in px (x, y) from the middle of frame 0."""
    height, width = size
    corners = torch.tensor([(x * width / 2, y * height / 2, 1) for x in (-1, 1) for y in (-1, 1)])
    at = corners.to(motion) @ motion.mT
    return at[..., :2] / at[..., 2:]


def _spans(motion: Tensor, size: tuple[int, int]) -> Tensor:
    """Ranges of these places along x and y, where they are largest."""
    at = _places(motion, size)
    return (at.amax(0) - at.amin(0)).amax(0)


def _along_a_line(at: Tensor) -> list[str]:
    """A message if one way, straight or about a point, leads through all places (N, 4, 2) of the frames' corners."""
    apart = (at - at.mean(0)).flatten(1)
    ways = torch.linalg.svd(apart, full_matrices=False)[2]
    steps = ways.view(-1, 4, 2)
    along, beside = (
        float(np.ptp((apart @ way).numpy()) * step.norm(dim=1).max())
        for way, step in zip(ways[:2], steps[:2], strict=True)
    )
    if beside >= MIN_MOTION_SPAN / 2:
        return []
    shift = steps[0].mean(0)
    if (steps[0] - shift).norm(dim=1).max() > shift.norm():  # some point of the frames rests
        message = Message(
            "motion-about-a-point",
            f"the frames turn about one point, by {along:.1f} px at their corners, and do not move: what is "
            "constant around it is hard to separate from the scene. Move the camera too, by 3 to 10 px in x and in y",
        )
    else:
        message = Message(
            "motion-along-a-line",
            f"the frames move along one line, by {along:.1f} px: what is constant along it is hard to separate from "
            "the scene. Move the camera at right angles to it too, by 3 to 10 px",
        )
    return [message]
