"""Gain and offset in closed form, by variable projection.

For a fixed flux `z_k`, `y_k = gain * z_k + offset + level_k + noise` is linear in gain and offset with Gaussian priors.
Their optimum solves one symmetric system, 2 x 2 at each pixel. Pixel parts are eliminated exactly, then rows; the
remaining system of columns and shading terms is solved by conjugate gradients, whose products are one pass over the
pixels. The solution must be exact: otherwise the objective is not a function of the scene, and line searches fail.

By the envelope theorem the gradient of the projected objective is the partial gradient at fixed gain and offset.

Source: Golub and Pereyra 1973, "The differentiation of pseudo-inverses and nonlinear least squares problems whose
variables separate".
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence

import torch
from torch import Tensor

from deepir.closed_form.normal_equations import PixelEquations, PixelEquationsCPU, multiply_symmetric
from deepir.fields.sensor_maps import GaussianMap
from deepir.fields.shading import Shading
from deepir.kernels.threads import is_compiled

Kind = tuple[int, ...] | None  # kind of a part: the axes along which it is constant; None for shading
KINDS = PIXEL, COLUMN, ROW, SHADING = (), (-2,), (-1,), None


class Elimination:
    """Joint optimum of the parts of gain and offset.

    Attributes:
        values: Gain and offset, (2, h, w), in the type of the flux.
    """

    def __init__(
        self,
        parts: Sequence[dict[Kind, GaussianMap]],
        solved: dict[Kind, PixelEquations | _LineEquations | _ShadingEquations],
        values: Tensor,
    ) -> None:
        self.parts, self.solved, self.values = parts, solved, values

    def information_blocks(self) -> Iterator[tuple[list[GaussianMap | None], Tensor, Tensor]]:
        """Information on pixels, columns and rows.

        Yields:
            The parts (gain, offset), None where there is none; the information matrices (aa, ab, bb), (3, K), with all
            other parts fixed, but pixel parts integrated out for lines; the posterior means, (2, K).
        """
        for kind in (PIXEL, COLUMN, ROW):
            parts = [maps_of.get(kind) for maps_of in self.parts]
            if any(parts):
                yield parts, *self._block(kind, parts)

    def _block(self, kind: Kind, parts: list[GaussianMap | None]) -> tuple[Tensor, Tensor]:
        pixels, solved = self.solved[PIXEL], self.solved[kind]
        assert isinstance(pixels, PixelEquations)
        if isinstance(solved, _LineEquations):
            return (pixels.column_sums if kind == COLUMN else pixels.row_sums)[:3], solved.values
        nothing = pixels.maps.new_zeros(pixels.maps[0].numel())
        white = torch.stack([part.whitened.detach().flatten() if part else nothing for part in parts])
        return pixels.information().flatten(1), pixels.sigma[:, None] * white

    def log_det_gradient(self) -> tuple[Tensor, Tensor, Tensor]:
        """Half the log-determinant of the pixels' systems and its gradient; see `sensor_least_squares`."""
        pixels = self.solved[PIXEL]
        assert isinstance(pixels, PixelEquations)
        return pixels.log_det, pixels.sigma.square(), pixels.maps

    def posterior_variances(self) -> list[list[Tensor]]:
        """Posterior variances of the values of each part, for gain and offset.

        Covariances between columns, and of rows with all others, are neglected.
        """
        return [
            [
                part.prior_sigma.square() * self.solved[kind].variance(i).reshape(part.whitened.shape)
                for kind, part in maps_of.items()
            ]
            for i, maps_of in enumerate(self.parts)
        ]


@torch.no_grad()
def eliminate(
    flux: Tensor,
    data: Tensor,
    precision: Tensor,
    gain: Sequence[GaussianMap],
    offset: Sequence[GaussianMap],
    *,
    level: Tensor | None = None,
    neutral: tuple[float, float] = (0.0, 0.0),
) -> Elimination:
    """Set the parts of gain and offset to their joint optimum.

    Args:
        flux: On the detector, (N, 1, h, w), data units.
        data: Frames less known gain times flux and known offset, same shape.
        precision: Inverse noise variance, same shape; zero where a sample does not count.
        gain: Parts of the gain, at most one each of columns, rows, shading, pixels; none for a known gain.
        offset: Parts of the offset, likewise.
        level: Of each frame, (N,); zero if None.
        neutral: Gain and offset from which the parts are deviations.

    Returns:
        The optimum; the parts are changed in place.

    Raises:
        ValueError: Two parts are of the same kind, or of a kind without a closed form.
    """
    parts = [_by_kind(each) for each in (gain, offset)]
    none = torch.zeros((), dtype=torch.float64, device=flux.device)
    # Prior standard deviations of (gain, offset) for each kind of part, (2,); zero where there is none.
    sigma = {
        kind: torch.stack([each[kind].sigma.double() if kind in each else none for each in parts]) for kind in KINDS
    }
    start = torch.tensor(neutral, dtype=torch.float64, device=flux.device)
    levels = start[1] + (start.new_zeros(len(flux)) if level is None else level.flatten().double())
    make = PixelEquationsCPU if is_compiled(flux) else PixelEquations
    lines = torch.maximum(sigma[COLUMN], sigma[ROW])
    pixels = make(flux[:, 0], data[:, 0], precision[:, 0], levels, neutral[0], sigma[PIXEL], lines)
    columns = _LineEquations(pixels.column_sums, sigma[COLUMN])
    rows = _LineEquations(pixels.row_sums, sigma[ROW])
    # One of the shading parts: their terms are the same.
    shading = next((part for each in parts if isinstance(part := each.get(SHADING), Shading)), None)
    smooth = _ShadingEquations(shading, sigma[SHADING], pixels, columns)
    finite = _solve(columns, rows, smooth, pixels)
    # Flux that is not a number spreads to a column: the trial went too far, and what was found before stays.
    white = [
        maps_of[PIXEL].whitened.detach()[0, 0] if finite and PIXEL in maps_of else torch.empty_like(pixels.maps[0])
        for maps_of in parts
    ]
    errors, values = pixels.back_substitute(columns.values, smooth.in_rows(), rows.weights, start, (white[0], white[1]))
    rows.white = multiply_symmetric(rows.inverse, rows.sigma * errors)
    solved: dict[Kind, PixelEquations | _LineEquations | _ShadingEquations]
    solved = {PIXEL: pixels, COLUMN: columns, ROW: rows, SHADING: smooth}
    for i, maps_of in enumerate(parts):
        for kind, part in maps_of.items():
            if finite and kind != PIXEL:
                part.whitened.copy_(solved[kind].white[i].reshape(part.whitened.shape))  # type: ignore[union-attr]
    return Elimination(parts, solved, values)


class _LineEquations:
    """All columns or all rows, in white coordinates, `value = sigma * white`, (2, lines); from their `sums` (5, lines).

    `inverse`, (3, lines), is that of the block of each line, and `weights` that for right-hand sides and values that
    are not white.
    """

    white: Tensor

    def __init__(self, sums: Tensor, sigma: Tensor) -> None:
        self.sigma = sigma[:, None]
        s, t = sigma
        scale = torch.stack((s * s, s * t, t * t))[:, None]
        aa, ab, bb = scale * sums[:3]
        aa, bb = 1 + aa, 1 + bb
        self.block = aa, ab
        self.inverse = torch.stack((bb, -ab, aa)) / (aa * bb - ab * ab)
        self.weights = scale * self.inverse

    @functools.cached_property
    def root(self) -> Tensor:
        """`L^-1`, (2, 2, lines), of the lower triangles L of Cholesky: `L L'` is the block of each line."""
        (aa, ab), last = self.block, self.inverse[2].sqrt()
        return torch.stack((aa.rsqrt(), torch.zeros_like(aa), -ab / aa * last, last)).unflatten(0, (2, 2))

    @property
    def values(self) -> Tensor:
        return self.sigma * self.white

    def variance(self, i: int) -> Tensor:
        """Posterior variance of the white values of gain (0) or offset (1)."""
        return self.inverse[2 * i]


class _ShadingEquations:
    """The terms of the shading, in white coordinates: those of gain and offset that have a strength.

    Its system has the columns eliminated, `L L'` with the lower triangle L, and `root` `L^-1`.
    """

    solution: Tensor

    def __init__(self, shading: Shading | None, sigma: Tensor, pixels: PixelEquations, columns: _LineEquations) -> None:
        self.shading, self.size = shading, pixels.maps.shape[1:]
        self.active = [i for i, each in enumerate(sigma.tolist()) if each > 0]  # gain, offset
        if shading is None or not self.active:
            self.to_rows, self.to_columns = (sigma.new_zeros(0, 2 * side) for side in self.size)
            self.root, self.rhs, self.sigma = sigma.new_zeros(0, 0), sigma[:0], sigma[:0]
            return
        self.sigma = torch.outer(sigma[self.active], shading.relative_sigma).flatten()
        down = shading.column_moments(pixels.maps)
        by_column = self._blocks(shading.column_sums(down[:3]))
        to_columns = (columns.root * (columns.sigma * by_column)[:, None]).sum(2).flatten(1)
        gram = self._blocks(shading.gram(down[:3]))[:, self.active].flatten(1) * self.sigma
        gram.diagonal().add_(1)
        triangle, _ = torch.linalg.cholesky_ex(gram - to_columns @ to_columns.T)
        one = torch.eye(len(gram), dtype=gram.dtype, device=gram.device)
        self.root = torch.linalg.solve_triangular(triangle, one, upper=False)
        #: Couplings to the lines, (terms, 2 lines), in the coordinates of `PixelEquations.solve`.
        self.to_columns = self.root @ to_columns
        self.to_rows = self.root @ self._blocks(shading.row_sums(pixels.maps[:3])).flatten(1)
        self.rhs = self.root @ (self.sigma * shading.analyse_moments(down[3:])[self.active].flatten())

    def _blocks(self, each: Tensor) -> Tensor:
        """`[aa ab; ab bb]` of three (terms, n), times this one's sigma, (all terms, 2, n)."""
        aa, ab, bb = each
        blocks = (torch.stack((aa, ab), 1), torch.stack((ab, bb), 1))
        return self.sigma[:, None, None] * torch.cat([blocks[i] for i in self.active])

    def in_rows(self) -> tuple[Tensor, Tensor]:
        """The values in each row as a combination (2, h, n) of functions of x, (n, w)."""
        if self.shading is None or not self.active:
            return self.root.new_zeros(2, self.size[0], 0), self.root.new_zeros(0, self.size[1])
        return self.shading.row_coefficients(self._scatter(self.sigma * self.solution)), self.shading.basis_x

    @functools.cached_property
    def white(self) -> Tensor:
        """(2, terms), once they are found."""
        return self._scatter(self.solution)

    def variance(self, i: int) -> Tensor:
        """Posterior variance of the white terms of gain (0) or offset (1)."""
        return 1 - self._scatter(1 - self.root.square().sum(0))[i]

    def _scatter(self, found: Tensor) -> Tensor:
        """(2, terms), zero without a strength."""
        assert self.shading is not None
        spread = found.new_zeros(2, len(self.shading.whitened))
        for i, each in zip(self.active, found.split(len(self.shading.whitened)), strict=False):
            spread[i] = each
        return spread


def _solve(columns: _LineEquations, rows: _LineEquations, smooth: _ShadingEquations, pixels: PixelEquations) -> bool:
    """Set the white values of columns and shading, the rows eliminated; whether they are finite.

    Without a part, sigma is zero, and so are its couplings.
    """
    root = columns.root * columns.sigma
    c = (root * pixels.column_sums[3:]).sum(1).flatten()
    rhs = torch.cat((c, smooth.rhs - smooth.to_columns @ c))
    found = pixels.solve(root, smooth.to_columns, smooth.to_rows, rows.weights, rhs)
    c, terms = found[: len(c)], found[len(c) :]
    columns.white = (columns.root * (c - terms @ smooth.to_columns).reshape(2, 1, -1)).sum(0)
    smooth.solution = terms @ smooth.root
    return bool(found.isfinite().all())


def _by_kind(parts: Sequence[GaussianMap]) -> dict[Kind, GaussianMap]:
    found = {SHADING if isinstance(part, Shading) else part.constant_axes: part for part in parts}
    if len(found) < len(parts) or not found.keys() <= {PIXEL, COLUMN, ROW, SHADING}:
        raise ValueError(
            f"no closed form for parts {[type(part).__name__.lower() for part in parts]}: at most one each of "
            "pixels, columns, rows and shading has one"
        )
    return found
