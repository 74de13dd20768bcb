"""What a model that does not fit has missed: score tests of the residuals, one for each cause.

To first order a cause adds known images to the samples: a displacement adds the scene's gradient, a blur its second
derivatives, a lag the difference to the frame before. The residuals of a solve are regressed on these images, frame by
frame and, where a cause differs over the frame, cell by cell. Half the drop of the sum of squares, less the price of
the coefficients by the Bayesian information criterion, is the log-likelihood ratio (Rao 1948, Schwarz 1978).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from deepir.arrays import Array
from deepir.messages import Message

MIN_MISFIT = 0.012  # evidence from which a cause of a misfit is named, nats a sample; without one it is 0.006 at most
RESIDUAL_CLIP_SIGMAS = 3.0  # residual at which samples are clipped, noise standard deviations
#: Cells along each side of a frame, and bands of rows, of what changes smoothly over it.
CELLS, BANDS = 6, 24
COLUMNS = 160  # of wider frames, about as many are enough

CAUSES = (
    Message(
        "rows-displaced",
        "the rows of a frame are displaced against each other, as by vibration while a frame is read out (rolling "
        "shutter), which blurs the scene. Hold the camera more firmly, or move it more slowly",
    ),
    Message(
        "interlaced-frames",
        "the frames are interlaced: their odd rows are of another time than their even ones, which is not modelled. "
        "Record progressive frames, or keep every second row: frames[:, ::2]",
    ),
    Message(
        "subpage-frames",
        "the pixels of a frame are of two times, as on a chessboard (sub-pages), and the camera moves between the two. "
        "Move it more slowly, or let it rest before each frame",
    ),
    Message("torn-frames", "torn frame(s), of two times above and below a row. Leave them out by data.frames"),
    Message(
        "unsharp-frames",
        "some frames are less sharp than the others, by focus or by motion, and make the scene softer. Leave them out "
        "by data.frames",
    ),
    Message(
        "thermal-lag",
        "the frames trail: each shows some of the one before it still, as slow pixels do (thermal lag). Move the "
        "camera more slowly, or let it rest before each frame; where it moves evenly, `deepir run deblur_lag "
        "data.fps=...` removes the lag",
    ),
    Message(
        "frames-bend",
        "the frames stretch or bend against each other (zoom, tilt), which rigid motion does not follow. Set "
        "`physics.warp.motion.type=auto`",
    ),
    Message(
        "parallax",
        "parts of the frames move by different amounts, as near and far objects do (parallax). Use `deepir run flow`",
    ),
    Message(
        "shading-changes",
        "something smooth changes from frame to frame, as clouds, stray flux or a housing that warms: the scene is "
        "uncertain by as much. Take the frames faster",
    ),
)


def misfit(
    residual: Array, precision: Array, whole: Array, flux: Array, gain: Array, among: Sequence[Message] = CAUSES
) -> tuple[Message, float, list[int]]:
    """The cause that explains most of the residuals.

    Args:
        residual: Data less prediction, (N, h, w).
        precision: Inverse noise variance, (N, h, w); zero where a sample does not count.
        whole: The same with the samples that were given up as moving.
        flux: On the detector, (N, h, w).
        gain: Of the pixels, (1, h, w) or (N, h, w).
        among: The causes that are asked for.

    Returns:
        Its message, its evidence in nats a sample (none of frames below 24 px), and the frames that show it most.
    """
    if min(residual.shape[1:]) < BANDS:
        return among[0], 0.0, []
    found = causes(residual, precision, whole, flux, gain)
    message = max(among, key=lambda each: float(found[each.name].sum()))
    nats = found[message.name]
    return message, float(nats.sum()), np.flatnonzero(4 * nats > nats.max()).tolist()


def causes(residual: Array, precision: Array, whole: Array, flux: Array, gain: Array) -> dict[str, Array]:
    """Evidence of each cause: name of its message, and nats of each frame (N,) over the number of all samples."""
    before, after = -np.diff(flux, axis=0, prepend=flux[:1]), np.diff(flux, axis=0, append=flux[-1:])
    derivatives = [_along(flux, axis, taps) for taps in ((-0.5, 0, 0.5), (1, -2, 1)) for axis in (1, 2)]
    derivatives.append(_along(derivatives[0], 2, (-0.5, 0, 0.5)))
    some = np.s_[..., :: flux.shape[2] // COLUMNS // 2 * 2 + 1]  # an odd step: a chessboard stays one
    y, x = ((2 * np.arange(side, dtype=np.float32) - side + 1) / max(flux.shape[1:]) for side in flux.shape[1:])
    residual, precision, whole, flux, gain, before, after, *derivatives = (
        each[some] for each in (residual, precision, whole, flux, gain, before, after, *derivatives)
    )
    weight, white = _whitened(residual, whole, flux * gain)
    torn = np.maximum(*(_torn(change * gain * weight, white) for change in (before, after)))
    weight, white = _whitened(residual, precision, flux * gain)
    response = gain * weight
    slope, curvature = ([each * response for each in part] for part in (derivatives[:2], derivatives[2:]))
    height, width = white.shape[1:]
    rows = (np.arange(height, dtype=np.float32) % 2 * 2 - 1)[:, None]
    chessboard = rows * (np.arange(width, dtype=np.float32) % 2 * 2 - 1)
    found = {
        "torn-frames": torn - np.median(torn),  # in a few frames: in all of them it is a lag
        "rows-displaced": np.maximum(*(_nats(slope, white, (n, 1)) for n in (BANDS, height))),
        "interlaced-frames": _nats([each * rows for each in slope], white, (1, 1)),
        "subpage-frames": _nats([each * chessboard for each in slope], white, (1, 1)),
        "frames-bend": _bending(slope[0], slope[1], y[:, None], x[some], white),
        "parallax": _nats(slope, white, (CELLS, CELLS)),
        "shading-changes": _nats([weight], white, (CELLS, CELLS)),
        "unsharp-frames": _nats(curvature, white, (1, 1), softer=True),
        "thermal-lag": _nats([before * response], white, (1, 1)),
    }
    return {name: nats / max(1, np.count_nonzero(whole)) for name, nats in found.items()}


def _bending(down: Array, across: Array, y: Array, x: Array, white: Array) -> Array:
    """Evidence (N,) of motion by homographies over that by shift and turn, by slopes (N, h, w) at places y, x."""
    along_x, along_y, towards = x * down, y * across, y * down + x * across
    rigid = [down, across, along_x - along_y]
    bent = [*rigid, along_x, y * down, x * across, y * towards, x * towards]
    return _nats(bent, white, (1, 1)) - _nats(rigid, white, (1, 1))


def _whitened(residual: Array, precision: Array, shown: Array) -> tuple[Array, Array]:
    """Inverse standard deviation of the noise, and residuals in it, clipped and then of mean square one.

    Without what changes as the contrast of the images `shown` does: of a gain control's, a part may be left.
    """
    weight = np.sqrt(precision)
    weight[:, [0, -1]] = weight[:, :, [0, -1]] = 0  # where derivatives are not known
    white = (residual * weight).clip(-RESIDUAL_CLIP_SIGMAS, RESIDUAL_CLIP_SIGMAS)
    contrast = (shown - shown.mean((1, 2), keepdims=True)) * weight
    white -= contrast * ((contrast * white).sum((1, 2)) / (contrast**2).sum((1, 2)).clip(1e-12))[:, None, None]
    return weight, white / max(math.sqrt((white**2).sum() / max(1, int(np.count_nonzero(weight)))), 1e-30)


def _along(images: Array, axis: int, taps: tuple[float, float, float]) -> Array:
    """Images (N, h, w) filtered by three taps along an axis, zero at the edges."""
    found, images = np.zeros_like(images).swapaxes(axis, 1), images.swapaxes(axis, 1)
    first, second, third = taps
    found[:, 1:-1] = first * images[:, :-2] + second * images[:, 1:-1] + third * images[:, 2:]
    return found.swapaxes(axis, 1)


def _nats(images: Sequence[Array], white: Array, grid: tuple[int, int], *, softer: bool = False) -> Array:
    """Evidence (N,) of coefficients of images (N, h, w) in white residuals, free in each cell of a grid and each frame.

    `softer`: only of frames whose first two coefficients, of second derivatives, sum up to a blur.
    """
    starts = [np.arange(n) * side // n for n, side in zip(grid, white.shape[1:], strict=True)]

    def summed(image: Array) -> Array:
        rows = np.add.reduceat(image, starts[0], axis=1)
        return np.add.reduceat(rows, starts[1], axis=2, dtype=float).reshape(len(image), -1)

    score = np.stack([summed(image * white) for image in images], -1)  # (N, cells, p)
    normal = np.stack([np.stack([summed(one * other) for other in images], -1) for one in images], -1)
    scale = np.sqrt(np.einsum("...pp->...p", normal)).clip(1e-12)
    normal = normal / scale[..., :, None] / scale[..., None, :] + 1e-6 * np.eye(len(images))
    score = score / scale
    found = np.linalg.solve(normal, score[..., None])[..., 0]
    drop = (found * score).sum((1, 2))
    if softer:
        drop = np.where((found / scale)[..., :2].sum((1, 2)) > 0, drop, 0.0)
    return np.asarray(drop - score[0].size * math.log(white[0].size)) / 2


def _torn(change: Array, white: Array) -> Array:
    """Evidence (N,) that the rows above or below one of them show another frame; change (N, h, w) to that."""
    rows = np.stack([(change * white).sum(2), (change**2).sum(2)]).astype(float)
    margin = white.shape[1] // 8
    above = rows.cumsum(2)[..., margin:-margin]
    parts = np.concatenate([above, rows.sum(2, keepdims=True) - above], axis=2)
    drop = parts[0].clip(0) ** 2 / parts[1].clip(1e-12)
    return np.asarray(drop.max(1) / 2 - math.log(white[0].size) / 2 - math.log(4 * white.shape[1]))
