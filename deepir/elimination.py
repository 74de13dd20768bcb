"""Gain and offset in closed form, given the flux on the detector (variable projection, Golub and Pereyra 1973).

With the flux `z_k` fixed, `y_k = gain * z_k + offset + level_k + noise` is linear in gain and offset, and their parts
are Gaussian: the optimum solves one symmetric system. Pixel parts are eliminated from it exactly, a 2 x 2 ridge for
each pixel; what remains couples columns and rows only, and is solved by conjugate gradients to float64 precision. It
has to be *exact*: with an approximation the objective is no longer a function of the scene, and line searches fail.

By the envelope theorem the gradient of the eliminated objective in everything else is the partial gradient with gain
and offset held.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from deepir.priors.parts import Part

#: Relative residual at which conjugate gradients stop, and the most iterations they get.
TOLERANCE, MAX_ITERATIONS = 1e-9, 200


@torch.no_grad()
def eliminate(
    flux: Tensor, data: Tensor, precision: Tensor, gain: Sequence[Part], offset: Sequence[Part]
) -> list[Tensor]:
    """Set the parts of gain and offset to their joint optimum.

    Args:
        flux: what falls on the detector, (N, 1, h, w), in the data's units.
        data: the frames less all that the parts do not explain (known gain times flux, known offset, level).
        precision: 1 / noise variance, same shape; zero where a sample does not count.
        gain: parts of the gain; may be empty (a known gain).
        offset: parts of the offset; may be empty.

    Returns:
        The posterior variance of each part's values, the gain's first, in the shape of the values. Couplings
        between columns, and between columns and rows, are left out of them.
    """
    z, y, w = flux.double(), data.double(), precision.double()
    wz = w * z
    normal = _Symmetric((wz * z).sum(0), wz.sum(0), w.sum(0))
    rhs = torch.stack(((wz * y).sum(0), (w * y).sum(0)))

    pixel = _sigmas(gain, offset, along=())
    pixel_system = _PixelSystem(normal, pixel.square())
    axes = sorted({part.along for part in (*gain, *offset) if part.along})
    coarse = [_Axis(along, _sigmas(gain, offset, along), pixel_system.reduced) for along in axes]
    white = _conjugate_gradients(pixel_system.reduced, coarse, pixel_system.solve(rhs))
    rest = rhs - normal.times(_expand(coarse, white, rhs))
    values = {axis.along: axis.sigma * x for axis, x in zip(coarse, white, strict=True)}
    values[()] = pixel.square()[:, None, None, None] * pixel_system.solve(rest)
    variances = {axis.along: axis.variance() for axis in coarse} | {(): pixel_system.variance()}

    for i, parts in enumerate((gain, offset)):
        for part in parts:
            part.assign(values[part.along][i].reshape(part.white.shape))
    return [
        variances[part.along][i].reshape(part.white.shape)
        for i, parts in enumerate((gain, offset))
        for part in parts
    ]


@dataclass
class _Symmetric:
    """A 2 x 2 symmetric matrix, for (gain, offset), at each pixel of a map or at each column or row."""

    aa: Tensor
    ab: Tensor
    bb: Tensor

    def times(self, x: Tensor) -> Tensor:
        return torch.stack((self.aa * x[0] + self.ab * x[1], self.ab * x[0] + self.bb * x[1]))

    def determinant(self) -> Tensor:
        return self.aa * self.bb - self.ab.square()


class _PixelSystem:
    """The normal equations `A` with the pixel parts, of prior variance `V`, eliminated.

    What is left for the other parts is `(I + A V)^-1 A`, and `(I + A V)^-1 s` for a right-hand side `s`; unlike
    `(A + V^-1)^-1` both are finite where V or A is zero (no pixel part, a dead pixel).
    """

    def __init__(self, a: _Symmetric, variance: Tensor) -> None:
        u, v = self.prior = variance
        rest = a.determinant()
        self.a = a
        self.det = 1 + a.aa * u + a.bb * v + rest * u * v
        self.reduced = _Symmetric((a.aa + v * rest) / self.det, a.ab / self.det, (a.bb + u * rest) / self.det)

    def solve(self, s: Tensor) -> Tensor:
        u, v = self.prior
        gain = (1 + self.a.bb * v) * s[0] - self.a.ab * v * s[1]
        offset = (1 + self.a.aa * u) * s[1] - self.a.ab * u * s[0]
        return torch.stack((gain, offset)) / self.det

    def variance(self) -> Tensor:
        """Diagonal of the posterior covariance, `V - V R V`."""
        u, v = self.prior
        return torch.stack((u - u * u * self.reduced.aa, v - v * v * self.reduced.bb))


class _Axis:
    """The parts that are constant along one axis, in white coordinates: `value = sigma * white`."""

    def __init__(self, along: tuple[int, ...], sigma: Tensor, system: _Symmetric) -> None:
        self.along, self.sigma = along, sigma[:, None, None, None]
        s, t = sigma
        self.block = _Symmetric(
            1 + s * s * system.aa.sum(along, keepdim=True),
            s * t * system.ab.sum(along, keepdim=True),
            1 + t * t * system.bb.sum(along, keepdim=True),
        )

    def gather(self, maps: Tensor) -> Tensor:
        return self.sigma * maps.sum(self.along, keepdim=True)

    def precondition(self, x: Tensor) -> Tensor:
        inverse = _Symmetric(self.block.bb, -self.block.ab, self.block.aa)
        return inverse.times(x) / self.block.determinant()

    def variance(self) -> Tensor:
        diagonal = torch.stack((self.block.bb, self.block.aa)) / self.block.determinant()
        return self.sigma.square() * diagonal


def _conjugate_gradients(system: _Symmetric, axes: list[_Axis], rhs: Tensor) -> list[Tensor]:
    """Solve `(I + S E' R E S) x = S E' rhs`, S = sigmas, E = spreading columns and rows over the map.

    The preconditioner is the 2 x 2 block of each column and row: only the coupling of columns with rows is left to
    the iterations.
    """
    b = [axis.gather(rhs) for axis in axes]
    x = [torch.zeros_like(part) for part in b]
    r, z = b, [axis.precondition(part) for axis, part in zip(axes, b, strict=True)]
    p, rz = z, _dot(b, z)
    goal = TOLERANCE**2 * rz
    for _ in range(MAX_ITERATIONS):
        if not rz > goal:
            break
        maps = system.times(_expand(axes, p, rhs))
        q = [part + axis.gather(maps) for axis, part in zip(axes, p, strict=True)]
        step = rz / _dot(p, q)
        x = [a + step * d for a, d in zip(x, p, strict=True)]
        r = [a - step * d for a, d in zip(r, q, strict=True)]
        z = [axis.precondition(part) for axis, part in zip(axes, r, strict=True)]
        rz, old = _dot(r, z), rz
        p = [a + (rz / old) * d for a, d in zip(z, p, strict=True)]
    return x


def _expand(axes: list[_Axis], white: list[Tensor], like: Tensor) -> Tensor:
    maps = torch.zeros_like(like)
    for axis, x in zip(axes, white, strict=True):
        maps += axis.sigma * x
    return maps


def _dot(a: list[Tensor], b: list[Tensor]) -> Tensor:
    return sum((torch.dot(u.flatten(), v.flatten()) for u, v in zip(a, b, strict=True)), torch.zeros((), dtype=torch.float64))


def _sigmas(gain: Sequence[Part], offset: Sequence[Part], along: tuple[int, ...]) -> Tensor:
    """Prior standard deviation of (gain, offset) for the parts constant along `along`; zero where there is none."""
    found = [[part.sigma.square() for part in parts if part.along == along] for parts in (gain, offset)]
    return torch.stack([torch.stack(each).sum() if each else torch.zeros((), dtype=torch.float64) for each in found]).sqrt()
