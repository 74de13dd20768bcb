"""A camera in software: bursts with truth, `y_k = g · D B M_k x + o + l_k + n_k` (docs/conventions.md)."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np
from scipy import ndimage

from deepir.errors import ConfigError, DataError, nearest
from deepir.scenes import procedural

ADC_MAX = 16383  # 14 bits
WARP = 0.01  # largest stretch, shear and keystone (change of scale at the frame's edge)
CHOICES = {
    "motion": ("shift", "rigid", "affine", "homography"),
    "jitter": ("both", "x", "y"),
    "gain_distribution": ("normal", "uniform"),
}


@dataclass(frozen=True)
class Settings:
    """What the camera is and how it moves: magnitudes of 14-bit microbolometers; a zero turns an effect off.

    "Range" is the difference between scene values 0 and 1: one, or `contrast` counts where `counts` is true.
    """

    n_frames: int = 5  # frame 0 is the reference and does not move
    shape: tuple[int, int] = (160, 192)  # height and width of a frame, px
    scale: float | None = (
        None  # picture px per detector px, >= 1.2; None: the largest at which all frames fit
    )
    motion: str = "rigid"  # shift, rigid, affine (+ 1 % stretch and shear), homography (+ 1 % keystone)
    max_shift: float = 10.0  # shifts are uniform in +- this along each axis, px
    max_rotation: float = 0.0  # rotations about the frame's centre are uniform in +- this, degrees
    jitter: str = "both"  # axis of the shifts: both, x, y
    gain_pixel: float = 0.03  # sigma of a pixel's gain, fraction
    gain_column: float = 0.01  # sigma of a column's gain, fraction
    gain_row: float = 0.0  # sigma of a row's gain, fraction
    gain_distribution: str = (
        "normal"  # or uniform: parts are U(1 - s, 1); U(v, 1) columns: gain_column = 1 - v
    )
    offset_pixel: float = 0.027  # sigma of a pixel's offset, fraction of the range
    offset_column: float = 0.04  # sigma of a column's offset, fraction of the range
    offset_row: float = 0.027  # sigma of a row's offset, fraction of the range
    shading: float = 0.1  # smooth (quadratic) part of the offset, peak to peak, fraction of the range
    photons: float = 0.0  # photons in one range of flux at gain one (the paper's tau); 0: no photon noise
    read_noise: float = 0.003  # sigma of the Gaussian noise of a sample, fraction of the range
    level_drift: float = 0.0  # sigma of the level's random walk from frame to frame, fraction of the range
    dead_pixels: float = 0.002  # fraction of bad pixels: a third each stuck low, stuck high, flickering
    psf_sigma: float = 0.5  # sigma of the optics' Gaussian blur, detector px; the pixel's box comes on top
    counts: bool = False  # False: scene units, float32; True: 14-bit counts, rounded and clipped, uint16
    pedestal: float = 8000.0  # counts at scene value 0; a flux too: the gain acts on it
    contrast: float = 1500.0  # counts between scene values 0 and 1

    def __post_init__(self) -> None:
        for key, allowed in CHOICES.items():
            if (name := getattr(self, key)) not in allowed:
                raise ConfigError(f"simulate.{key}: '{name}' is unknown; {nearest(name, allowed)}")
        for key, value in asdict(self).items():
            if isinstance(value, int | float) and not 0 <= value < np.inf:
                raise ConfigError(f"simulate.{key} = {value}: must be zero or more, and finite")
        if self.n_frames < 1 or min(self.shape) < 8:
            raise ConfigError(
                "simulate: at least one frame (n_frames) of at least 8 x 8 px (shape) is needed"
            )
        if self.scale is not None and self.scale < 1.2:
            raise ConfigError(f"simulate.scale = {self.scale}: must be 1.2 or more: finer than the detector")
        if self.motion == "shift" and self.max_rotation:
            raise ConfigError("simulate.max_rotation: motion 'shift' does not rotate; take motion: rigid")
        if self.dead_pixels > 0.5:
            raise ConfigError(f"simulate.dead_pixels = {self.dead_pixels}: a fraction up to 0.5 is needed")

    @property
    def range(self) -> float:
        """The flux between scene values 0 and 1, in the data's units."""
        return self.contrast if self.counts else 1.0


@dataclass(frozen=True)
class Truth:
    """What made a burst: float64, in the data's units and in the gauge of docs/conventions.md."""

    scene: (
        np.ndarray
    )  # (H, W), frame 0 without pattern, level and noise (with the optics and the pixel's box)
    gain: np.ndarray  # (H, W), mean one over good pixels
    offset: np.ndarray  # (H, W), mean zero over good pixels, shading included
    level: np.ndarray  # (N,), mean zero
    motion: np.ndarray  # (N, 3, 3), px, pull, origin at the frame's centre; the first is the identity
    bad_pixels: np.ndarray  # (H, W) bool
    read_noise: float  # sigma; rounding to counts adds a variance of 1/12
    photons_per_unit: float  # photon noise has variance gain · flux / this; 0: there is none
    scale: float  # picture px per detector px


@dataclass(frozen=True)
class Simulation:
    """A burst (N, H, W), float32 or uint16, and what made it."""

    frames: np.ndarray
    truth: Truth
    settings: Settings
    seed: int

    def save(self, path: str | Path) -> tuple[Path, Path]:
        """Write `path` (frames; settings as JSON) and, beside it, STEM_truth.npz (the fields of `Truth`)."""
        path = Path(path)
        if path.suffix != ".npz":
            raise DataError(f"{path}: a simulation is saved as .npz")
        beside = path.with_name(f"{path.stem}_truth.npz")
        np.savez(path, frames=self.frames, settings=json.dumps({"seed": self.seed, **asdict(self.settings)}))
        np.savez(beside, **{field.name: getattr(self.truth, field.name) for field in fields(Truth)})
        return path, beside


def simulate(
    scene: np.ndarray | None = None, settings: Settings = Settings(), *, seed: int = 0
) -> Simulation:
    """Record a burst of a scene.

    Motion, pattern, level and noise have random streams of their own: with another noise the motion stays.

    Args:
        scene: Picture (height, width) in [0, 1], finer than the detector; None: `procedural(seed)`, twice as
            fine.
        settings: The camera and its motion.
        seed: The same seed gives the same burst.

    Raises:
        DataError: The picture is no picture, or is too small for the frames and their motion.
    """
    motion_rng, pattern_rng, level_rng, noise_rng = np.random.default_rng(seed).spawn(4)
    motion = _motion(settings, motion_rng)
    reach = _reach(motion, settings)
    if scene is None:
        height, width = np.ceil((settings.scale or 2.0) * 2 * reach).astype(int) + 5
        scene = procedural(seed, (int(height), int(width)))
    picture = np.asarray(scene, float)
    if picture.ndim != 2 or not (picture.min() >= 0 and picture.max() <= 1):
        raise DataError(
            f"scene: a picture (height, width) with values in [0, 1] is needed, not {picture.shape}"
        )
    scale = _scale(picture.shape, reach, settings)
    flux = settings.range * render(picture, motion, settings.shape, scale, settings.psf_sigma)
    flux += settings.pedestal if settings.counts else 0.0

    gain, offset, bad = _pattern(settings, pattern_rng)
    level = settings.range * settings.level_drift * np.cumsum(level_rng.standard_normal(settings.n_frames))
    truth = Truth(
        scene=flux[0],
        gain=gain,
        offset=offset,
        level=level - level.mean(),
        motion=motion,
        bad_pixels=bad > 0,
        read_noise=settings.read_noise * settings.range,
        photons_per_unit=settings.photons / settings.range,
        scale=scale,
    )
    return Simulation(_expose(flux, truth, bad, settings, noise_rng), truth, settings, seed)


def render(
    picture: np.ndarray, motion: np.ndarray, shape: tuple[int, int], scale: float, psf_sigma: float = 0.0
) -> np.ndarray:
    """What the detector's pixels collect: `D B M_k x` without pattern and noise.

    The scene is continuous: the cubic B-spline through the blurred picture. Each pixel integrates it over its
    (moved) area by Gauss-Legendre quadrature. So no grid that a reconstruction may use has made the data.

    Args:
        picture: (height, width); its centre is the centre of frame 0.
        motion: (N, 3, 3) pull homographies in detector px, origin at the frame's centre.
        shape: Height and width of a frame.
        scale: Picture px per detector px.
        psf_sigma: Gaussian blur of the optics, detector px; applied before the motion, with which it commutes
            but for stretch and keystone.

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
        for v, weight_v in zip(nodes / 2, weights / 2, strict=True):
            for u, weight_u in zip(nodes / 2, weights / 2, strict=True):
                at_x, at_y, w = (row[0] * (x + u) + row[1] * (y + v)[:, None] + row[2] for row in T)
                points = [centre_y + scale * at_y / w, centre_x + scale * at_x / w]
                sample = ndimage.map_coordinates(spline, points, order=3, mode="mirror", prefilter=False)
                frames[k] += weight_u * weight_v * sample
    return frames


def _motion(settings: Settings, rng: np.random.Generator) -> np.ndarray:
    """Homographies (N, 3, 3): shift after rotation (about the centre) after stretch, shear and keystone."""
    draws = rng.uniform(-1, 1, (settings.n_frames, 9))
    draws[0] = 0
    motion = np.tile(np.eye(3), (settings.n_frames, 1, 1))
    height, width = settings.shape
    if settings.motion == "homography":
        motion[:, 2, :2] = 2 * WARP * draws[:, 7:9] / (width, height)
    if settings.motion in ("affine", "homography"):
        motion[:, :2, :2] += WARP * draws[:, 3:7].reshape(-1, 2, 2)
    angle = np.deg2rad(settings.max_rotation) * draws[:, 2]
    move = np.tile(np.eye(3), (settings.n_frames, 1, 1))
    move[:, 0, 0] = move[:, 1, 1] = np.cos(angle)
    move[:, 1, 0], move[:, 0, 1] = np.sin(angle), -np.sin(angle)
    move[:, :2, 2] = settings.max_shift * draws[:, :2] * (settings.jitter != "y", settings.jitter != "x")
    motion = move @ motion
    return motion / motion[:, 2:, 2:]


def _reach(motion: np.ndarray, settings: Settings) -> np.ndarray:
    """How far (y, x) from the centre the frames see, detector px: their corners and three sigma of blur."""
    height, width = settings.shape
    corners = np.array([(i * width / 2, j * height / 2, 1) for i in (-1, 1) for j in (-1, 1)])
    seen = corners @ motion.mT
    reach = np.abs(seen[..., 1::-1] / seen[..., 2:]).max(axis=(0, 1))
    return reach + 3 * settings.psf_sigma


def _scale(shape: tuple[int, ...], reach: np.ndarray, settings: Settings) -> float:
    """The setting, or the largest that fits; two picture px at each side are left to the spline."""
    largest = float(np.min((np.array(shape) - 5) / (2 * reach)))
    scale = settings.scale or largest
    if scale > largest or scale < 1.2:
        need = np.ceil(2 * reach * (settings.scale or 1.2)).astype(int) + 5
        raise DataError(
            f"scene: {shape[0]} x {shape[1]} px is too small: the frames and their motion need {need[0]} x "
            f"{need[1]} px at {settings.scale or 1.2:g} picture px per detector px; "
            "take a larger picture, or less of simulate.shape, max_shift or max_rotation"
        )
    return scale


def _pattern(settings: Settings, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gain, offset (data units), defects (0 none, 1 stuck low, 2 stuck high, 3 flickering); all (H, W)."""
    height, width = settings.shape
    layout = ((height, width), (1, width), (height, 1))
    sigmas = (settings.gain_pixel, settings.gain_column, settings.gain_row)
    normal, uniform = ([draw(size) for size in layout] for draw in (rng.standard_normal, rng.random))
    parts = normal if settings.gain_distribution == "normal" else [-part for part in uniform]
    gain = np.maximum(1 + sum(s * part for s, part in zip(sigmas, parts, strict=True)), 0.05)

    sigmas = (settings.offset_pixel, settings.offset_column, settings.offset_row)
    offset = sum(s * rng.standard_normal(size) for s, size in zip(sigmas, layout, strict=True))
    y, x = np.linspace(-1, 1, height)[:, None], np.linspace(-1, 1, width)
    smooth = np.tensordot(rng.standard_normal(5), np.stack(np.broadcast_arrays(x, y, x * y, x * x, y * y)), 1)
    offset = settings.range * (offset + settings.shading * smooth / np.ptp(smooth))

    bad = np.zeros((height, width), np.uint8)
    defects = rng.permutation(bad.size)[: round(settings.dead_pixels * bad.size)]
    bad.flat[defects] = np.arange(defects.size) % 3 + 1
    good = bad == 0
    return gain / gain[good].mean(), offset - offset[good].mean(), bad


def _expose(
    flux: np.ndarray, truth: Truth, bad: np.ndarray, settings: Settings, rng: np.random.Generator
) -> np.ndarray:
    """The data of (N, H, W) flux: pattern, noise, defects, converter."""
    frames = truth.gain * flux
    if truth.photons_per_unit:
        frames = rng.poisson(np.maximum(frames, 0) * truth.photons_per_unit) / truth.photons_per_unit
    frames = (
        frames
        + truth.offset
        + truth.level[:, None, None]
        + truth.read_noise * rng.standard_normal(flux.shape)
    )
    frames += 0.3 * settings.range * (bad == 3) * rng.choice([-1, 0, 1], size=flux.shape)
    frames[:, bad == 1] = 0
    frames[:, bad == 2] = ADC_MAX if settings.counts else 2.0
    if settings.counts:
        return np.clip(np.rint(frames), 0, ADC_MAX).astype(np.uint16)
    return frames.astype(np.float32)
