"""Camera motion: the scene seen from each frame."""

from __future__ import annotations

import math
from typing import ClassVar

import torch
from scipy.fft import next_fast_len
from torch import Tensor

from deepir.kernels.threads import MIN_DEPTH, is_compiled
from deepir.operators.base import Operator, Shape, Trajectory
from deepir.operators.bspline import MIN_CANVAS_SIDE, NOISE_GAIN, SplineWarp, sample, to_pixels, warp_adjoint
from deepir.registry import register

#: Largest entry of a motion: beyond, coordinates overflow in float32.
MAX_ENTRY = 1e6
#: Width of the canvas beyond the footprints of the frames, px.
CANVAS_MARGIN = 8
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


def footprint(motion: Tensor | None, size: tuple[int, int], ratio: float) -> tuple[tuple[int, int], tuple[int, int]]:
    """Canvas that contains the footprints of all frames, with a margin.

    Args:
        motion: (N, 3, 3) homographies, detector px, or (N, h, w, 2) points; None for one frame at rest.
        size: (h, w) of a frame, scene px.
        ratio: Scene px per detector px.

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


def rescale_motion(motion: Tensor, ratio: float) -> Tensor:
    """Homographies in px of a grid that is `ratio` times finer, with the same centre."""
    s = torch.tensor([ratio, ratio, 1.0], dtype=motion.dtype)
    return motion * (s[:, None] / s)
