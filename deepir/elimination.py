"""Gain and offset in closed form, given the flux on the detector.

Variable projection (Golub and Pereyra 1973).

With the flux `z_k` fixed, `y_k = gain * z_k + offset + level_k + noise` is linear in gain and offset, and
their parts are Gaussian: the optimum solves one symmetric system, 2 x 2 (gain, offset) at each pixel. Pixel
parts are eliminated from it exactly, then columns, then the few terms of the shading; what remains couples the
rows, and is solved by conjugate gradients. It has to be *exact*: with an approximation the objective is no longer
a function of the scene, and line searches fail.

By the envelope theorem the gradient of the eliminated objective in everything else is the partial gradient
with gain and offset held.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from deepir.priors.parts import Part
from deepir.priors.shading import Shading

#: Relative residual at which conjugate gradients stop, and the most iterations they get.
TOLERANCE, MAX_ITERATIONS = 1e-12, 200
#: What tells parts apart: the axes along which they are constant; a shading is none of these.
Kind = tuple[int, ...] | None
PIXEL, COLUMN, ROW, SHADING = (), (-2,), (-1,), None


@torch.no_grad()
def eliminate(
    flux: Tensor, data: Tensor, precision: Tensor, gain: Sequence[Part], offset: Sequence[Part]
) -> list[Tensor]:
    """Set the parts of gain and offset to their joint optimum.

    Args:
        flux: what falls on the detector, (N, 1, h, w), in the data's units.
        data: the frames less all that the parts do not explain (known gain times flux, known offset, level).
        precision: 1 / noise variance, same shape; zero where a sample does not count.
        gain: parts of the gain, at most one each of columns, rows, shading, pixels; none for a known gain.
        offset: parts of the offset, likewise.

    Returns:
        The posterior variance of what each part's white values stand for, the gain's first, in their shape.
        Couplings between columns, and between rows and all others, are left out of them.

    Raises:
        ValueError: Two parts are of the same kind, or one is constant along others than columns or rows.
    """
    parts = [_by_kind(each) for each in (gain, offset)]
    sigma = {kind: _sigmas(parts, kind, flux.device) for kind in (PIXEL, COLUMN, ROW, SHADING)}
    pixels = _Pixels(*_normal_equations(flux, data, precision), sigma[PIXEL])
    columns = _Lines(0, sigma[COLUMN], pixels)
    rows = _Lines(1, sigma[ROW], pixels)
    smooth = _Smooth(_shading(parts, pixels.rhs), sigma[SHADING], pixels, columns, rows)
    _solve(columns, rows, smooth, pixels.system)
    pixels.finish(columns.spread() + rows.spread() + smooth.spread())
    solved: dict[Kind, _Pixels | _Lines | _Smooth]
    solved = {PIXEL: pixels, COLUMN: columns, ROW: rows, SHADING: smooth}
    # Flux that is not a number spreads to a column: the trial went too far, and what was found before stays.
    finite = bool(columns.white.isfinite().all())
    variances = []
    for i, mine in enumerate(parts):
        for kind, part in mine.items():
            if finite:
                part.white.copy_(solved[kind].white[i].reshape(part.white.shape))
            variance = part.sigma.square() * solved[kind].variance(i)
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

    Summed as `d = z - m`, m the first frame's flux: the determinant, which is the same for d, does not cancel.
    """
    frames = (flux[:, 0], data[:, 0], precision[:, 0])
    sums = (_sums_on_cpu if flux.device.type == "cpu" else _sums)(*frames)
    aa, ab, bb, determinant = sums[:4]
    return _Symmetric(aa, ab, bb), determinant, sums[4:]


def _sums(flux: Tensor, data: Tensor, precision: Tensor) -> Tensor:
    """In the flux's own type: without the pedestal the sums keep their digits."""
    m = flux[0]
    aa, ab, bb, sa, sb = flux.new_zeros(5, *m.shape)
    for z, y, w in zip(flux, data, precision, strict=True):
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
    return torch.stack((aa.addcmul_(m, ab + shifted), shifted, bb, determinant, sa.addcmul_(m, sb), sb))


def _sums_on_cpu(flux: Tensor, data: Tensor, precision: Tensor) -> Tensor:
    """The same in one pass over the frames."""
    from deepir.loops import spread
    from deepir.loops.normal_equations import normal_equations

    sums = torch.empty(6, *flux.shape[1:], dtype=torch.float64)
    frames = (each.flatten(1).contiguous() for each in (flux, data, precision))
    spread(normal_equations, flux[0].numel(), *frames, sums.flatten(1))
    return sums


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


class _Smooth:
    """The terms of the shading, in white coordinates: gain, then offset, none without a shading.

    Its system has the columns eliminated.
    """

    terms: Tensor

    def __init__(
        self, shading: Shading, sigma: Tensor, pixels: _Pixels, columns: _Lines, rows: _Lines
    ) -> None:
        self.shading, self.columns = shading, columns
        y, x = shading.factors()
        self.sigma = sigma.repeat_interleave(len(y))
        maps = (pixels.system.aa, pixels.system.ab, pixels.system.bb)
        # Couplings to the lines, (2, 2 terms, lines): the first axis is the line's gain and offset.
        self.to_columns = columns.sigma[:, None] * self._blocks([(y @ a) * x for a in maps])
        self.to_rows = rows.sigma[:, None] * self._blocks([(x @ a.T) * y for a in maps])
        system = self._blocks([shading.gram(a) for a in maps]).movedim(0, 1).flatten(1) * self.sigma
        system.diagonal().add_(1)
        solved = columns.inverse.times(self.to_columns)
        self.factor = torch.linalg.cholesky(system - torch.einsum("aqw,apw->qp", self.to_columns, solved))
        self.rhs = self.sigma * shading.sums(pixels.rhs).flatten()

    def _blocks(self, each: Sequence[Tensor]) -> Tensor:
        """`[aa ab; ab bb]` of three (terms, n), times this one's sigma, (2, 2 terms, n)."""
        aa, ab, bb = each
        return self.sigma[:, None] * torch.stack((torch.cat((aa, ab)), torch.cat((ab, bb))))

    def solve(self, columns: Tensor, terms: Tensor) -> tuple[Tensor, Tensor]:
        """Columns (2, w) and terms for this right-hand side, the rows held."""
        rest = terms - torch.einsum("aqw,aw->q", self.to_columns, self.columns.inverse.times(columns))
        terms = torch.cholesky_solve(rest[:, None], self.factor)[:, 0]
        rest = columns - torch.einsum("aqw,q->aw", self.to_columns, terms)
        return self.columns.inverse.times(rest), terms

    def spread(self) -> Tensor:
        """The values over the map, (2, h, w)."""
        return self.shading.spread(self._split(self.sigma * self.terms))

    @property
    def white(self) -> Tensor:
        """(2, terms)."""
        return self._split(self.terms)

    def variance(self, i: int) -> Tensor:
        """Posterior variance of the white terms of gain (0) or offset (1)."""
        return self._split(torch.cholesky_inverse(self.factor).diagonal())[i]

    def _split(self, terms: Tensor) -> Tensor:
        return terms.reshape(2, len(self.shading.white))


def _solve(columns: _Lines, rows: _Lines, smooth: _Smooth, system: _Symmetric) -> None:
    """Set the white values: `[C K'; K R] [c; r] = rhs`, with c the columns and the shading, eliminated.

    R and the columns are 2 x 2 blocks; K, dense, is never formed. Without a part, sigma is zero, and so is K.
    """
    transposed = system.transposed()

    def across(c: Tensor, terms: Tensor) -> Tensor:  # K c
        smoothly = torch.einsum("aqh,q->ah", smooth.to_rows, terms)
        return rows.sigma * system.sums(columns.sigma * c) + smoothly

    def down(r: Tensor) -> tuple[Tensor, Tensor]:  # K' r
        smoothly = torch.einsum("aqh,ah->q", smooth.to_rows, r)
        return columns.sigma * transposed.sums(rows.sigma * r), smoothly

    def schur(r: Tensor) -> Tensor:
        return rows.block.times(r) - across(*smooth.solve(*down(r)))

    rhs = rows.rhs - across(*smooth.solve(columns.rhs, smooth.rhs))
    rows.white = _conjugate_gradients(schur, rows.inverse.times, rhs)
    c, terms = down(rows.white)
    columns.white, smooth.terms = smooth.solve(columns.rhs - c, smooth.rhs - terms)


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


def _by_kind(parts: Sequence[Part]) -> dict[Kind, Part]:
    found = {SHADING if isinstance(part, Shading) else part.along: part for part in parts}
    if len(found) < len(parts) or not found.keys() <= {PIXEL, COLUMN, ROW, SHADING}:
        raise ValueError(
            f"no closed form for parts {[type(part).__name__.lower() for part in parts]}: at most one each of "
            "pixels, columns, rows and shading has one"
        )
    return found


def _shading(parts: Sequence[dict[Kind, Part]], like: Tensor) -> Shading:
    """One of the shading parts, whose terms are the same; one without terms if there is none."""
    found = next((each[SHADING] for each in parts if SHADING in each), None)
    return found if isinstance(found, Shading) else Shading(tuple(like.shape), degree=0).to(like.device)


def _sigmas(parts: Sequence[dict[Kind, Part]], kind: Kind, device: torch.device) -> Tensor:
    """Prior standard deviations of (gain, offset) for a kind of part, float64; zero where there is none."""
    zero = torch.zeros((), dtype=torch.float64, device=device)
    return torch.stack([each[kind].sigma.double() if kind in each else zero for each in parts])
