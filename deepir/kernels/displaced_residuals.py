# mypy: disable-error-code="no-untyped-def"
"""What a pixel shows beyond another frame's view of the same point of the scene, summed over pairs of frames."""

from __future__ import annotations

from deepir.kernels.compile import compiled


@compiled
def displaced_residuals(
    first, last, here, there, y, x, known, factor, noise, displacement_error, least, level, sums
):
    """Add a pair's weighted moments of scene and residual at each pixel.

    The displacement is given for blocks of pixels, and interpolated. Residuals weigh as of a Cauchy distribution, whose
    scale is larger where the scene is steep: there an error of the displacement matters.

    Args:
        first, last: rows of `here` to compute.
        here: corrected frame (h, w), float32.
        there: corrected frame that shows the same points displaced, same shape.
        y, x: displacement of each block, blocks, (h / factor, w / factor).
        known: bool, same shape, whether it is trusted.
        factor: side of a block, px.
        noise: scale of the residuals, in the frames' units.
        displacement_error: error of the displacement, px.
        least: px; displacements below it are skipped, as the pattern's detail does not leave its place.
        level: subtracted from the scene.
        sums: (5, h, w), float64, of weight, scene, scene squared, residual, scene times residual; added to.
    """
    height, width = here.shape
    rows, columns = y.shape
    for i in range(first, last):
        row = min(max((i + 0.5) / factor - 0.5, 0.0), rows - 1.0)
        top = min(int(row), rows - 2)
        below = row - top
        for j in range(width):
            column = min(max((j + 0.5) / factor - 0.5, 0.0), columns - 1.0)
            left = min(int(column), columns - 2)
            beside = column - left
            if not (
                known[top, left]
                and known[top + 1, left]
                and known[top, left + 1]
                and known[top + 1, left + 1]
            ):
                continue
            a, b = (1 - below) * (1 - beside), (1 - below) * beside
            c, d = below * (1 - beside), below * beside
            down = factor * (
                a * y[top, left] + b * y[top, left + 1] + c * y[top + 1, left] + d * y[top + 1, left + 1]
            )
            across = factor * (
                a * x[top, left] + b * x[top, left + 1] + c * x[top + 1, left] + d * x[top + 1, left + 1]
            )
            if down * down + across * across < least * least:
                continue
            at_y, at_x = i + down, j + across
            if not (0 <= at_y < height - 1 and 0 <= at_x < width - 1):
                continue
            p, q = int(at_y), int(at_x)
            u, v = at_y - p, at_x - q
            upper, lower = there[p, q + 1] - there[p, q], there[p + 1, q + 1] - there[p + 1, q]
            scene = (there[p, q] + v * upper) * (1 - u) + (there[p + 1, q] + v * lower) * u
            steep_x = (upper + lower) / 2
            steep_y = (there[p + 1, q] - there[p, q] + there[p + 1, q + 1] - there[p, q + 1]) / 2
            rest = here[i, j] - scene
            variance = noise * noise + displacement_error * displacement_error * (
                steep_x * steep_x + steep_y * steep_y
            )
            weight = 1 / (variance + rest * rest)
            if not weight > 0:  # a sample that is not a number
                continue
            scene -= level
            sums[0, i, j] += weight
            sums[1, i, j] += weight * scene
            sums[2, i, j] += weight * scene * scene
            sums[3, i, j] += weight * rest
            sums[4, i, j] += weight * scene * rest
