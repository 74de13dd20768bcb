"""Registration of a burst: which frames show one scene, the motion of each, and how confident it is."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor

from deepir.errors import DataError, nearest
from deepir.messages import Message
from deepir.operators.motion_models import AUTO, PARAMETERS, identity, relative
from deepir.registration.alignment import Alignment, estimate_pattern
from deepir.registration.frame_selection import (
    MIN_CONCORDANCE,
    MIN_SCENE_FRAMES,
    concordance,
    frames_at_rest,
    misfit_per_dof,
    shutter_frames,
)
from deepir.registration.motion_search import coarse_search, final_levels, refine, search_level, select_homography
from deepir.registration.moving_objects import inpaint_mean, register_beside_moving_objects
from deepir.registration.preprocess import preprocess
from deepir.registration.robust_score import accept_by_residuals

UNCERTAIN_CONFIDENCE = 0.85  # confidence below which a message says that a frame's motion may be wrong


@dataclass(frozen=True)
class Registration:
    """The motions of a burst.

    motion: `(N, 3, 3)` float64, pull homographies in px about the frame's centre, `frame_k(p) = frame_r(T_k p)`, with r
    the first frame that is used; NaN where a frame is left out. confidence: `(N,)` in [0, 1], concordance of each frame
    with the others. used: `(N,)` bool. messages: for the user.
    """

    motion: Tensor
    confidence: Tensor
    used: Tensor
    messages: list[str] = field(default_factory=list)


@torch.no_grad()
def register(
    frames: Tensor, *, model: str = "rigid", ignore: Tensor | None = None, valid: Tensor | None = None, start: int = 0
) -> Registration:
    """Register a burst under strong fixed-pattern noise.

    Args:
        frames: `(N, H, W)`, any unit; NaN or infinite where a pixel is bad.
        model: "shift", "rigid", "affine", "homography", or "auto": rigid, or homographies where these are clearly more
            likely.
        ignore: `(H, W)` bool, True where a pixel must not be used.
        valid: `(N, H, W)` bool, False where a sample has no data but some finite value.
        start: number of the first frame in messages.

    Returns:
        Motions relative to the first frame that is used.

    Raises:
        DataError: a shape is wrong or the model is unknown.
    """
    if frames.ndim != 3:
        raise DataError(f"registration needs frames (N, height, width), not {tuple(frames.shape)}")
    if model not in (known := [*PARAMETERS, AUTO]):
        raise DataError(f"motion model '{model}' is not known; {nearest(model, known)}")
    if ignore is not None and ignore.shape != frames.shape[1:]:
        raise DataError(f"the bad-pixel mask is {tuple(ignore.shape)}, the frames are {tuple(frames.shape[1:])}")
    frames = frames.detach().cpu()
    if not frames.is_floating_point():
        frames = frames.float()
    missing = None if valid is None or valid.all() else ~valid.cpu()
    if missing is not None:
        frames = inpaint_mean(frames, missing, torch.ones(frames.shape[1:]))
    preprocessed, weight = preprocess(frames, None if ignore is None else ignore.cpu())
    n = len(frames)
    excluded = {
        k: "is the same as the one before it" if earlier == k - 1 else f"is the same as frame {start + earlier}"
        for k, earlier in repeated_frames(frames).items()
    }
    distinct = [k for k in range(n) if k not in excluded]
    if len(distinct) > MIN_SCENE_FRAMES:
        level = search_level(preprocessed, weight).subset(torch.tensor(distinct))
        is_shutter = shutter_frames(level, "rigid" if model == AUTO else model)
        reason = "shows the pattern and no scene, as where a shutter closes"
        excluded |= {k: reason for k, closed in zip(distinct, is_shutter.tolist(), strict=True) if closed}
    frames = torch.where(weight > 0, frames.float(), 0.0)
    motion = torch.full((n, 3, 3), torch.nan, dtype=torch.float64)
    confidence = torch.zeros(n, dtype=torch.float64)
    kept = [k for k in range(n) if k not in excluded] if excluded else slice(None)  # no copy of all
    motion[kept], confidence[kept] = estimate_burst(
        frames[kept], preprocessed[kept], weight, model, None if missing is None else missing[kept]
    )
    return make_registration(motion, confidence, start, excluded)


def repeated_frames(frames: Tensor) -> dict[int, int]:
    """Frames that equal an earlier one of `(N, H, W)`, and the last such; none if all do, as nothing moves then."""
    last: dict[bytes, int] = {}
    repeated = {}
    for k, frame in enumerate(frames):
        digest = hashlib.sha256(frame.contiguous().numpy()).digest()
        if digest in last:
            repeated[k] = last[digest]
        last[digest] = k
    return repeated if len(last) > 1 else {}


def estimate_burst(
    frames: Tensor, preprocessed: Tensor, weight: Tensor, model: str, missing: Tensor | None
) -> tuple[Tensor, Tensor]:
    """Estimate motions, select their model (rest, the model itself, homography), and compute confidences.

    Args:
        frames: `(N, H, W)`, zero where the weight is zero.
        preprocessed: `(N, H, W)`, likewise.
        weight: `(H, W)`, zero where a pixel is bad.
        model: motion model, or "auto".
        missing: `(N, H, W)` bool, samples without data.

    Returns:
        Motions `(N, 3, 3)`, NaN where a frame is not used, and confidences `(N,)`, for `make_registration`.
    """
    estimate = refine(coarse_search(frames, preprocessed, weight, "rigid" if model == AUTO else model))
    estimate = register_beside_moving_objects(estimate, missing)
    level, used, alignment, motion = estimate.coarse_level, estimate.used, estimate.alignment, estimate.motion
    if used.sum() > 1:
        if model == AUTO:
            final_level = final_levels(estimate.preprocessed[used], weight, level.factor)[-1]
            motion = select_homography(estimate.frames[used], weight, final_level, motion)
        refined = Alignment(motion, *estimate_pattern(level.subset(used), motion))
        alignment = min(alignment, refined, key=misfit_per_dof)
    if (is_resting := frames_at_rest(level, alignment)).any():
        # A moving object changes the frames as much as camera motion does: rest must hold for most of the frame.
        rest, moving = (replace(estimate, motion=each) for each in (identity(len(motion)), motion))
        if not accept_by_residuals(level, rest.full_motion, moving.full_motion):
            return identity(len(frames)), is_resting.double()
    motions = torch.full((len(frames), 3, 3), torch.nan, dtype=torch.float64)
    confidence = 0.5 * MIN_CONCORDANCE * estimate.match_score.clamp_max(1)
    if used.sum() > 1:
        motions[used] = motion
        confidence[used] = concordance(level.subset(used), alignment.pattern, motion)
    return motions, confidence


def make_registration(motion: Tensor, confidence: Tensor, start: int, excluded: Mapping[int, str]) -> Registration:
    """Leave out frames of low confidence, make motions relative to the first frame used, and write messages.

    Args:
        motion: `(N, 3, 3)`, NaN where a frame is not used.
        confidence: `(N,)`; frames below `MIN_CONCORDANCE` are left out.
        start: number of the first frame in messages.
        excluded: reasons, by frame number, of frames that were not registered.
    """
    confidence = confidence.clamp(0, 1)
    used = confidence >= MIN_CONCORDANCE
    if used.sum() < 2:  # no two frames agree: the first one is its own reference
        first = next(k for k in range(len(used)) if k not in excluded)
        used = torch.arange(len(used)) == first
        confidence = torch.where(used, 1.0, confidence.clamp_max(0.5 * MIN_CONCORDANCE))
        motion[first] = torch.eye(3, dtype=torch.float64)
    messages: list[str] = []
    for k in range(len(used)):
        if k in excluded:
            messages.append(Message("frame-repeated", f"frame {start + k} {excluded[k]}: left out"))
        elif not used[k]:
            messages.append(
                Message(
                    "frame-not-registered",
                    f"frame {start + k} does not register (confidence {float(confidence[k]):.2f}): left out",
                )
            )
        elif confidence[k] < UNCERTAIN_CONFIDENCE:
            messages.append(
                Message(
                    "motion-uncertain",
                    f"frame {start + k} shows little that registers (confidence {float(confidence[k]):.2f}): "
                    "its motion may be wrong",
                )
            )
    first = int(used.nonzero()[0])
    if first:
        messages.append(
            Message(
                "reference-frame",
                f"frame {start + first} is the first that registers: motions and results are relative to it",
            )
        )
    motion = torch.where(used[:, None, None], relative(motion, first), torch.nan)
    motion[first] = torch.eye(3, dtype=torch.float64)
    return Registration(motion, confidence, used, messages)
