"""Training of the penalty `foe`."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import torch
import torch.nn.functional as F
from scipy.interpolate import BSpline
from scipy.ndimage import gaussian_filter
from torch import Tensor, nn

from deepir.arrays.windows import squared_gradient
from deepir.estimation.prior_weight import smoothness_exponent, weight_from_gradients
from deepir.operators.warp import to_pixels
from deepir.priors.penalties.foe import Experts, foe_energy
from deepir.registry import register
from deepir.simulate.scenes.procedural import load_picture, procedural, sky
from deepir.training.training import FIRST_SCENE_SEED, Training

#: Pictures of scikit-to_pixels on which constants are tuned; none of them is in a benchmark.
FOE_PHOTOGRAPHS = ("camera", "astronaut", "gravel")
DRAWN_COUNTS = {procedural: 12, sky: 4}  # drawn scenes by kind
SCENE_SHAPE = (432, 540)  # height and width of a drawn scene, px
BURSTS_PER_ITERATION = 10  # bursts of a gradient
FRAME_SIDE = 40  # px of a frame
SCENE_MARGIN = 4  # px of the scene around a frame
PICTURE_SCALES = (2, 5)  # picture px per frame px, from and below
BLUR_RANGE = (0.4, 0.6)  # standard deviations of the optics' blur, px of a frame
BURST_LENGTHS = (3, 5, 10)  # frames of a burst
NOISE_RANGE = (0.0005, 0.03)  # standard deviations of the frames' mean, in ranges of a picture; log-uniform
MAX_FRAME_SHIFT = 2  # px
PENALTY_SMOOTHING = 0.09  # smoothing of the experts at zero, in standard deviations of the noise
LBFGS_ITERATIONS = 40  # iterations to the minimum
CG_ITERATIONS = 25  # products of conjugate gradients; more follow directions that are not quite convex
START_ITERATIONS = 15  # iterations of L-BFGS to the start
CUBIC_BSPLINE = BSpline.basis_element(range(-2, 3), extrapolate=False)  # the cubic B-spline on [-2, 2]
START_TV_WEIGHT = 0.05 / 1.6  # weight of total variation at the start, while the scene's smoothness is measured


class Bursts(NamedTuple):
    """N frames of each of B scenes, in standard deviations of the noise of a coefficient of the scene."""

    frames: Tensor  # (B, N, h, w)
    truth: Tensor  # (B, h, w): the first without noise
    rows: Tensor  # (B, N, h, H): the spline's weights at the rows that a frame looks at
    columns: Tensor  # (B, N, w, W)

    def misfit(self, scene: Tensor) -> Tensor:
        """Negative log-likelihood of scenes (B, H, W), nats; the noise of a frame is `sqrt(N / 12)`."""
        apart = self.rows @ scene[:, None] @ self.columns.mT - self.frames
        return 6 / self.frames.shape[1] * apart.square().sum()


@register("training", "foe")
class FieldsOfExperts(Training):
    """Jittered frames of blurred pictures; the error of their MAP scene under the penalty."""

    iterations = 1000
    rate = 3e-2
    network = Experts

    def __init__(self, rng: np.random.Generator) -> None:
        super().__init__(rng)
        self.noise = torch.Generator().manual_seed(int(rng.integers(2**31)))
        photographs = [load_picture(name) for name in FOE_PHOTOGRAPHS]
        drawn = [draw(FIRST_SCENE_SEED + i, SCENE_SHAPE) for draw, count in DRAWN_COUNTS.items() for i in range(count)]
        self.scenes = [torch.from_numpy(each).float() for each in 4 * photographs + drawn]

    def loss(self, network: nn.Module) -> Tensor:
        """Mean logarithm of the square error; its gradient through the minimum is by the implicit function theorem."""
        with torch.autocast("cpu", enabled=False):
            bursts = self._bursts()
            scene, share = self._weakly_held(bursts)
            filters, costs, tails = network()

            def objective(scene: Tensor) -> Tensor:
                return bursts.misfit(scene) + foe_energy(scene, share, filters, costs, tails, PENALTY_SMOOTHING)

            scene = _minimum(objective, scene, LBFGS_ITERATIONS).requires_grad_()
            inside = slice(SCENE_MARGIN, -SCENE_MARGIN)
            shown = to_pixels(scene[:, None])[:, 0, inside, inside]
            error = (shown - bursts.truth).square().mean((1, 2)).log10().mean()
            (wanted,) = torch.autograd.grad(error, scene)
            (slope,) = torch.autograd.grad(objective(scene), scene, create_graph=True)
            moved = -(slope * _solved(slope, scene, wanted)).sum()
            return 10 * (error.detach() + moved - moved.detach())

    def _bursts(self) -> Bursts:
        count = int(self.rng.choice(BURST_LENGTHS))
        frames, truth, rows, columns = zip(*(self._burst(count) for _ in range(BURSTS_PER_ITERATION)), strict=True)
        return Bursts(*(torch.stack(each) for each in (frames, truth, rows, columns)))

    def _burst(self, count: int) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        picture, times = self._picture()
        shifts = self.rng.integers(-MAX_FRAME_SHIFT * times, MAX_FRAME_SHIFT * times + 1, (count, 2))
        shifts[0] = 0
        low, high = (math.log(each) for each in NOISE_RANGE)
        sigma = math.sqrt(12) * math.exp(self.rng.uniform(low, high))
        starts, side = (shifts + times * SCENE_MARGIN).tolist(), times * FRAME_SIDE
        cut = [F.avg_pool2d(picture[None, y : y + side, x : x + side], times)[0] for y, x in starts]
        frames = torch.stack(cut) / sigma
        noise = math.sqrt(count / 12) * torch.randn(frames.shape, generator=self.noise)
        y, x = torch.from_numpy(shifts / times).float().T
        return frames + noise, frames[0], _spline(y), _spline(x)

    def _picture(self) -> tuple[Tensor, int]:
        """A piece of a picture as the optics show it, and its px in one of a frame."""
        whole = self.scenes[self.rng.integers(len(self.scenes))]
        times = int(self.rng.integers(*PICTURE_SCALES))
        side = times * (FRAME_SIDE + 2 * SCENE_MARGIN)
        y, x = (int(self.rng.integers(length - side + 1)) for length in whole.shape)
        piece = whole[y : y + side, x : x + side].rot90(int(self.rng.integers(4)))
        if self.rng.integers(2):
            piece = piece.T
        if self.rng.integers(2):
            piece = 1 - piece
        return torch.from_numpy(gaussian_filter(piece.numpy(), times * self.rng.uniform(*BLUR_RANGE))), times

    @torch.no_grad()
    def _weakly_held(self, bursts: Bursts) -> tuple[Tensor, Tensor]:
        """Scenes under a weak prior, and the weight map of the penalty."""
        start = F.pad(bursts.frames[:, 0], (SCENE_MARGIN,) * 4, mode="replicate")

        def weak(scene: Tensor) -> Tensor:
            length = (squared_gradient(scene) + PENALTY_SMOOTHING**2).sqrt().sum()
            return bursts.misfit(scene) + START_TV_WEIGHT * length

        scene = _minimum(weak, start, START_ITERATIONS)
        # In standard deviations of a pixel's mean.
        gradient = math.sqrt(12) * squared_gradient(to_pixels(scene[:, None])[:, 0]).sqrt()
        return scene, torch.cat(
            [weight_from_gradients(each[None], smoothness_exponent(float(each.mean()))) for each in gradient]
        )


def _minimum(objective: Callable[[Tensor], Tensor], start: Tensor, iterations: int) -> Tensor:
    scene = start.clone().requires_grad_()
    steps: Any = torch.optim.LBFGS(
        [scene], max_iter=iterations, history_size=10, line_search_fn="strong_wolfe", tolerance_change=0
    )

    def closure() -> Tensor:
        value = objective(scene)
        (scene.grad,) = torch.autograd.grad(value, scene)
        return value

    with torch.enable_grad():
        steps.step(closure)
    return scene.detach()


def _solved(slope: Tensor, scene: Tensor, wanted: Tensor) -> Tensor:
    """`H⁻¹ wanted` of the second derivatives of each scene, by conjugate gradients."""

    def dot(a: Tensor, b: Tensor) -> Tensor:
        return (a * b).sum((1, 2), keepdim=True)

    found, rest, step = torch.zeros_like(wanted), wanted, wanted
    for _ in range(CG_ITERATIONS):
        (across,) = torch.autograd.grad(slope, scene, step, retain_graph=True)
        bent = dot(step, across)
        # Along what does not bend up nothing is gained.
        share = torch.where(bent > 0, dot(rest, rest) / bent, 0)
        found, new = found + share * step, rest - share * across
        rest, step = new, new + dot(new, new) / dot(rest, rest).clamp(min=1e-30) * step
    return found


def _spline(shifts: Tensor) -> Tensor:
    """Weights (..., h, H) of cubic B-splines along a scene at a frame's pixels, moved by `shifts` (...)."""
    places = torch.arange(FRAME_SIDE)[:, None] + SCENE_MARGIN + shifts[..., None, None]
    away = places - torch.arange(FRAME_SIDE + 2 * SCENE_MARGIN)
    return torch.from_numpy(np.nan_to_num(CUBIC_BSPLINE(away.numpy()))).float()
