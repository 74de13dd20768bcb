"""Flat textured surfaces of a world, rendered with true parallax and integrated over each pixel."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy import ndimage

from deepir.simulate.recording import raster
from deepir.simulate.recording.raster import SAMPLES_PER_PIXEL
from deepir.simulate.scenes.objects import Canvas

#: Unit vectors of the world, see `deepir.simulate.recording.paths`.
RIGHT, DOWN, AHEAD = np.eye(3)
MIN_DEPTH = 1 / raster.MAX_INVERSE_DEPTH  # least depth that is rendered, m
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
    #: Order of cut-outs: one of a higher layer is behind all of a lower layer, whatever their depths.
    layer: int = 0

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
    """A texture of a picture.

    Args:
        picture: (height, width).
        texel: Side of a texel, m.
        cover: (height, width), opacity in [0, 1], already multiplied into the picture; None: opaque.
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


def homography(
    surface: Surface, position: np.ndarray, rotation: np.ndarray, time: float
) -> np.ndarray | None:
    """Homography from rays (x, y, 1) of the camera to points (s, t, 1) of a surface, m, over their depth.

    Returns:
        (3, 3); None if the surface is seen edge-on.
    """
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
        raster.paint_surface(
            shown.values, shown.cover, shown.levels, shown.texel, surface.size, H, first, step, box,
            surface.moving, near, *into, through,
        )  # fmt: skip
    back = world.backdrop
    start = (world.azimuth, world.elevation)
    raster.paint_backdrop(back.values, back.levels, back.texel, start, rotation, first, step, behind, near)
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
