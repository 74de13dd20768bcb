"""Gain and offset in closed form, given the flux on the detector.

Variable projection (Golub and Pereyra 1973).

With the flux `z_k` fixed, `y_k = gain * z_k + offset + level_k + noise` is linear in gain and offset, and
their parts are Gaussian: the optimum solves one symmetric system, 2 x 2 (gain, offset) at each pixel. Pixel
parts are eliminated from it exactly, then columns; what remains couples the rows, and is solved by conjugate
gradients. It has to be *exact*: with an approximation the objective is no longer a function of the scene, and
line searches fail.

By the envelope theorem the gradient of the eliminated objective in everything else is the partial gradient
with gain and offset held.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from deepir.priors.parts import Part

#: Relative residual at which conjugate gradients stop, and the most iterations they get.
TOLERANCE, MAX_ITERATIONS = 1e-12, 200
PIXEL, COLUMN, ROW = (), (-2,), (-1,)


@torch.no_grad()
def eliminate(
    flux: Tensor, data: Tensor, precision: Tensor, gain: Sequence[Part], offset: Sequence[Part]
) -> list[Tensor]:
    """Set the parts of gain and offset to their joint optimum.

    Args:
        flux: what falls on the detector, (N, 1, h, w), in the data's units.
        data: the frames less all that the parts do not explain (known gain times flux, known offset, level).
        precision: 1 / noise variance, same shape; zero where a sample does not count.
        gain: parts of the gain, at most one for each of columns, rows, pixels; none for a known gain.
        offset: parts of the offset, likewise.

    Returns:
        The posterior variance of each part's values, the gain's first, in the shape of the values. Couplings
        between columns, and between columns and rows, are left out of them.

    Raises:
        ValueError: Two parts are constant along the same axis, or one along others than columns or rows.
    """
    parts = [_by_axis(each) for each in (gain, offset)]
    sigma = {along: _sigmas(parts, along, flux.device) for along in (PIXEL, COLUMN, ROW)}
    pixels = _Pixels(*_normal_equations(flux, data, precision), sigma[PIXEL])
    columns = _Lines(0, sigma[COLUMN], pixels)
    rows = _Lines(1, sigma[ROW], pixels)
    _solve(columns, rows, pixels.system)
    pixels.finish(columns.spread() + rows.spread())
    solved: dict[tuple[int, ...], _Pixels | _Lines] = {PIXEL: pixels, COLUMN: columns, ROW: rows}
    # Flux that is not a number spreads to a column: the trial went too far, and what was found before stays.
    finite = bool(columns.white.isfinite().all())
    variances = []
    for i, mine in enumerate(parts):
        for along, part in mine.items():
            if finite:
                part.white.copy_(solved[along].white[i].reshape(part.white.shape))
            variance = part.sigma.square() * solved[along].variance(i)
            variances.append(variance.reshape(part.white.shape))
    return variances


@dataclass
class _Symmetric:
    """A 2 x 2 symmetric matrix, for (gain, offset), at each pixel (h, w) or at each column or row."""

    aa: Tensor
    ab: Tensor
    bb: Tensor

    def times(self, x: Tensor) -> Tensor:
        """Product with (2, ...) at each place."""
        return torch.stack((self.aa * x[0] + self.ab * x[1], self.ab * x[0] + self.bb * x[1]))

    def inverse(self) -> _Symmetric:
        det = self.aa * self.bb - self.ab.square()
        return _Symmetric(self.bb / det, -self.ab / det, self.aa / det)

    def sums(self, x: Tensor) -> Tensor:
        """Product with values of columns, (2, w), summed along each row of the map, (2, h)."""
        return torch.stack((self.aa @ x[0] + self.ab @ x[1], self.ab @ x[0] + self.bb @ x[1]))

    def transposed(self) -> _Symmetric:
        return _Symmetric(self.aa.T, self.ab.T, self.bb.T)


def _normal_equations(flux: Tensor, data: Tensor, precision: Tensor) -> tuple[_Symmetric, Tensor, Tensor]:
    """`A = Σ w [z² z; z 1]`, its determinant, and `s = Σ w y (z, 1)` at each pixel, in float64.

    Summed as `d = z - m`, m the first frame's flux: without the pedestal the sums keep their digits in the flux's
    own type, and the determinant, which is the same for d, does not cancel.
    """
    m = flux[0, 0]
    aa, ab, bb, sa, sb = flux.new_zeros(5, *m.shape)
    for z, y, w in zip(flux[:, 0], data[:, 0], precision[:, 0], strict=True):
        d = z - m
        wd = w * d
        aa.addcmul_(wd, d)
        ab += wd
        bb += w
        sa.addcmul_(wd, y)
        sb.addcmul_(w, y)
    m, aa, ab, bb, sa, sb = (each.double() for each in (m, aa, ab, bb, sa, sb))
    determinant = torch.addcmul(aa * bb, ab, ab, value=-1)
    shifted = torch.addcmul(ab, m, bb)
    whole = _Symmetric(aa.addcmul_(m, ab + shifted), shifted, bb)
    return whole, determinant, torch.stack((sa.addcmul_(m, sb), sb))


class _Pixels:
    """The normal equations `A x = s` with the pixel parts, of prior variance `V`, eliminated.

    What is left for the other parts is the system `(I + A V)^-1 A` with the right-hand side `(I + A V)^-1 s`;
    unlike `(A + V^-1)^-1` both are finite where V or A is zero (no pixel part, a dead pixel).
    """

    white: Tensor

    def __init__(self, a: _Symmetric, determinant: Tensor, s: Tensor, sigma: Tensor) -> None:
        self.sigma = sigma
        u, v = sigma.square().tolist()
        minus_ab = -a.ab
        aa, bb = torch.add(a.aa, determinant, alpha=v), torch.add(a.bb, determinant, alpha=u)
        scale = torch.add(1 + u * a.aa, bb, alpha=v).reciprocal_()
        self.system = _Symmetric(aa.mul_(scale), a.ab * scale, bb.mul_(scale))
        gain = torch.addcmul(s[0] * a.bb, s[1], minus_ab).mul_(v).add_(s[0])
        offset = torch.addcmul(s[1] * a.aa, s[0], minus_ab).mul_(u).add_(s[1])
        self.rhs = torch.stack((gain, offset)).mul_(scale)

    def finish(self, others: Tensor) -> None:
        """Set the white pixel values, given the sum of all other parts, (2, h, w)."""
        self.white = self.sigma[:, None, None] * (self.rhs - self.system.times(others))

    def variance(self, i: int) -> Tensor:
        """Posterior variance of the white values of gain (0) or offset (1)."""
        return 1 - self.sigma[i].square() * (self.system.bb if i else self.system.aa)


class _Lines:
    """All columns (`dim` 0) or all rows (1), in white coordinates: `value = sigma * white`, (2, lines)."""

    white: Tensor

    def __init__(self, dim: int, sigma: Tensor, pixels: _Pixels) -> None:
        self.dim, self.sigma = dim, sigma[:, None]
        s, t = sigma
        system = pixels.system
        self.block = _Symmetric(
            1 + s * s * system.aa.sum(dim), s * t * system.ab.sum(dim), 1 + t * t * system.bb.sum(dim)
        )
        self.inverse = self.block.inverse()
        self.rhs = self.sigma * pixels.rhs.sum(dim + 1)

    def spread(self) -> Tensor:
        """The values over the map, (2, 1, w) or (2, h, 1)."""
        return (self.sigma * self.white).unsqueeze(self.dim + 1)

    def variance(self, i: int) -> Tensor:
        """Posterior variance of the white values of gain (0) or offset (1)."""
        return self.inverse.bb if i else self.inverse.aa


def _solve(columns: _Lines, rows: _Lines, system: _Symmetric) -> None:
    """Set the white values of columns and rows: `[C K'; K R] [c; r] = rhs`, the columns eliminated.

    C and R are 2 x 2 blocks; K, dense, is never formed. Without a part, sigma is zero, and so is K.
    """
    transposed = system.transposed()

    def across(c: Tensor) -> Tensor:  # K c
        return rows.sigma * system.sums(columns.sigma * c)

    def down(r: Tensor) -> Tensor:  # K' r
        return columns.sigma * transposed.sums(rows.sigma * r)

    def schur(r: Tensor) -> Tensor:
        return rows.block.times(r) - across(columns.inverse.times(down(r)))

    rhs = rows.rhs - across(columns.inverse.times(columns.rhs))
    rows.white = _conjugate_gradients(schur, rows.inverse.times, rhs)
    columns.white = columns.inverse.times(columns.rhs - down(rows.white))


def _conjugate_gradients(
    apply: Callable[[Tensor], Tensor], precondition: Callable[[Tensor], Tensor], b: Tensor
) -> Tensor:
    """Solve `apply(x) = b` for a symmetric positive definite map (Hestenes and Stiefel 1952)."""
    x, r = torch.zeros_like(b), b.clone()
    p = z = precondition(r)
    rz = (r * z).sum()
    goal = TOLERANCE**2 * rz
    for _ in range(MAX_ITERATIONS):
        if not rz > goal:
            break
        q = apply(p)
        step = rz / (p * q).sum()
        x += step * p
        r -= step * q
        z = precondition(r)
        rz, old = (r * z).sum(), rz
        p = z + (rz / old) * p
    return x


def _by_axis(parts: Sequence[Part]) -> dict[tuple[int, ...], Part]:
    found = {part.along: part for part in parts}
    if len(found) < len(parts) or not found.keys() <= {PIXEL, COLUMN, ROW}:
        raise ValueError(
            f"no closed form for parts along {[part.along for part in parts]}: "
            f"at most one each of {PIXEL} (pixels), {COLUMN} (columns) and {ROW} (rows) has one"
        )
    return found


def _sigmas(
    parts: Sequence[dict[tuple[int, ...], Part]], along: tuple[int, ...], device: torch.device
) -> Tensor:
    """Prior standard deviations of (gain, offset) along an axis, float64; zero where there is no part."""
    zero = torch.zeros((), dtype=torch.float64, device=device)
    return torch.stack([each[along].sigma.double() if along in each else zero for each in parts])
