"""Flat textured surfaces of a world, rendered with true parallax and integrated over each pixel."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numba import njit
from scipy import ndimage

from deepir.kernels.compile import compiled
from deepir.simulate.scenes.objects import Canvas

#: Unit vectors of the world, see `deepir.simulate.paths`.
RIGHT, DOWN, AHEAD = np.eye(3)
SAMPLES_PER_PIXEL = 2  # samples along a pixel's side
MAX_TEXTURE_PROBES = 5  # samples of a texture along the longer side of a sample's footprint
MIN_VISIBLE_SHARE = 1e-3  # share of a sample below which a surface is skipped
MAX_INVERSE_DEPTH = 20.0  # inverse of the least depth that is rendered, 1/m
MIN_DEPTH = 1 / MAX_INVERSE_DEPTH  # least depth that is rendered, m
MIN_MOVING_COVER = 0.02  # covered share of a sample from which it counts as moving


@dataclass(frozen=True)
class Texture:
    """A picture and its averages over 2 x 2, 4 x 4, ... texels."""

    values: np.ndarray  # float32, all levels one after the other
    cover: np.ndarray  # the same of how opaque each texel is; empty: all are
    levels: np.ndarray  # (L, 3): height, width and start of each level
    texel: float  # side of a texel, m


@dataclass(frozen=True)
class Surface:
    """A rectangle at `corner + velocity t`; a texture smaller than it is mirrored."""

    textures: Sequence[Texture]  # shown in turn, `rate` a second
    corner: np.ndarray  # (3,), m, where the texture's first texel begins
    along: np.ndarray  # (3,), unit vector of the texture's x
    down: np.ndarray  # (3,), unit vector of the texture's y
    size: tuple[float, float]  # along and down, m
    velocity: np.ndarray = field(default_factory=lambda: np.zeros(3))  # m/s
    rate: float = 0.0  # Hz
    layer: int = 0  # order of cut-outs: one of a higher layer is behind all of a lower layer, whatever their depths

    @property
    def cut(self) -> bool:
        """True for a cut-out, through which surfaces behind it show."""
        return bool(self.textures[0].cover.size)

    @property
    def moving(self) -> bool:
        """True if it moves by itself."""
        return bool(self.velocity.any())


@dataclass(frozen=True)
class World:
    """Surfaces before a backdrop at infinity."""

    surfaces: Sequence[Surface]
    backdrop: Texture  # on a cylinder: x is the azimuth, y the tangent of the elevation, both increasing
    azimuth: float  # where the backdrop begins, rad
    elevation: float  # tangent of the same, positive below the horizon


def texture(picture: np.ndarray, texel: float, cover: np.ndarray | None = None) -> Texture:
    """A texture of a picture (height, width) with texels of a side in m.

    `cover` is its opacity in [0, 1], already multiplied into the picture; None: opaque.
    """
    values, covers, levels, start = [], [], [], 0
    layers = [np.asarray(picture, np.float32)]
    layers += [np.asarray(cover, np.float32)] if cover is not None else []
    while True:
        height, width = layers[0].shape
        levels.append((height, width, start))
        start += height * width
        values.append(layers[0].ravel())
        covers += [layers[1].ravel()] if cover is not None else []
        if min(height, width) < 4:
            break
        layers = [_halved(each) for each in layers]
    joined = np.concatenate(covers) if covers else np.zeros(0, np.float32)
    return Texture(np.concatenate(values), joined, np.array(levels), texel)


def _halved(layer: np.ndarray) -> np.ndarray:
    height, width = (n // 2 for n in layer.shape)
    return layer[: 2 * height, : 2 * width].reshape(height, 2, width, 2).mean((1, 3))


def cut_out(seed: int, shape: tuple[int, int], draw: Callable[[Canvas], None], texel: float) -> Texture:
    """A cut-out with the painting of `draw` on a canvas."""
    canvas = Canvas(seed, shape)
    # Painting is linear: the imaginary part keeps how much of what is behind shows.
    canvas.image = np.full(shape, 1j)
    draw(canvas)
    return texture(canvas.image.real, texel, 1 - canvas.image.imag)


def homography(surface: Surface, position: np.ndarray, rotation: np.ndarray, time: float) -> np.ndarray | None:
    """Homography (3, 3) from rays (x, y, 1) of the camera to points (s, t, 1) of a surface, m; None if seen edge-on."""
    reach = surface.corner + surface.velocity * time - position
    frame = np.stack([surface.along, surface.down, reach], axis=1)
    if abs(np.linalg.det(frame)) < 1e-9:
        return None
    return np.asarray(np.linalg.inv(frame) @ rotation)


def render_view(
    world: World,
    position: np.ndarray,
    rotation: np.ndarray,
    focal: float,
    shape: tuple[int, int],
    psf_sigma: float = 0.0,
    time: float = 0.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Render a world.

    Rays through `SAMPLES_PER_PIXEL` x `SAMPLES_PER_PIXEL` points of each pixel meet the surfaces exactly. The texture
    is averaged between the points, then blurred by the optics and averaged over the pixel.

    Args:
        world: The world.
        position: (3,), m.
        rotation: (3, 3), from the camera's axes to the world's.
        focal: Focal length, px.
        shape: Height and width of the frame, px.
        psf_sigma: Gaussian blur of the optics, px.
        time: Time of moving surfaces, s.

    Returns:
        Scene values (H, W), float32, and pixels of moving surfaces, (H, W) bool.
    """
    margin = SAMPLES_PER_PIXEL * int(np.ceil(3 * psf_sigma))
    height, width = (SAMPLES_PER_PIXEL * n + 2 * margin for n in shape)
    step = 1 / (SAMPLES_PER_PIXEL * focal)
    first = (-(width - 1) / 2 * step, -(height - 1) / 2 * step)
    near, seen, moving, behind, behind_moving = np.zeros((5, height, width), np.float32)
    through = np.ones((height, width), np.float32)
    met = []
    for each in world.surfaces:
        H = homography(each, position, rotation, time)
        box = None if H is None else _box(each, position, rotation, time, first, step, (height, width))
        if box is not None:
            middle = each.corner + (each.along * each.size[0] + each.down * each.size[1]) / 2
            depth = ((middle + each.velocity * time - position) @ rotation)[2]
            met.append(((each.cut, each.layer, depth), each, H, box))
    for _, surface, H, box in sorted(met, key=lambda each: each[0]):
        shown = surface.textures[int(time * surface.rate) % len(surface.textures)]
        into = (seen, moving) if surface.cut else (behind, behind_moving)
        paint_surface(
            shown.values, shown.cover, shown.levels, shown.texel, surface.size, H, first, step, box,
            surface.moving, near, *into, through,
        )  # fmt: skip
    back = world.backdrop
    start = (world.azimuth, world.elevation)
    paint_backdrop(back.values, back.levels, back.texel, start, rotation, first, step, behind, near)
    seen += through * behind
    moving += through * behind_moving
    if psf_sigma:
        seen = ndimage.gaussian_filter(seen, SAMPLES_PER_PIXEL * psf_sigma, truncate=3.0)
    inner = (slice(margin, height - margin), slice(margin, width - margin))
    blocks = (shape[0], SAMPLES_PER_PIXEL, shape[1], SAMPLES_PER_PIXEL)
    mask = moving[inner].reshape(blocks).mean((1, 3)) > MIN_MOVING_COVER
    if psf_sigma:
        mask = ndimage.maximum_filter(mask, 3)
    return seen[inner].reshape(blocks).mean((1, 3)), mask


def _box(
    surface: Surface,
    position: np.ndarray,
    rotation: np.ndarray,
    time: float,
    first: Sequence[float],
    step: float,
    shape: tuple[int, int],
) -> tuple[int, int, int, int] | None:
    """First and last row and column in which a surface may be visible; None if it is not."""
    start = surface.corner + surface.velocity * time - position
    sides = surface.along * surface.size[0], surface.down * surface.size[1]
    corners = np.array([start + i * sides[0] + j * sides[1] for i in (0, 1) for j in (0, 1)]) @ rotation
    if (corners[:, 2] < MIN_DEPTH).all():
        return None
    if (corners[:, 2] < MIN_DEPTH).any():
        return 0, shape[0], 0, shape[1]
    at = (corners[:, :2] / corners[:, 2:] - first) / step
    x0, y0 = np.floor(at.min(0)).clip(0, shape[::-1]).astype(int)
    x1, y1 = (np.ceil(at.max(0)) + 1).clip(0, shape[::-1]).astype(int)
    return (int(y0), int(y1), int(x0), int(x1)) if y1 > y0 and x1 > x0 else None


# Kernels: each fine sample looks up where its ray meets a surface.


@njit(inline="always")
def _mirrored(at: int, side: int) -> int:
    at %= 2 * side
    return 2 * side - 1 - at if at >= side else at


@njit(inline="always")
def _weighted(plane: np.ndarray, at: tuple[int, int, int, int], weights: tuple[float, float, float, float]) -> float:
    return weights[0] * plane[at[0]] + weights[1] * plane[at[1]] + weights[2] * plane[at[2]] + weights[3] * plane[at[3]]


@njit
def _level(
    values: np.ndarray, cover: np.ndarray, levels: np.ndarray, level: int, x: float, y: float
) -> tuple[float, float]:
    """Linear between the texels of a level, mirrored at its edges; x and y in texels of level 0, which begins at 0."""
    height, width, start = levels[level, 0], levels[level, 1], levels[level, 2]
    shrink = 1.0 / (1 << level)
    x, y = x * shrink - 0.5, y * shrink - 0.5
    left, top = int(np.floor(x)), int(np.floor(y))
    u, v = x - left, y - top
    right, below = left + 1, top + 1
    if left < 0 or right >= width:
        left, right = _mirrored(left, width), _mirrored(right, width)
    if top < 0 or below >= height:
        top, below = _mirrored(top, height), _mirrored(below, height)
    top, below = start + top * width, start + below * width
    corners = (top + left, top + right, below + left, below + right)
    weights = ((1 - v) * (1 - u), (1 - v) * u, v * (1 - u), v * u)
    return _weighted(values, corners, weights), _weighted(cover, corners, weights) if len(cover) else 1.0


@njit
def _average(
    values: np.ndarray,
    cover: np.ndarray,
    levels: np.ndarray,
    at: tuple[float, float],
    u: tuple[float, float],
    v: tuple[float, float],
) -> tuple[float, float]:
    """Value and cover of a texture over the parallelogram u, v about a point (x, y), all in texels."""
    across, along = np.hypot(u[0], u[1]), np.hypot(v[0], v[1])
    longer = v
    if across > along:
        longer = u
        across, along = along, across
    size = max(across, along / MAX_TEXTURE_PROBES, 1.0)
    level = min(np.log2(size), len(levels) - 1.0)
    coarse = int(level)
    part = level - coarse
    count = min(max(int(np.ceil(along / size)), 1), MAX_TEXTURE_PROBES)
    value = hides = 0.0
    for k in range(count):
        way = (k + 0.5) / count - 0.5
        x, y = at[0] + way * longer[0], at[1] + way * longer[1]
        first, first_hides = _level(values, cover, levels, coarse, x, y)
        if part > 0:
            second, second_hides = _level(values, cover, levels, coarse + 1, x, y)
            first += part * (second - first)
            first_hides += part * (second_hides - first_hides)
        value += first
        hides += first_hides
    return value / count, hides / count


@compiled
def paint_surface(
    values: np.ndarray,
    cover: np.ndarray,
    levels: np.ndarray,
    texel: float,
    size: tuple[float, float],
    H: np.ndarray,
    first: tuple[float, float],
    step: float,
    box: tuple[int, int, int, int],
    moves: bool,
    near: np.ndarray,
    seen: np.ndarray,
    moving: np.ndarray,
    through: np.ndarray,
) -> None:
    """Paint a surface where it is nearer than the opaque surfaces so far.

    An opaque one (no `cover`) writes to `near`, the inverse of the depth. A cut-out is painted behind earlier cut-outs:
    `through` is the uncovered fraction of each sample.
    """
    for i in range(box[0], box[1]):
        v = first[1] + i * step
        for j in range(box[2], box[3]):
            u = first[0] + j * step
            w = H[2, 0] * u + H[2, 1] * v + H[2, 2]
            if w <= near[i, j] or w > MAX_INVERSE_DEPTH or through[i, j] < MIN_VISIBLE_SHARE:
                continue
            s = (H[0, 0] * u + H[0, 1] * v + H[0, 2]) / w
            t = (H[1, 0] * u + H[1, 1] * v + H[1, 2]) / w
            if s < 0 or t < 0 or s > size[0] or t > size[1]:
                continue
            scale = step / (w * texel)
            along_u = ((H[0, 0] - s * H[2, 0]) * scale, (H[1, 0] - t * H[2, 0]) * scale)
            along_v = ((H[0, 1] - s * H[2, 1]) * scale, (H[1, 1] - t * H[2, 1]) * scale)
            value, hides = _average(values, cover, levels, (s / texel, t / texel), along_u, along_v)
            if len(cover) == 0:
                seen[i, j], near[i, j] = value, w
                moving[i, j] = 1.0 if moves else 0.0
            elif hides > MIN_VISIBLE_SHARE:
                seen[i, j] += through[i, j] * value
                moving[i, j] += through[i, j] * hides if moves else 0.0
                through[i, j] *= 1 - hides


@compiled
def paint_backdrop(
    values: np.ndarray,
    levels: np.ndarray,
    texel: float,
    start: tuple[float, float],
    R: np.ndarray,
    first: tuple[float, float],
    step: float,
    seen: np.ndarray,
    near: np.ndarray,
) -> None:
    """Paint the backdrop at infinity behind everything; it begins at azimuth and elevation `start`."""
    for i in range(seen.shape[0]):
        v = first[1] + i * step
        for j in range(seen.shape[1]):
            if near[i, j] > 0:
                continue
            u = first[0] + j * step
            x = R[0, 0] * u + R[0, 1] * v + R[0, 2]
            y = R[1, 0] * u + R[1, 1] * v + R[1, 2]
            z = R[2, 0] * u + R[2, 1] * v + R[2, 2]
            square = x * x + z * z
            level = np.sqrt(square)
            scale = step / texel
            au, av = (z * R[0, 0] - x * R[2, 0]) / square, (z * R[0, 1] - x * R[2, 1]) / square
            lu, lv = (x * R[0, 0] + z * R[2, 0]) / square, (x * R[0, 1] + z * R[2, 1]) / square
            tu, tv = (R[1, 0] - y * lu) / level, (R[1, 1] - y * lv) / level
            at = ((np.arctan2(x, z) - start[0]) / texel, (y / level - start[1]) / texel)
            along_u, along_v = (au * scale, tu * scale), (av * scale, tv * scale)
            seen[i, j], _ = _average(values, values[:0], levels, at, along_u, along_v)
