"""The penalty `foe`."""

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

from deepir.arrays.differences import squared_gradient
from deepir.estimation.spatial_weights import smoothness_exponent, weight_from_gradients
from deepir.operators.bspline import to_pixels
from deepir.priors.penalties.foe import Experts, foe_energy
from deepir.registry import register
from deepir.simulate.scenes import procedural, sky
from deepir.training.training import Training

#: Of scikit-image, among those that constants are tuned on; never what is judged by.
PHOTOGRAPHS = ("camera", "astronaut", "gravel")
FIRST, SCENES, SKIES, SHAPE = 1000, 12, 4, (432, 540)  # seeds of the drawn scenes, and their px
COUNT, FRAME, MARGIN = 10, 40, 4  # bursts of an iteration, px of their frames and of the scene around them
FINER = (2, 5)  # times: a picture's px in one of a frame; from, below
BLUR = (0.4, 0.6)  # px: standard deviation of the optics
FRAMES = (3, 5, 10)  # of a burst
NOISE = (0.0005, 0.03)  # of a picture's range, in the frames' mean; each factor equally often
SHIFT = 2  # px, at most
ROUNDING = 0.09
STEPS = 40  # of L-BFGS to the minimum, and fifteen to a start
PRODUCTS = 25  # of conjugate gradients: more follow what is not quite convex
SPLINE = BSpline.basis_element(range(-2, 3), extrapolate=False)
WEAK = 0.05 / 1.6  # of total variation, while it is asked how plain a scene is


class Bursts(NamedTuple):
    """Of B scenes N frames each, in standard deviations of the noise that a coefficient of the scene has."""

    frames: Tensor  # (B, N, h, w)
    truth: Tensor  # (B, h, w): the first without noise
    rows: Tensor  # (B, N, h, H): the spline's weights at the rows that a frame looks at
    columns: Tensor  # (B, N, w, W)

    def misfit(self, scene: Tensor) -> Tensor:
        """Of scenes (B, H, W), in nats: a frame's noise is `sqrt(N / 12)`."""
        apart = self.rows @ scene[:, None] @ self.columns.mT - self.frames
        return 6 / self.frames.shape[1] * apart.square().sum()


@register("training", "foe")
class FieldsOfExperts(Training):
    """Jittered frames of blurred pictures, and their likeliest scene under the penalty: how far it is off."""

    iterations = 1000
    rate = 3e-2

    def __init__(self, rng: np.random.Generator) -> None:
        super().__init__(rng)
        self.noise = torch.Generator().manual_seed(int(rng.integers(2**31)))
        drawn = [procedural(FIRST + i, SHAPE) for i in range(SCENES)]
        skies = [sky(FIRST + i, SHAPE) for i in range(SKIES)]
        self.pictures = [torch.from_numpy(each).float() for each in 4 * _photographs() + drawn + skies]

    def network(self) -> nn.Module:
        """Filters and their weights."""
        return Experts()

    def loss(self, network: nn.Module) -> Tensor:
        """The mean square error in logarithms; its slope is that of the minimum, by the implicit function theorem."""
        with torch.autocast("cpu", enabled=False):
            bursts = self._bursts()
            scene, share = self._weakly_held(bursts)
            filters, costs, tails = network()

            def objective(scene: Tensor) -> Tensor:
                return bursts.misfit(scene) + foe_energy(scene, share, filters, costs, tails, ROUNDING)

            scene = _minimum(objective, scene, STEPS).requires_grad_()
            inside = slice(MARGIN, -MARGIN)
            shown = to_pixels(scene[:, None])[:, 0, inside, inside]
            error = (shown - bursts.truth).square().mean((1, 2)).log10().mean()
            (wanted,) = torch.autograd.grad(error, scene)
            (slope,) = torch.autograd.grad(objective(scene), scene, create_graph=True)
            moved = -(slope * _solved(slope, scene, wanted)).sum()
            return 10 * (error.detach() + moved - moved.detach())

    def _bursts(self) -> Bursts:
        count = int(self.rng.choice(FRAMES))
        frames, truth, rows, columns = zip(*(self._burst(count) for _ in range(COUNT)), strict=True)
        return Bursts(*(torch.stack(each) for each in (frames, truth, rows, columns)))

    def _burst(self, count: int) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        picture, times = self._picture()
        shifts = self.rng.integers(-SHIFT * times, SHIFT * times + 1, (count, 2))
        shifts[0] = 0
        low, high = (math.log(each) for each in NOISE)
        sigma = math.sqrt(12) * math.exp(self.rng.uniform(low, high))
        cut = [self._frame(picture, times, *(int(each) for each in shift)) for shift in shifts]
        frames = torch.stack(cut) / sigma
        noise = math.sqrt(count / 12) * torch.randn(frames.shape, generator=self.noise)
        y, x = torch.from_numpy(shifts / times).float().T
        return frames + noise, frames[0], _spline(y), _spline(x)

    def _picture(self) -> tuple[Tensor, int]:
        """A piece of a picture as the optics show it, and its px in one of a frame."""
        whole = self.pictures[self.rng.integers(len(self.pictures))]
        times = int(self.rng.integers(*FINER))
        side = times * (FRAME + 2 * MARGIN)
        y, x = (int(self.rng.integers(length - side + 1)) for length in whole.shape)
        piece = whole[y : y + side, x : x + side].rot90(int(self.rng.integers(4)))
        if self.rng.integers(2):
            piece = piece.T
        if self.rng.integers(2):
            piece = 1 - piece
        return torch.from_numpy(gaussian_filter(piece.numpy(), times * self.rng.uniform(*BLUR))), times

    @staticmethod
    def _frame(picture: Tensor, times: int, y: int, x: int) -> Tensor:
        y, x, side = y + times * MARGIN, x + times * MARGIN, times * FRAME
        return F.avg_pool2d(picture[None, y : y + side, x : x + side], times)[0]

    @torch.no_grad()
    def _weakly_held(self, bursts: Bursts) -> tuple[Tensor, Tensor]:
        """Scenes under next to no prior, and how strongly each place of them is to be held."""
        start = F.pad(bursts.frames[:, 0], (MARGIN,) * 4, mode="replicate")

        def weak(scene: Tensor) -> Tensor:
            length = (squared_gradient(scene) + ROUNDING**2).sqrt().sum()
            return bursts.misfit(scene) + WEAK * length

        scene = _minimum(weak, start, 15)
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
    """`H⁻¹ wanted` of the objective's second derivatives, of each scene, by conjugate gradients."""

    def dot(a: Tensor, b: Tensor) -> Tensor:
        return (a * b).sum((1, 2), keepdim=True)

    found, rest, step = torch.zeros_like(wanted), wanted, wanted
    for _ in range(PRODUCTS):
        (across,) = torch.autograd.grad(slope, scene, step, retain_graph=True)
        bent = dot(step, across)
        # Along what does not bend up nothing is gained.
        share = torch.where(bent > 0, dot(rest, rest) / bent, 0)
        found, new = found + share * step, rest - share * across
        rest, step = new, new + dot(new, new) / dot(rest, rest).clamp(min=1e-30) * step
    return found


def _spline(shifts: Tensor) -> Tensor:
    """Weights (..., h, H) of cubic B-splines along a scene at a frame's pixels, moved by `shifts` (...)."""
    places = torch.arange(FRAME)[:, None] + MARGIN + shifts[..., None, None]
    away = places - torch.arange(FRAME + 2 * MARGIN)
    return torch.from_numpy(np.nan_to_num(SPLINE(away.numpy()))).float()


def _photographs() -> list[np.ndarray]:
    import skimage.data
    from skimage.color import rgb2gray

    found = []
    for name in PHOTOGRAPHS:
        picture = getattr(skimage.data, name)()
        picture = rgb2gray(picture) if picture.ndim == 3 else picture.astype(float)
        found.append((picture - picture.min()) / (picture.max() - picture.min()))
    return found
