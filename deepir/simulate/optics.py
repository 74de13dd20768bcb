"""From the scene to the flux on the detector: motion, blur, parallax, stray flux."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy import ndimage, signal, special

from deepir.errors import ConfigError, DataError
from deepir.simulate.scenes.procedural import Scene
from deepir.simulate.settings import Settings

MAX_DEFORMATION = 0.01  # largest stretch, shear and keystone (change of scale at the frame's edge)
PSF_SAMPLES_PER_PIXEL = 5  # grid points of the truth's psf per detector px
AIRY_RINGS = 4  # first dark radii at which an Airy pattern is cut off: 95 % of its energy
KERNEL_SUBSAMPLES = 9  # samples of a kernel along the side of a grid point
HILL_COUNT = 8  # hills of the relief
HILL_WIDTHS = (0.08, 0.2)  # least and largest sigma of a hill, in shorter sides of the frame
MAX_PARALLAX = 0.05  # in shorter sides of the frame; above, hills hide each other
MAX_FIXED_POINT_ITERATIONS = 60  # iterations of the nearness at a frame's pixels


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
    centre_y, centre_x = (np.array(picture.shape) - 1) / 2
    frames = np.zeros((len(motion), *shape))
    for k, T in enumerate(motion):
        more = np.zeros((2, *shape)) if beside is None else beside[k]
        along_y, along_x = (np.gradient(more, axis=axis) for axis in (1, 2))
        for v, weight_v in zip(nodes / 2, weights / 2, strict=True):
            for u, weight_u in zip(nodes / 2, weights / 2, strict=True):
                at_x, at_y = sampling_points(T, shape, u, v)
                add_x, add_y = more + u * along_x + v * along_y
                points = [centre_y + scale * (at_y + add_y), centre_x + scale * (at_x + add_x)]
                sample = ndimage.map_coordinates(spline, points, order=3, mode="mirror", prefilter=False)
                frames[k] += weight_u * weight_v * sample
    return frames


def draw_scene(scene: Scene | Sequence[Scene], motion: np.ndarray, settings: Settings) -> tuple[np.ndarray, float]:
    """A scene as a picture (height, width), and its px per detector px.

    Args:
        scene: A picture, or a function that draws one of a given shape.
        motion: (N, 3, 3), pull homographies of the frames, px.
        settings: The camera.

    Raises:
        DataError: It is not a picture in [0, 1], or too small for the frames.
    """
    reach = visible_reach(motion, settings)
    if callable(scene):
        height, width = np.ceil((settings.scale or 2.0 * settings.factor) * 2 * reach).astype(int) + 5
        scene = scene((int(height), int(width)))
    if isinstance(scene, list | tuple):
        raise DataError(f"scene: {len(scene)} pictures; for a frame of each, set simulate.own_scenes (own_scenes=true)")
    picture = np.asarray(scene, float)
    if picture.ndim != 2 or not (picture.min() >= 0 and picture.max() <= 1):
        raise DataError(f"scene: a picture (height, width) with values in [0, 1] is needed, not {picture.shape}")
    return picture, picture_scale(picture.shape, reach, settings)


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
    return reach + blur_radius(settings) + settings.parallax


def picture_scale(shape: tuple[int, ...], reach: np.ndarray, settings: Settings) -> float:
    """Picture px per detector px: the setting, or the largest at which the frames' `reach` fits into a picture.

    Two px at each side of the picture are for the spline.

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


def blur_picture(picture: np.ndarray, scale: float, settings: Settings) -> np.ndarray:
    """Blur a picture (height, width), `scale` px per detector px, by all but the Gaussian."""
    for each in _kernels(settings, scale):
        padded = np.pad(picture, [(side // 2,) * 2 for side in each.shape], mode="symmetric")
        picture = signal.fftconvolve(padded, each, mode="valid")
    return picture


def psf(settings: Settings) -> np.ndarray:
    """Point-spread function of the optics, (K, K), K odd, `PSF_SAMPLES_PER_PIXEL` points per px, sum one."""
    side = 2 * int(np.ceil(PSF_SAMPLES_PER_PIXEL * (blur_radius(settings) + 1))) + 1
    point = np.zeros((side, side))
    point[side // 2, side // 2] = 1
    for each in _kernels(settings, PSF_SAMPLES_PER_PIXEL):
        point = signal.fftconvolve(point, each, mode="same")
    found: np.ndarray = ndimage.gaussian_filter(point, settings.psf_sigma * PSF_SAMPLES_PER_PIXEL, mode="constant")
    return found.clip(min=0) / found.clip(min=0).sum()


def blur_radius(settings: Settings) -> float:
    """Radius of the optics' blur, detector px."""
    return (
        3 * settings.psf_sigma + AIRY_RINGS * settings.airy_radius + settings.defocus_radius + settings.motion_blur / 2
    )


def _kernels(settings: Settings, scale: float) -> list[np.ndarray]:
    """The kernels in use, on a grid of `scale` points per detector px, each of sum one."""
    found = []
    if first := settings.airy_radius * scale:
        found.append(_drawn(lambda x, y: airy(np.hypot(x, y), first), AIRY_RINGS * first))
    if disc := settings.defocus_radius * scale:
        found.append(_drawn(lambda x, y: (np.hypot(x, y) <= disc).astype(float), disc))
    if settings.motion_blur:
        found.append(_line(settings.motion_blur * scale, np.deg2rad(settings.motion_blur_angle)))
    return found


def airy(r: np.ndarray, first: float) -> np.ndarray:
    """Diffraction at a round aperture, `(2 J1(v) / v)²`, of radii r, with its first dark ring at `first`."""
    v = special.jn_zeros(1, 1)[0] * r / first + 1e-9
    return np.asarray((2 * special.j1(v) / v) ** 2)


def _drawn(profile: Callable[[np.ndarray, np.ndarray], np.ndarray], radius: float) -> np.ndarray:
    """A profile, integrated over the area of each grid point."""
    side = 2 * int(np.ceil(radius)) + 3
    at = (np.arange(side * KERNEL_SUBSAMPLES) + 0.5) / KERNEL_SUBSAMPLES - side / 2
    fine = profile(at[None, :], at[:, None])
    kernel = fine.reshape(side, KERNEL_SUBSAMPLES, side, KERNEL_SUBSAMPLES).mean((1, 3))
    return np.asarray(kernel / kernel.sum())


def _line(length: float, angle: float) -> np.ndarray:
    """A straight line through the centre, distributed bilinearly over the grid points."""
    side = 2 * int(np.ceil(length / 2)) + 3
    along = length * ((np.arange(2000) + 0.5) / 2000 - 0.5)
    kernel = np.zeros((side, side))
    x, y = (side // 2 + along * turn for turn in (np.cos(angle), np.sin(angle)))
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    for i, weight_x in ((left, 1 - (x - left)), (left + 1, x - left)):
        for j, weight_y in ((top, 1 - (y - top)), (top + 1, y - top)):
            np.add.at(kernel, (j, i), weight_x * weight_y / 2000)
    return kernel


def relief(settings: Settings, rng: np.random.Generator) -> np.ndarray:
    """Random hills (K, 4): x, y and width in detector px, and height, scaled so that nearness is within [0, 1].

    Raises:
        ConfigError: The hills would hide each other, or the camera does not shift.
    """
    height, width = settings.shape
    side = min(height, width)
    if settings.parallax > MAX_PARALLAX * side:
        raise ConfigError(
            f"simulate.parallax = {settings.parallax:g}: hills would hide each other; at most "
            f"{MAX_PARALLAX * side:g} px for frames of {height} x {width} px"
        )
    if not settings.max_shift:
        raise ConfigError(
            "simulate.parallax: a camera that does not shift sees none; raise simulate.max_shift, or take 0"
        )
    places = rng.uniform(-0.5, 0.5, (HILL_COUNT, 2)) * (width, height)
    hills = np.column_stack((places, side * rng.uniform(*HILL_WIDTHS, HILL_COUNT), rng.uniform(0.5, 1, HILL_COUNT)))
    y, x = (np.arange(n) - (n - 1) / 2 for n in settings.shape)
    hills[:, 3] /= nearness(hills, x, y[:, None]).max()
    return hills


def nearness(hills: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Nearness of the scene at points of frame 0: 0 is the farthest, 1 the nearest."""
    return sum(tall * np.exp(((x - at_x) ** 2 + (y - at_y) ** 2) / (-2 * wide**2)) for at_x, at_y, wide, tall in hills)


def parallax(motion: np.ndarray, hills: np.ndarray, settings: Settings) -> np.ndarray:
    """Displacement of the points where pixels look, added to the homography.

    A frame shifted by t sees a point of nearness d at `q = T p + parallax d(q) t / max_shift`. Points of the scene keep
    their nearness, so q is a fixed point, which exists as long as no hill hides another.

    Args:
        motion: (N, 3, 3), pull homographies, px.
        hills: (K, 4), see `relief`.
        settings: The camera.

    Returns:
        (N, 2, H, W), x and y, px.
    """
    found = np.zeros((len(motion), 2, *settings.shape))
    for k, T in enumerate(motion):
        at_x, at_y = sampling_points(T, settings.shape)
        toward = settings.parallax * T[:2, 2] / settings.max_shift
        near = np.zeros(settings.shape)
        for _ in range(MAX_FIXED_POINT_ITERATIONS):
            before, near = near, nearness(hills, at_x + toward[0] * near, at_y + toward[1] * near)
            if np.abs(near - before).max() < 1e-6:
                break
        found[k] = toward[:, None, None] * near
    return found


def sampling_points(
    T: np.ndarray, shape: tuple[int, int], u: float = 0.0, v: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Points x and y, px from the frame's centre, where those at (u, v) from the pixels' centres look by T alone."""
    y, x = (np.arange(n) - (n - 1) / 2 for n in shape)
    at_x, at_y, w = (row[0] * (x + u) + row[1] * (y + v)[:, None] + row[2] for row in T)
    return at_x / w, at_y / w


def dense_flow(motion: np.ndarray, shape: tuple[int, int], beside: np.ndarray | None) -> np.ndarray:
    """Displacement from each pixel to the point where it looks, (N, 2, H, W), px."""
    y, x = (np.arange(n) - (n - 1) / 2 for n in shape)
    looks = np.array(
        [np.stack(sampling_points(T, shape)) - np.stack(np.broadcast_arrays(x, y[:, None])) for T in motion]
    )
    return looks if beside is None else looks + beside


def stray_flux(settings: Settings, rng: np.random.Generator) -> np.ndarray:
    """Stray flux of each pixel, (H, W), in ranges: from zero to `settings.stray`."""
    height, width = settings.shape
    y, x = (np.arange(side) - (side - 1) / 2 for side in settings.shape)
    shape = STRAY_SHAPES[settings.stray_shape](y[:, None] / height, x / height, width / height, rng)
    shape = shape - shape.min()
    return settings.stray * shape / shape.max()


# Below, y and x are distances from the frame's centre and `wide` is the frame's width, in heights of the frame.


def smooth(y: np.ndarray, x: np.ndarray, wide: float, rng: np.random.Generator) -> np.ndarray:
    """Glow of the housing: four warm or cold spots."""
    found = np.zeros(np.broadcast_shapes(y.shape, x.shape))
    for at_y, at_x, size, warmth in zip(
        rng.uniform(-0.5, 0.5, 4),
        wide * rng.uniform(-0.5, 0.5, 4),
        rng.uniform(0.3, 0.6, 4),
        rng.choice([-1, 1], 4),
        strict=True,
    ):
        found += warmth * np.exp(-((y - at_y) ** 2 + (x - at_x) ** 2) / (2 * size**2))
    return found


def radial(y: np.ndarray, x: np.ndarray, wide: float, rng: np.random.Generator) -> np.ndarray:
    """About the optical axis: reflection of the detector in a lens (a spot), and the barrel around."""
    at_y, at_x, spot, focus = rng.uniform((-0.05, -0.05, 0.15, 0.8), (0.05, 0.05, 0.3, 1.2))
    r2 = (y - at_y) ** 2 + (x - at_x) ** 2
    barrel = 1 - (1 + r2 / focus**2) ** -2  # complement of the cos^4 falloff
    return barrel + rng.choice([-0.5, 0.5]) * np.exp(-r2 / (2 * spot**2))


def ring(y: np.ndarray, x: np.ndarray, wide: float, rng: np.random.Generator) -> np.ndarray:
    """The defocused ghost of a stop."""
    at_y, at_x, radius, blur = rng.uniform((-0.1, -0.1, 0.2, 0.04), (0.1, 0.1, 0.4, 0.08))
    return np.exp(-((np.hypot(y - at_y, x - at_x) - radius) ** 2) / (2 * blur**2))


def edge(y: np.ndarray, x: np.ndarray, wide: float, rng: np.random.Generator) -> np.ndarray:
    """The defocused reflection of the camera's body in a polariser."""
    angle, place, blur = rng.uniform((0, -0.3, 0.04), (2 * np.pi, 0.3, 0.1))
    return special.ndtr((x * np.cos(angle) + y * np.sin(angle) - place) / blur)


STRAY_SHAPES = {"smooth": smooth, "radial": radial, "ring": ring, "edge": edge}  # shapes by their name in the settings
