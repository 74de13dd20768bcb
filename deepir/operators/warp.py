"""Camera motion: the scene, a cubic B-spline, seen from each frame; by compiled loops on the CPU, by torch elsewhere.

Source: Unser, Aldroubi, Eden 1993, "B-spline signal processing".
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
import torch
import torch.nn.functional as F
from scipy.fft import next_fast_len
from torch import Tensor

from deepir.kernels import run
from deepir.kernels.threads import MIN_DEPTH, is_compiled
from deepir.operators.base import Operator, Shape, Trajectory
from deepir.registry import register

MIN_CANVAS_SIDE = 4  # smallest side of a canvas, px: the support of a cubic spline
#: Standard deviation of a coefficient for white noise of one in the image, 12 ** 0.5: along an axis, the inverse of the
#: spline at the pixels, `(2 + cos w) / 3`, has the mean square 12 ** 0.5.
NOISE_GAIN = 12**0.5
MAX_ENTRY = 1e6  # largest entry of a motion: beyond, coordinates overflow in float32
CANVAS_MARGIN = 8  # width of the canvas beyond the footprints of the frames, px
EVERY_FRAME = Trajectory()
ALL_PIXELS = slice(None)


@register("operator", "warp")
class Warp(Operator):
    """The scene as the moved pixels of each frame see it, `frame_k(p) = scene(T_k p)`.

    The scene is continuous: `x`, (1, C, Hc, Wc) for all frames or (N, C, Hc, Wc), holds coefficients of a cubic
    B-spline. That is a quadratic spline, integrated over the area of a pixel. (With samples and bilinear interpolation
    instead, the frames' sharpness depends on where their pixels fall, which biases motion and scene alike.) `image`
    gives the samples at rest; the output is (N, C, h, w).

    The slot `motion` is (N, 3, 3), pull homographies in px with the origin at the frame's centre, or (N, h, w, 2), the
    point (x, y) that each pixel looks at, from the same origin. Beyond the outermost pixel but one of the canvas the
    scene is flat; `valid` is zero there.
    """

    canvas_from_frame: Tensor
    noise_gain = NOISE_GAIN
    moves = True
    example_shape = (1, 1, 11, 12)
    example_options: ClassVar = {"size": (6, 7), "canvas": (11, 12), "origin": (2, 3)}

    def __init__(
        self,
        size: tuple[int, int],
        canvas: tuple[int, int],
        origin: tuple[float, float],
        instants: Trajectory = EVERY_FRAME,
    ) -> None:
        """`size` = (h, w), `canvas` = (Hc, Wc), `origin` = canvas index (y, x) of frame 0's first pixel.

        The output is at `instants`, those of the frames unless a lag behind it wants more.

        Raises:
            ValueError: A side of the canvas is less than 4.
        """
        super().__init__()
        if min(canvas) < MIN_CANVAS_SIDE:
            raise ValueError(f"warp: the canvas {canvas} has a side of less than {MIN_CANVAS_SIDE} px")
        self.size, self.canvas, self.origin, self.instants = size, canvas, origin, instants
        # From the frame's centre to the canvas' centre.
        y, x = (o + (s - c) / 2 for o, s, c in zip(origin, size, canvas, strict=True))
        canvas_from_frame = torch.tensor([[1, 0, x], [0, 1, y], [0, 0, 1]], dtype=torch.float64)
        self.register_buffer("canvas_from_frame", canvas_from_frame, persistent=False)

    @classmethod
    def around(cls, motion: Tensor, size: tuple[int, int]) -> Warp:
        """One whose canvas holds all that frames see.

        Args:
            motion: (N, 3, 3) homographies in px of the output, frame 0's the identity; or (N, h, w, 2) points.
            size: (h, w) of a frame, px of the output.
        """
        canvas, origin = footprint(motion, size, 1.0)
        return cls(size, canvas, origin)

    def slots(self, x_shape: Shape, n_frames: int) -> dict[str, Shape]:
        """`motion`: (N, 3, 3), or points (N, h, w, 2)."""
        return {"motion": (n_frames, 3, 3)}

    def fits(self, slot: str, wanted: Shape, found: Shape) -> bool:
        """Homographies will do, and points."""
        return found in (wanted, (wanted[0], *self.size, 2))

    def out_shape(self, x_shape: Shape, n_frames: int) -> Shape:
        """(N, C, h, w), or as many instants."""
        return (self.instants.count(n_frames), x_shape[1], *self.size)

    def in_size(self, out_size: tuple[int, int]) -> tuple[int, int]:
        """The canvas."""
        return self.canvas

    def forward(self, x: Tensor, *, motion: Tensor) -> Tensor:  # type: ignore[override]
        """Sample the canvas at the moved pixel centres.

        Raises:
            ValueError: `x` has another size than the canvas.
        """
        if x.shape[-2:] != self.canvas:
            raise ValueError(f"warp: the canvas is {self.canvas}, but the scene {tuple(x.shape[-2:])}")
        return self._sample(x, self.instants.interpolate(motion))

    @torch.no_grad()
    def adjoint(self, y: Tensor, x_shape: Shape, *, motion: Tensor) -> Tensor:  # type: ignore[override]
        """On the CPU by a loop of its own."""
        if not is_compiled(y):
            return super().adjoint(y, x_shape, motion=motion)
        return warp_adjoint(y, self._kernel_motion(self.instants.interpolate(motion), y.dtype), x_shape)

    def _sample(self, x: Tensor, motion: Tensor) -> Tensor:
        if not is_compiled(x):
            return sample(x, self.sampling_points(motion).to(x.dtype))
        return SplineWarp.apply(x, self._kernel_motion(motion, x.dtype), self.size)

    def _kernel_motion(self, motion: Tensor, dtype: torch.dtype) -> Tensor:
        """Where the frames look, as the loops take it."""
        if motion.ndim == 4:
            return self.sampling_points(motion).to(dtype).permute(0, 3, 1, 2)
        return self.canvas_from_frame @ _without_nan(motion).double()

    def valid(self, mask: Tensor, *, motion: Tensor) -> Tensor:  # type: ignore[override]
        """Samples whose 16 coefficients are valid and in the canvas, to 1e-4 px."""
        reach = torch.tensor([(side - 3) / 2 + 1e-4 for side in reversed(self.canvas)], device=mask.device)
        motion = self.instants.interpolate(motion)
        if motion.ndim == 3 and self._corners_within(motion, reach) and bool((mask == 1).all()):
            return mask.new_ones(len(motion), mask.shape[1], *self.size)
        masks = mask.expand(len(motion), -1, -1, -1)
        # A frame at a time: the points take four times a frame's room.
        return torch.cat([self._valid(masks[k : k + 1], motion[k : k + 1], reach) for k in range(len(motion))])

    def _corners_within(self, motion: Tensor, reach: Tensor) -> bool:
        """Whether all points are in the canvas: straight lines stay straight, so that the frames' corners decide."""
        x, y = ((side - 1) / 2 for side in reversed(self.size))
        corners = torch.tensor([[-x, x, -x, x], [-y, -y, y, y], [1, 1, 1, 1]], dtype=torch.float64).to(motion)
        moved = self.canvas_from_frame.to(motion) @ _without_nan(motion) @ corners
        points = moved[:, :2] / moved[:, 2:]
        return bool((moved[:, 2] > MIN_DEPTH).all() and (points.abs() <= reach[:, None]).all())

    def _valid(self, mask: Tensor, motion: Tensor, reach: Tensor) -> Tensor:
        inside = (self.sampling_points(motion).abs() <= reach).all(-1)[:, None]
        return (inside & (self._sample(mask, motion) > 1 - 1e-4)).to(mask.dtype)

    def to_pixels(self, x: Tensor) -> Tensor:
        """The scene at the canvas' pixel centres."""
        return to_pixels(x)

    def sampling_points(self, motion: Tensor, rows: slice = ALL_PIXELS, columns: slice = ALL_PIXELS) -> Tensor:
        """Where each pixel looks, (N, h, w, 2), in px from the canvas' centre; or some `rows` and `columns` of them."""
        motion = _without_nan(motion)
        if motion.ndim == 4:
            return motion[:, rows, columns] + self.canvas_from_frame[:2, 2].to(motion)
        return project_pixels(self.canvas_from_frame @ motion.double(), self.size, rows, columns)

    @classmethod
    def example(cls) -> tuple[Operator, Tensor, dict[str, Tensor]]:
        """Three frames of 6 x 7 px on a canvas of 11 x 12, with motions of a px or so."""
        operator, x, slots = super().example()
        jitter = 0.05 * slots["motion"]
        jitter[:, :2, 2] *= 20
        jitter[:, 2] *= 0.02
        jitter[:, 2, 2] = 0
        return operator, x, slots | {"motion": torch.eye(3, dtype=torch.float64) + jitter}


def _without_nan(motion: Tensor) -> Tensor:
    """The motion without a NaN, which crashes grid_sample's backward pass on the CPU (torch 2.13).

    A line search can produce one, and must see a bad loss instead.
    """
    return motion.nan_to_num(nan=MAX_ENTRY).clamp(-MAX_ENTRY, MAX_ENTRY)


class SplineWarp(torch.autograd.Function):
    """Warp of spline coefficients `scene` (1 or N, C, Hc, Wc) to frames (N, C, h, w), on the CPU.

    `motion`: homographies (N, 3, 3) float64, or sampling points (N, 2, h, w) as (x, y) in the type of the scene; px,
    from the centres of frame and canvas.
    """

    @staticmethod
    def forward(ctx: Any, scene: Tensor, motion: Tensor, size: tuple[int, int]) -> Tensor:
        """The frames.

        Raises:
            ValueError: As many scenes as neither one nor the frames.
        """
        if len(scene) not in (1, len(motion)):
            raise ValueError(f"warp: {len(scene)} scenes for {len(motion)} frames")
        scene, motion = scene.contiguous(), motion.contiguous()
        ctx.save_for_backward(scene, motion)
        out = scene.new_empty(len(motion), scene.shape[1], *size)
        run("bspline.warp", size[0], scene, motion, out)
        return out

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, Tensor | None, None]:
        """The gradients that are asked for; that in a homography is summed in float64."""
        scene, motion = ctx.saved_tensors
        gradient, to_scene, to_motion = gradient.contiguous(), None, None
        if ctx.needs_input_grad[0]:
            to_scene = warp_adjoint(gradient, motion, scene.shape)
        if ctx.needs_input_grad[1] and motion.ndim == 4:
            to_motion = torch.empty_like(motion)
            run("bspline.grad_displacement", gradient.shape[-2], gradient, scene, motion, to_motion)
        elif ctx.needs_input_grad[1]:
            height = gradient.shape[-2]
            sums = motion.new_zeros(len(motion), height, 3, 2)
            run("bspline.grad_homography", height, gradient, scene, motion, sums)
            y = torch.arange(height, dtype=motion.dtype) - (height - 1) / 2
            one, by_x = sums.unbind(-1)
            to_motion = torch.stack((by_x.sum(1), y @ one, one.sum(1)), -1)
        return to_scene, to_motion, None


def warp_adjoint(frames: Tensor, motion: Tensor, shape: Sequence[int]) -> Tensor:
    """Adjoint of `SplineWarp`: frames (N, C, h, w) scattered to coefficients of this shape."""
    scene = frames.new_zeros(shape)
    run("bspline.warp_adjoint", shape[-2], frames.contiguous(), motion.contiguous(), scene)
    return scene


def sample(scene: Tensor, points: Tensor) -> Tensor:
    """Values of the spline `scene` at `points` (N, h, w, 2), (x, y) px from the centre of the canvas.

    Four bilinear samples, at the centres of mass of the weights of four coefficients each, make one of the cubic
    spline (Sigg and Hadwiger 2005, "Fast third-order texture filtering").
    """
    sides = scene.shape[:-3:-1]
    (x, y) = (_bilinear_pairs(points[..., i], side) for i, side in enumerate(sides))
    scene = scene.expand(len(points), -1, -1, -1)
    total = torch.zeros((), dtype=scene.dtype, device=scene.device)
    for at_y, weight_y in y:
        for at_x, weight_x in x:
            grid = torch.stack([(2 * at + 1) / side - 1 for at, side in zip((at_x, at_y), sides, strict=True)], -1)
            found = F.grid_sample(scene, grid, mode="bilinear", padding_mode="border", align_corners=False)
            total = total + (weight_x * weight_y)[:, None] * found
    return total


def _bilinear_pairs(at: Tensor, side: int) -> list[tuple[Tensor, Tensor]]:
    """Along one axis, from the centre: where the first and the last two coefficients meet, and their weights."""
    at = (at + (side - 1) / 2).clamp(1, side - 2)
    second = at.detach().floor().clamp(max=side - 3)
    f = at - second
    first, third, last = (1 - f) ** 3 / 6, 2 / 3 - (1 - f) ** 2 * (1 + f) / 2, f**3 / 6
    low = first + 2 / 3 - f * f * (2 - f) / 2
    high = third + last
    return [(second - first / low, low), (second + 1 + last / high, high)]


def to_pixels(scene: Tensor) -> Tensor:
    """Values of the spline `scene` (S, C, Hc, Wc) at pixel centres, same shape."""
    along = torch.tensor([1.0, 4.0, 1.0], dtype=scene.dtype, device=scene.device) / 6
    padded = F.pad(scene, (1, 1, 1, 1), mode="replicate")
    channels = scene.shape[1]
    kernel = (along[:, None] * along).expand(channels, 1, 3, 3)
    return F.conv2d(padded, kernel, groups=channels)


def project_pixels(
    motion: Tensor, size: tuple[int, int], rows: slice = ALL_PIXELS, columns: slice = ALL_PIXELS
) -> Tensor:
    """The points `T_k p` of all pixel centres `p`, origin at the frame's centre; (N, 3, 3) -> (N, h, w, 2).

    In memory the planes of x and y follow each other: three times as fast as pairs, forth and back.
    """
    height, width = size
    y = torch.arange(height, dtype=motion.dtype, device=motion.device)[rows] - (height - 1) / 2
    x = torch.arange(width, dtype=motion.dtype, device=motion.device)[columns] - (width - 1) / 2
    t = motion[..., None, None]
    px, py, pz = (t[:, i, 0] * x + (t[:, i, 1] * y[:, None] + t[:, i, 2]) for i in range(3))
    nearness = pz.clamp(min=MIN_DEPTH).reciprocal()
    return torch.stack((px * nearness, py * nearness), 1).permute(0, 2, 3, 1)


def footprint(
    motion: Tensor | None, size: tuple[int, int], ratio: float | Sequence[float]
) -> tuple[tuple[int, int], tuple[int, int]]:
    """Canvas that contains the footprints of all frames, with a margin.

    Args:
        motion: (N, 3, 3) homographies, detector px, or (N, h, w, 2) points; None for one frame at rest.
        size: (h, w) of a frame, scene px.
        ratio: Scene px per detector px, down and across if they differ.

    Returns:
        Size (H, W) and origin (y, x) of frame 0, scene px.
    """
    if motion is None:
        motion = torch.eye(3, dtype=torch.float64)[None]
    y, x = ((side - 1) / 2 for side in size)
    if motion.ndim == 4:
        points = motion.double().flatten(1, 2).mT
    else:
        corners = torch.tensor([[-x, x, -x, x], [-y, -y, y, y], [1, 1, 1, 1]], dtype=torch.float64)
        moved = rescale_motion(motion, ratio).double() @ corners
        points = moved[:, :2] / moved[:, 2:].clamp(min=MIN_DEPTH)
    points = points + points.new_tensor([[x], [y]])
    low, high = points.amin((0, 2)), points.amax((0, 2))  # straight lines stay straight
    x0, y0 = (CANVAS_MARGIN + math.ceil(max(0.0, -float(v))) for v in low)
    x1, y1 = (CANVAS_MARGIN + math.ceil(max(float(v), side - 1)) for v, side in zip(high, reversed(size), strict=True))
    return (fast_fft_length(y0 + y1 + 1), fast_fft_length(x0 + x1 + 1)), (y0, x0)


def fast_fft_length(side: int) -> int:
    """An even length, a little more than `side`, whose Fourier transform is two or three times as fast."""
    return 2 * int(next_fast_len(-(-side // 2)))


def rescale_motion(motion: Tensor, ratio: float | Sequence[float]) -> Tensor:
    """Homographies in px of a grid that is `ratio` times finer, down and across if they differ; of the same centre."""
    down, across = np.broadcast_to(ratio, 2)
    s = torch.tensor([across, down, 1.0], dtype=motion.dtype)
    return motion * (s[:, None] / s)
