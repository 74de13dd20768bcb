"""The registration of a whole burst: which frames show one scene, and how each has moved."""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
from torch import Tensor

from deepir.errors import DataError, nearest
from deepir.registration.align import Aligned, align, standing
from deepir.registration.bend import bent
from deepir.registration.flatten import flatten
from deepir.registration.group import FAILED, agreement, at_rest, left, one_scene
from deepir.registration.motion import AUTO, PARAMETERS, identity, relative
from deepir.registration.pyramid import Level, build_level
from deepir.registration.vote import likelier, turns
from deepir.registration.walker import beside_walker

COARSE = 160  # px: the search runs where the frame's longer side is at most this
FINEST = 400_000  # px: larger frames are registered at half their size
ROUNDS = 8  # of alignment at most
FINE = 2  # of them on the last level, if there is one of half the size before
UNSURE = 0.85  # confidence below which a frame's motion may be wrong


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
    frames: Tensor, *, model: str = "rigid", ignore: Tensor | None = None, start: int = 0
) -> Registration:
    """Motion of every frame of a burst `(N, H, W)` relative to the first that is used, under strong fixed patterns.

    model: shift, rigid, affine, homography, or auto: rigid, and a homography where the frames bend. ignore:
    `(H, W)` bool, True where a pixel must not be used. start: the number of the first frame, for messages.
    Raises DataError where the shapes or the model's name are wrong.
    """
    check(frames, model, ignore)
    flat, weight = flatten(frames.detach().cpu(), None if ignore is None else ignore.cpu())
    coarse = build_level(flat, weight, halvings(max(frames.shape[1:]) / COARSE))
    clear, used, found = one_scene(coarse, "shift" if model == "shift" else "rigid")
    n, moved = len(frames), found.motion
    if used.sum() > 1:
        some = slice(None) if used.all() else used  # no copy of all
        first = "rigid" if model == AUTO else model
        levels = fine(flat[some], weight, coarse.factor)
        moved = refined(levels, moved, first)
        liked = likelier(frames.detach().cpu()[some], weight, moved, first)
        # Parts of frames that turn are not like each other, wherever they are put: a vote says little there.
        if liked is not moved and (
            not turns(moved, weight) or misfit(coarse.of(used), liked) < misfit(coarse.of(used), moved)
        ):
            moved = liked
        moved, beside = beside_walker(
            frames.detach().cpu()[some],
            flat[some],
            weight,
            coarse.of(used),
            moved,
            lambda flat, weight, motion: refined(fine(flat, weight, coarse.factor), motion, first),
        )
        if beside is not weight:
            flat, weight = flat * beside, beside
            coarse = build_level(flat, weight, coarse.factor)
            found = Aligned(moved, *standing(coarse.of(used), moved))
            levels = fine(flat[some], weight, coarse.factor)
        if model == AUTO:
            moved = bent(frames.detach().cpu()[some], weight, levels[-1], moved, ROUNDS)
        found = min(found, Aligned(moved, *standing(coarse.of(used), moved)), key=left)
    still = at_rest(coarse, found)
    if still.any():
        return verdict(identity(n), still.double(), start)
    motion = torch.full((n, 3, 3), torch.nan, dtype=torch.float64)
    confidence = 0.5 * FAILED * clear.clamp_max(1)
    if used.sum() > 1:
        motion[used], confidence[used] = moved, agreement(coarse.of(used), found.pattern, moved)
    return verdict(motion, confidence, start)


def misfit(level: Level, motion: Tensor) -> float:
    """The share of the frames' mean square that neither scene nor pattern explain at these motions."""
    return standing(level, motion)[1]


def fine(flat: Tensor, weight: Tensor, coarse: int) -> list[Level]:
    """The levels of flat frames `(N, H, W)` on which they are registered in the end, after one of factor `coarse`."""
    last = halvings((weight.numel() / FINEST) ** 0.5)
    factors = (2 * last, last) if 2 * last < coarse else (last,)
    return [build_level(flat, weight, factor) for factor in factors]


def refined(levels: list[Level], motion: Tensor, model: str) -> Tensor:
    """The motion after rounds on these levels, fewer on the last of two."""
    for level, rounds in zip(levels, (ROUNDS - FINE, FINE) if levels[1:] else (ROUNDS,), strict=True):
        motion = align(level, motion, model, rounds).motion
    return motion


def verdict(motion: Tensor, confidence: Tensor, start: int = 0) -> Registration:
    """Confidence and messages; frames that fail are left out by name."""
    confidence = confidence.clamp(0, 1)
    used = confidence >= FAILED
    if used.sum() < 2:  # nothing agrees: the first frame stands for itself
        used = torch.arange(len(used)) == 0
        confidence = torch.where(used, 1.0, confidence.clamp_max(0.5 * FAILED))
        motion[0] = torch.eye(3, dtype=torch.float64)
    messages = []
    for k in range(len(used)):
        if not used[k]:
            messages.append(
                f"frame {start + k} does not register (confidence {float(confidence[k]):.2f}): left out"
            )
        elif confidence[k] < UNSURE:
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


def halvings(ratio: float) -> int:
    """The least power of two that is at least `ratio`, and at least one."""
    factor = 1
    while factor < ratio:
        factor *= 2
    return factor


def check(frames: Tensor, model: str, ignore: Tensor | None) -> None:
    """Raise DataError where the arguments of `register` cannot be used."""
    if frames.ndim != 3:
        raise DataError(f"registration wants frames (N, height, width), not {tuple(frames.shape)}")
    if model not in (known := [*PARAMETERS, AUTO]):
        raise DataError(f"motion model '{model}' is not known; {nearest(model, known)}")
    if ignore is not None and ignore.shape != frames.shape[1:]:
        raise DataError(
            f"the bad-pixel mask is {tuple(ignore.shape)}, the frames are {tuple(frames.shape[1:])}"
        )
