"""Motion of the camera, and the flux that its pixels collect."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import ndimage

from deepir.errors import DataError
from deepir.simulate.optics.blur import blur_picture
from deepir.simulate.optics.blur import blur_radius as radius_of
from deepir.simulate.scenes.procedural import Scene
from deepir.simulate.settings import Settings

MAX_DEFORMATION = 0.01  # largest stretch, shear and keystone (change of scale at the frame's edge)


def render(
    picture: np.ndarray,
    motion: np.ndarray,
    shape: tuple[int, int],
    scale: float,
    psf_sigma: float = 0.0,
    beside: np.ndarray | None = None,
) -> np.ndarray:
    """Flux on the detector's pixels: `D B M_k x`, without pattern and noise.

    The scene is continuous: the cubic B-spline through the blurred picture. Each pixel integrates it over its moved
    area by Gauss-Legendre quadrature, so that the data come from no grid of a reconstruction.

    Args:
        picture: (height, width); its centre is the centre of frame 0.
        motion: (N, 3, 3), pull homographies in detector px, origin at the frame's centre.
        shape: Height and width of a frame.
        scale: Picture px per detector px.
        psf_sigma: Gaussian blur of the optics, detector px. It is applied before the motion, with which it commutes
            except for stretch and keystone.
        beside: (N, 2, *shape), x and y in detector px, added to the points where pixels look; linear within a pixel.

    Returns:
        Frames (N, *shape), float64.
    """
    blurred = ndimage.gaussian_filter(picture, psf_sigma * scale, mode="mirror")
    spline = ndimage.spline_filter(blurred, order=3, mode="mirror")
    nodes, weights = np.polynomial.legendre.leggauss(max(3, int(np.ceil(scale))))
    y, x = (np.arange(n) - (n - 1) / 2 for n in shape)
    centre_y, centre_x = (np.array(picture.shape) - 1) / 2
    frames = np.zeros((len(motion), *shape))
    for k, T in enumerate(motion):
        more = np.zeros((2, *shape)) if beside is None else beside[k]
        along_y, along_x = (np.gradient(more, axis=axis) for axis in (1, 2))
        for v, weight_v in zip(nodes / 2, weights / 2, strict=True):
            for u, weight_u in zip(nodes / 2, weights / 2, strict=True):
                at_x, at_y, w = (row[0] * (x + u) + row[1] * (y + v)[:, None] + row[2] for row in T)
                add_x, add_y = more + u * along_x + v * along_y
                points = [centre_y + scale * (at_y / w + add_y), centre_x + scale * (at_x / w + add_x)]
                sample = ndimage.map_coordinates(spline, points, order=3, mode="mirror", prefilter=False)
                frames[k] += weight_u * weight_v * sample
    return frames


def draw_scene(scene: Scene | Sequence[Scene], reach: np.ndarray, settings: Settings) -> np.ndarray:
    """A scene as a picture (height, width).

    Args:
        scene: A picture, or a function that draws one of a given shape.
        reach: (y, x), extent from the centre that the frames see, detector px.
        settings: The camera.

    Raises:
        DataError: It is not a picture in [0, 1].
    """
    if callable(scene):
        height, width = np.ceil((settings.scale or 2.0 * settings.factor) * 2 * reach).astype(int) + 5
        scene = scene((int(height), int(width)))
    if isinstance(scene, list | tuple):
        raise DataError(
            f"scene: {len(scene)} pictures; for a frame of each, set simulate.own_scenes (own_scenes=true)"
        )
    picture = np.asarray(scene, float)
    if picture.ndim != 2 or not (picture.min() >= 0 and picture.max() <= 1):
        raise DataError(
            f"scene: a picture (height, width) with values in [0, 1] is needed, not {picture.shape}"
        )
    return picture


def render_reference(picture: np.ndarray, scale: float, settings: Settings) -> np.ndarray:
    """Frame 0 on a detector `factor` times as fine, with the same optics or (`sharp`) none, (Q H, Q W)."""
    fine, (height, width) = settings.factor, settings.shape
    blur = 0.0 if settings.sharp else settings.psf_sigma * fine  # in px of the finer detector
    picture = picture if settings.sharp else blur_picture(picture, scale, settings)
    return render(picture, np.eye(3)[None], (fine * height, fine * width), scale / fine, blur)[0]


def random_motion(settings: Settings, rng: np.random.Generator) -> np.ndarray:
    """Independent random homographies (N, 3, 3); the first is the identity."""
    draws = rng.uniform(-1, 1, (settings.n_frames, 9))
    draws[0] = 0
    return homographies(settings, draws)


def homographies(settings: Settings, draws: np.ndarray) -> np.ndarray:
    """Homographies (N, 3, 3) of draws (N, 9) in [-1, 1]: shift after rotation after stretch, shear and keystone."""
    motion = np.tile(np.eye(3), (len(draws), 1, 1))
    height, width = settings.shape
    if settings.motion == "homography":
        motion[:, 2, :2] = 2 * MAX_DEFORMATION * draws[:, 7:9] / (width, height)
    if settings.motion in ("affine", "homography"):
        motion[:, :2, :2] += MAX_DEFORMATION * draws[:, 3:7].reshape(-1, 2, 2)
    angle = np.deg2rad(settings.max_rotation) * draws[:, 2]
    move = np.tile(np.eye(3), (len(draws), 1, 1))
    move[:, 0, 0] = move[:, 1, 1] = np.cos(angle)
    move[:, 1, 0], move[:, 0, 1] = np.sin(angle), -np.sin(angle)
    move[:, :2, 2] = settings.max_shift * draws[:, :2] * (settings.jitter != "y", settings.jitter != "x")
    motion = move @ motion
    return motion / motion[:, 2:, 2:]


def visible_reach(motion: np.ndarray, settings: Settings) -> np.ndarray:
    """Extent (y, x) from the centre that the frames see, detector px: corners, blur and parallax."""
    height, width = settings.shape
    corners = np.array([(i * width / 2, j * height / 2, 1) for i in (-1, 1) for j in (-1, 1)])
    seen = corners @ motion.mT
    reach = np.abs(seen[..., 1::-1] / seen[..., 2:]).max(axis=(0, 1))
    return reach + radius_of(settings) + settings.parallax


def picture_scale(shape: tuple[int, ...], reach: np.ndarray, settings: Settings) -> float:
    """Picture px per detector px: the setting, or the largest that fits.

    Args:
        shape: Shape of the picture; two px at each side are for the spline.
        reach: (y, x), extent from the centre that the frames see, detector px.
        settings: The camera.

    Raises:
        DataError: The picture is too small.
    """
    largest = float(np.min((np.array(shape) - 5) / (2 * reach)))
    scale, least = settings.scale or largest, settings.least_scale
    if scale > largest or scale < least:
        need = np.ceil(2 * reach * (settings.scale or least)).astype(int) + 5
        raise DataError(
            f"scene: {shape[0]} x {shape[1]} px is too small: the frames and their motion need {need[0]} x "
            f"{need[1]} px at {settings.scale or least:g} picture px per detector px; "
            "take a larger picture, or less of simulate.shape, max_shift or max_rotation"
        )
    return scale
