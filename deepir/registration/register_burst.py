"""The registration of a whole burst: which frames show one scene, and how each has moved."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor

from deepir.errors import DataError, nearest
from deepir.operators.motion_models import AUTO, PARAMETERS, identity, relative
from deepir.registration.alignment import Alignment, estimate_pattern
from deepir.registration.frame_selection import (
    MIN_CONCORDANCE,
    SHUTTER,
    concordance,
    frames_at_rest,
    misfit_per_dof,
    shutter_frames,
)
from deepir.registration.motion_search import (
    MAX_ROUNDS,
    estimate_motion,
    final_levels,
    search_level,
    select_homography,
)
from deepir.registration.moving_object_masks import inpaint_mean
from deepir.registration.moving_objects import full_motion, register_beside_moving_objects
from deepir.registration.preprocess import preprocess
from deepir.registration.robust_score import MIN_CLEAR_GAIN, log_likelihood_ratio

UNCERTAIN_CONFIDENCE = 0.85  # confidence below which a message says that a frame's motion may be wrong


@dataclass(frozen=True)
class Registration:
    """The motions of a burst.

    motion: `(N, 3, 3)` float64 pull homographies about the frame's centre, `frame_k(p) = frame_r(T_k p)` with r
    the first frame that is used, in px; NaN where a frame is left out. confidence: `(N,)` in [0, 1], how well
    the frame agrees with the others, once aligned. used: `(N,)` bool. messages: what the user should know.
    """

    motion: Tensor
    confidence: Tensor
    used: Tensor
    messages: list[str] = field(default_factory=list)


@torch.no_grad()
def register(
    frames: Tensor,
    *,
    model: str = "rigid",
    ignore: Tensor | None = None,
    valid: Tensor | None = None,
    start: int = 0,
) -> Registration:
    """Motion of every frame of a burst `(N, H, W)` relative to the first that is used, under strong fixed patterns.

    model: shift, rigid, affine, homography, or auto: rigid, and a homography where the frames bend. ignore:
    `(H, W)` bool, True where a pixel must not be used. valid: `(N, H, W)` bool, False where a sample is made up, of
    something finite. start: the number of the first frame, for messages.
    Raises DataError where the shapes or the model's name are wrong.
    """
    check_arguments(frames, model, ignore)
    frames = frames.detach().cpu()
    missing = None if valid is None or valid.all() else ~valid.cpu()
    if missing is not None:
        frames = inpaint_mean(frames, missing, torch.ones(frames.shape[1:]))
    preprocessed, weight = preprocess(frames, None if ignore is None else ignore.cpu())
    base_model = "rigid" if model == AUTO else model
    n = len(frames)
    excluded = dict.fromkeys(repeated_frames(frames), "is the same as the one before it")
    if n > SHUTTER.min_scene_frames:
        shutter = shutter_frames(search_level(preprocessed, weight), base_model).nonzero()[:, 0].tolist()
        excluded |= dict.fromkeys(shutter, "shows the pattern and no scene, as where a shutter closes")
    motion = torch.full((n, 3, 3), torch.nan, dtype=torch.float64)
    confidence = torch.zeros(n, dtype=torch.float64)
    kept = [k for k in range(n) if k not in excluded] if excluded else slice(None)  # no copy of all
    motion[kept], confidence[kept] = estimate_burst(
        frames[kept], preprocessed[kept], weight, model, None if missing is None else missing[kept]
    )
    return make_registration(motion, confidence, start, excluded)


def repeated_frames(frames: Tensor) -> list[int]:
    """Frames `(N, H, W)` that are the one before them once more, as where a camera is read faster than it looks.

    None if all are: then nothing moves.
    """
    repeated = [k for k in range(1, len(frames)) if torch.equal(frames[k], frames[k - 1])]
    return repeated if len(repeated) < len(frames) - 1 else []


def estimate_burst(
    frames: Tensor, preprocessed: Tensor, weight: Tensor, model: str, missing: Tensor | None
) -> tuple[Tensor, Tensor]:
    """Motions `(N, 3, 3)` of frames and how well they agree `(N,)`, on which `verdict` decides."""
    base_model = "rigid" if model == AUTO else model
    estimate = register_beside_moving_objects(
        estimate_motion(frames, preprocessed, weight, base_model), weight, base_model, missing
    )
    coarse_level, used, alignment, motion = (
        estimate.coarse_level,
        estimate.used,
        estimate.alignment,
        estimate.motion,
    )
    if used.sum() > 1:
        if model == AUTO:
            final_level = final_levels(estimate.preprocessed[used], weight, coarse_level.factor)[-1]
            motion = select_homography(estimate.frames[used], weight, final_level, motion, MAX_ROUNDS)
        alignment = min(
            alignment,
            Alignment(motion, *estimate_pattern(coarse_level.subset(used), motion)),
            key=misfit_per_dof,
        )
    if (resting := frames_at_rest(coarse_level, alignment)).any():
        # Unless most of the frame moves: somebody changes the frames as much, whether the camera moves or rests.
        at_rest, moving = (
            full_motion(replace(estimate, motion=each)) for each in (identity(len(motion)), motion)
        )
        if log_likelihood_ratio(coarse_level, at_rest, moving) < MIN_CLEAR_GAIN:
            return identity(len(frames)), resting.double()
    all_motions = torch.full((len(frames), 3, 3), torch.nan, dtype=torch.float64)
    confidence = 0.5 * MIN_CONCORDANCE * estimate.match_score.clamp_max(1)
    if used.sum() > 1:
        all_motions[used], confidence[used] = (
            motion,
            concordance(coarse_level.subset(used), alignment.pattern, motion),
        )
    return all_motions, confidence


def make_registration(
    motion: Tensor, confidence: Tensor, start: int, excluded: Mapping[int, str]
) -> Registration:
    """Confidence and messages; frames that fail are left out by name, some of which it is known why."""
    confidence = confidence.clamp(0, 1)
    used = confidence >= MIN_CONCORDANCE
    if used.sum() < 2:  # nothing agrees: the first frame stands for itself
        first = next(k for k in range(len(used)) if k not in excluded)
        used = torch.arange(len(used)) == first
        confidence = torch.where(used, 1.0, confidence.clamp_max(0.5 * MIN_CONCORDANCE))
        motion[first] = torch.eye(3, dtype=torch.float64)
    messages = []
    for k in range(len(used)):
        if k in excluded:
            messages.append(f"frame {start + k} {excluded[k]}: left out")
        elif not used[k]:
            messages.append(
                f"frame {start + k} does not register (confidence {float(confidence[k]):.2f}): left out"
            )
        elif confidence[k] < UNCERTAIN_CONFIDENCE:
            messages.append(
                f"frame {start + k} shows little that registers (confidence {float(confidence[k]):.2f}): "
                "its motion may be wrong"
            )
    first = int(used.nonzero()[0])
    if first:
        messages.append(
            f"frame {start + first} is the first that registers: motions and results are relative to it"
        )
    motion = torch.where(used[:, None, None], relative(motion, first), torch.nan)
    motion[first] = torch.eye(3, dtype=torch.float64)
    return Registration(motion, confidence, used, messages)


def check_arguments(frames: Tensor, model: str, ignore: Tensor | None) -> None:
    """Raise DataError where the arguments of `register` cannot be used."""
    if frames.ndim != 3:
        raise DataError(f"registration wants frames (N, height, width), not {tuple(frames.shape)}")
    if model not in (known := [*PARAMETERS, AUTO]):
        raise DataError(f"motion model '{model}' is not known; {nearest(model, known)}")
    if ignore is not None and ignore.shape != frames.shape[1:]:
        raise DataError(
            f"the bad-pixel mask is {tuple(ignore.shape)}, the frames are {tuple(frames.shape[1:])}"
        )
