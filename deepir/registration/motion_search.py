"""Where the frames of a burst are: searched, refined by residuals, then by likelihood where their parts like that."""

from __future__ import annotations

from dataclasses import dataclass, replace

from torch import Tensor

from deepir.operators.motion_models import relative
from deepir.registration.alternating_alignment import Aligned, align, standing
from deepir.registration.block_likelihood import NINE, gains, likeliest_turns
from deepir.registration.block_vote import apart, likelier, reduced, scaled, turns
from deepir.registration.frame_groups import one_scene
from deepir.registration.pyramid import Level, build_level

COARSE = 160  # px: the search runs where the frame's longer side is at most this
FINEST = 400_000  # px: larger frames are registered at half their size
ROUNDS = 8  # of alignment at most
FINE = 2  # of them on the last level, if there is one of half the size before
TURNS = 100  # px: of larger frames, means over blocks say how they turn
ENOUGH = 4  # frames: the parts of three are taken in by noise
SMALL = 48  # px: of smaller frames a ninth part says nothing
SPARED = 3  # of the nine parts, which somebody who walks by may be in
NEAR = 0.4  # px of these, at the corners: so far are turns off by chance, and residuals know better


@dataclass(frozen=True)
class Placed:
    """Frames and where they are.

    frames, flat: `(N, H, W)`, as they are and flat. coarse: the level of the search. clear: `(N,)`, how clearly they
    show the scene that most of them show; used: `(N,)` bool, which do. found: what the search found of these.
    motion: `(M, 3, 3)`, where these M are in the end.
    """

    frames: Tensor
    flat: Tensor
    coarse: Level
    clear: Tensor
    used: Tensor
    found: Aligned
    motion: Tensor


def place(frames: Tensor, flat: Tensor, weight: Tensor, model: str) -> Placed:
    """Where frames `(N, H, W)` that show one scene are; weight: `(H, W)`, zero where a pixel is bad."""
    return settled(searched(frames, flat, weight, model), weight, model)


def searched(frames: Tensor, flat: Tensor, weight: Tensor, model: str) -> Placed:
    """The same as the search finds them, nearly."""
    coarse = search_level(flat, weight)
    clear, used, found = one_scene(coarse, "shift" if model == "shift" else "rigid")
    return Placed(frames, flat, coarse, clear, used, found, found.motion)


def settled(placed: Placed, weight: Tensor, model: str) -> Placed:
    """Frames that are nearly placed, by the least residuals, or by likelihood."""
    used, before = placed.used, placed.motion
    if used.sum() < 2:
        return placed
    some = slice(None) if used.all() else used  # no copy of all
    levels = fine(placed.flat[some], weight, placed.coarse.factor)
    moved = refined(levels, before, model)
    liked = likelier(placed.frames[some], weight, moved, model)
    # Parts of frames that turn are not like each other, wherever they are put: a vote says little there.
    level = placed.coarse.of(used)
    if liked is not moved and (not turns(moved, weight) or misfit(level, liked) < misfit(level, moved)):
        moved = liked
    if model == "rigid":
        moved = turned(placed.frames[some], weight, levels, moved)
    return replace(placed, motion=moved)


def turned(frames: Tensor, weight: Tensor, levels: list[Level], motion: Tensor) -> Tensor:
    """Motions `(N, 3, 3)`, or those that residuals find from the likeliest turns, if the frame's parts like these."""
    likeliest = turning(frames, weight, motion)
    if likeliest is motion:
        return motion
    small, factor = reduced(frames, weight, TURNS)
    before, near = (scaled(relative(each), factor) for each in (motion, likeliest))
    if apart(before, near, small) < NEAR:
        return motion
    found = refined(levels, likeliest, "rigid")
    after = scaled(relative(found), factor)
    gained = sorted(gains(small, before, after, NINE))
    return found if sum(gained[:-SPARED]) > 0 else motion


def turning(frames: Tensor, weight: Tensor, motion: Tensor) -> Tensor:
    """The likeliest turns of frames `(N, H, W)` near motions `(N, 3, 3)`; the same of frames that say too little."""
    if len(frames) < ENOUGH or min(weight.shape) < SMALL:
        return motion
    small, factor = reduced(frames, weight, TURNS)
    return scaled(likeliest_turns(small, scaled(relative(motion), factor)), 1 / factor)


def misfit(level: Level, motion: Tensor) -> float:
    """The share of the frames' mean square that neither scene nor pattern explain at these motions."""
    return standing(level, motion)[1]


def search_level(flat: Tensor, weight: Tensor) -> Level:
    """The level of flat frames `(N, H, W)` on which they are searched."""
    return build_level(flat, weight, halvings(max(weight.shape) / COARSE))


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


def halvings(ratio: float) -> int:
    """The least power of two that is at least `ratio`, and at least one."""
    factor = 1
    while factor < ratio:
        factor *= 2
    return factor
