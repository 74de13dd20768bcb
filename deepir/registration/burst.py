"""The registration of a whole burst: every frame to the first, then to the scene that all of them show."""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
from torch import Tensor

from deepir.errors import DataError, nearest
from deepir.registration.coarse import guesses
from deepir.registration.flatten import flatten, without_stripes
from deepir.registration.motion import PARAMETERS, normalised, rotation, transform
from deepir.registration.pyramid import Level, build_level, pattern_share, sample
from deepir.registration.refine import refine

FAILED = 0.3  # confidence below which a frame is left out
COARSE = 160  # px: the search runs where the frame's longer side is at most this
NARROW, WIDE = 15, 101  # px: windows across the stripes, for the last level and the search
ROUNDS, PATTERN_STEPS = 4, 2  # passes over pattern and motion, and over scene and pattern within
SETTLED = 5e-3  # px of the level: a smaller change ends the passes


@dataclass(frozen=True)
class Registration:
    """The motions of a burst.

    motion: `(N, 3, 3)` float64 pull homographies about the frame's centre, `frame_k(p) = frame_0(T_k p)`, in
    px; NaN where a frame is left out. confidence: `(N,)` in [0, 1]. used: `(N,)` bool. messages: what the
    user should know.
    """

    motion: Tensor
    confidence: Tensor
    used: Tensor
    messages: list[str] = field(default_factory=list)


@torch.no_grad()
def register(frames: Tensor, *, model: str = "rigid", ignore: Tensor | None = None) -> Registration:
    """Motion of every frame of a burst `(N, H, W)` relative to its first, under strong fixed-pattern noise.

    model: shift, rigid, affine or homography. ignore: `(H, W)` bool, True where a pixel must not be used.
    Raises DataError where the shapes or the model's name are wrong.
    """
    check(frames, model, ignore)
    flat, weight = flatten(frames.detach().cpu(), None if ignore is None else ignore.cpu())
    factor = 1
    while max(frames.shape[1:]) > COARSE * factor:
        factor *= 2
    rough = without_stripes(flat, WIDE)
    coarse = build_level(rough, weight, factor)
    motion, score = search(coarse, model)
    motion, score = retry(coarse, motion, score, model)
    for i in range(factor.bit_length() - 1):
        motion, score = to_scene(build_level(rough, weight, factor >> i), motion, score, model)
    level = build_level(without_stripes(flat, NARROW), weight, 1)
    motion, score = to_scene(level, motion, score, model)
    return verdict(motion, score - pattern_share(level) * stillness(level, motion))


def check(frames: Tensor, model: str, ignore: Tensor | None) -> None:
    """Raise DataError where the arguments of `register` cannot be used."""
    if frames.ndim != 3:
        raise DataError(f"registration wants frames (N, height, width), not {tuple(frames.shape)}")
    if model not in PARAMETERS:
        raise DataError(f"motion model '{model}' is not known; {nearest(model, PARAMETERS)}")
    if ignore is not None and ignore.shape != frames.shape[1:]:
        raise DataError(
            f"the bad-pixel mask is {tuple(ignore.shape)}, the frames are {tuple(frames.shape[1:])}"
        )


def search(level: Level, model: str) -> tuple[Tensor, Tensor]:
    """The best start `(N, 3, 3)` of every frame against frame 0, and its correlation `(N,)`."""
    starts = guesses(level.flat[0], level, model)
    found, score = best_of(starts, level.frames[0], level.weight, level, model)
    found[0] = torch.eye(3, dtype=torch.float64)
    return found, score


def retry(level: Level, motion: Tensor, score: Tensor, model: str) -> tuple[Tensor, Tensor]:
    """Frames that failed, again: from their neighbours' motions, and searched against the others' mean.

    The mean of the good frames sees more of the scene than frame 0 does, and the pattern is blurred in it.
    """
    score[0] = 1.0
    good = score > FAILED
    if good.all() or good.sum() < 2:
        return motion, score
    total, count, _, _ = scene(level, level.flat, motion, good.float()[:, None, None])
    starts = guesses(total / count.clamp_min(1), level, model)
    starts = torch.cat((starts, motion.roll(1, 0)[:, None], motion.roll(-1, 0)[:, None]), 1)
    total, count, _, _ = scene(level, level.frames, motion, good.float()[:, None, None])
    found, again = best_of(starts, total / count.clamp_min(1), (count > 0.5).float(), level, model)
    better = ~good & (again > score)
    return torch.where(better[:, None, None], found, motion), torch.where(better, again, score)


def best_of(
    starts: Tensor, reference: Tensor, seen: Tensor, level: Level, model: str
) -> tuple[Tensor, Tensor]:
    """Of starts `(N, keep, 3, 3)`, each frame's that correlates best once refined, and how well.

    What the pattern adds to the correlation is taken off.
    """
    n, keep = starts.shape[:2]
    frames = level.frames.repeat_interleave(keep, 0)
    rigid = "shift" if model == "shift" else "rigid"
    pair = reference.expand_as(frames), seen.expand_as(frames)
    found, score = refine(frames, *pair, level, starts.flatten(0, 1), rigid, 8)
    score = score - pattern_share(level).repeat_interleave(keep) * stillness(level, found)
    score, index = score.reshape(n, keep).max(1)
    return found.reshape(n, keep, 3, 3)[torch.arange(n), index], score


def stillness(level: Level, motion: Tensor) -> Tensor:
    """Share `(B,)` of a fixed pattern's correlation that a motion leaves: its band-passed autocorrelation."""
    points = level.points()
    moved = ((transform(motion, points) - points) / level.factor).square().sum(1)
    return torch.exp(-moved / (4 * level.fine**2)).mean(1)


def to_scene(level: Level, motion: Tensor, score: Tensor, model: str) -> tuple[Tensor, Tensor]:
    """Motions refined against the mean of the *other* frames, the fixed pattern taken out of all."""
    pattern = torch.zeros_like(level.weight)
    for _ in range(ROUNDS):
        good = (score > FAILED).float()[:, None, None]
        for _ in range(PATTERN_STEPS):
            total, count, _, _ = scene(level, level.frames - pattern, motion, good)
            picture = total / count.clamp_min(1e-3)
            pattern = pattern + fixed_pattern(level, level.frames - pattern, picture, motion, good)
        clean = (level.frames - pattern) * level.weight
        total, count, warped, valid = scene(level, clean, motion, good)
        others = count - good * valid
        references = (total - good * warped) / others.clamp_min(1e-3)
        found, score = refine(clean, references, (others > 0.5).float(), level, motion, model, 5)
        found = part_way(motion, normalised(torch.linalg.inv(found[:1]) @ found), model)
        step = (transform(found, level.points()) - transform(motion, level.points())).abs().mean()
        motion = found
        if step < SETTLED * level.factor:
            break
    return motion, score


def part_way(motion: Tensor, found: Tensor, model: str) -> Tensor:
    """Motions `(N, 3, 3)` moved by `1 - 1 / N` of the way to those found.

    Each frame is moved onto the mean of the others at once: a relative error comes back as `-1 / (N - 1)` of
    itself: for two frames it would change sign for ever. This share of the way ends it.
    """
    blend = motion + (1 - 1 / len(motion)) * (found - motion)
    if model == "rigid":
        angle = torch.atan2(blend[:, 1, 0] - blend[:, 0, 1], blend[:, 0, 0] + blend[:, 1, 1])
        blend[:, :2, :2] = rotation(angle)[:, :2, :2]
    return blend


def scene(
    level: Level, frames: Tensor, motion: Tensor, good: Tensor
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Frames pulled back to frame 0's grid: sum, count `(h, w)`, each warped frame, its validity."""
    h, w = level.weight.shape
    points = transform(torch.linalg.inv(motion), level.points())
    weights = level.weight.expand(len(frames), h, w)
    warped, known = sample(torch.stack((frames, weights), 1), points, level).reshape(-1, 2, h, w).unbind(1)
    valid = (known > 0.95).float()
    warped = warped * valid
    return (good * warped).sum(0), (good * valid).sum(0), warped, valid


def fixed_pattern(level: Level, frames: Tensor, picture: Tensor, motion: Tensor, good: Tensor) -> Tensor:
    """What stands still `(h, w)` and is not the scene: lines, and pixels as far as they are clear.

    A line is known from many pixels. The pixels' part, a mean over n frames, is shrunk by its share above the
    n-th part of the residual's variance (James & Stein 1961): two frames with a free pattern for each pixel
    would fit any motion.
    """
    h, w = level.weight.shape
    known = (picture != 0).float()
    stack = torch.stack((picture, known)).expand(len(frames), 2, h, w)
    expected, seen = sample(stack, transform(motion, level.points()), level).reshape(-1, 2, h, w).unbind(1)
    weight = good * (seen > 0.95) * level.weight
    residual = weight * (frames - expected)
    count = weight.sum(0).clamp_min(1)
    mean = residual.sum(0) / count
    lines = mean.mean(0, keepdim=True) + mean.mean(1, keepdim=True) - mean.mean()
    pixels = (mean - lines) * (weight.sum(0) > 0)
    chance = (residual - weight * lines).square().sum(0) / count**2
    keep = (1 - chance.mean() / pixels.square().mean().clamp_min(1e-12)).clamp(0, 1)
    return lines + keep * pixels


def verdict(motion: Tensor, score: Tensor) -> Registration:
    """Confidence and messages; frames that fail are left out by name."""
    confidence = score.clamp(0, 1)
    confidence[0] = 1.0
    motion[0] = torch.eye(3, dtype=torch.float64)
    used = confidence >= FAILED
    messages = [
        f"frame {k} does not register (confidence {float(confidence[k]):.2f}): left out"
        for k in range(len(used))
        if not used[k]
    ]
    motion = torch.where(used[:, None, None], motion, torch.nan)
    return Registration(motion, confidence, used, messages)
