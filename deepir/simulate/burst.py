"""A simulated burst and its truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np

from deepir.simulate.detector import (
    add_defects,
    apply_lag,
    bolometer_pixels,
    expose,
    fixed_pattern,
    housing_flux,
    line_noise,
    smooth_path,
    time_constants,
)
from deepir.simulate.files import save_with_truth
from deepir.simulate.optics.blur import psf
from deepir.simulate.optics.parallax import dense_flow, parallax, relief, stray_flux
from deepir.simulate.optics.rendering import (
    draw_scene,
    homographies,
    picture_scale,
    random_motion,
    render_reference,
    visible_reach,
)
from deepir.simulate.scenes.procedural import Scene, procedural
from deepir.simulate.settings import DEFAULT_SETTINGS, Settings
from deepir.simulate.views import observe, render_own_scenes


@dataclass(frozen=True)
class Truth:
    """Everything that made a burst: float64, in the data's units and in the gauge of docs/reference/conventions.md."""

    #: Frame 0 without pattern, stray flux, level, noise and walker, on a grid `factor` times as fine; with the pixel's
    #: box and, unless `sharp`, the optics.
    scene: np.ndarray  # (Q H, Q W); with own_scenes each frame, (N, Q H, Q W)
    gain: np.ndarray  # (H, W), mean one over good pixels, shading included
    offset: np.ndarray  # (H, W), mean zero over good pixels, shading included
    level: np.ndarray  # (N,), mean zero
    rows: np.ndarray  # (N, H), row noise of each frame
    columns: np.ndarray  # (N, W), column noise of each frame
    stray: np.ndarray  # (H, W), mean zero over good pixels; its mean is part of the scene
    motion: np.ndarray  # (N, 3, 3), px, pull, origin at the frame's centre; the first is the identity
    flow: np.ndarray  # (N, 2, H, W), px, x and y from each pixel to its point of frame 0: motion and parallax
    tau: np.ndarray  # (H, W), time constant of each pixel, ms; zero: no lag
    housing: np.ndarray  # (N, H, W), flux of the housing above that of the first frame
    bad_pixels: np.ndarray  # (H, W) bool
    moving: np.ndarray  # (N, H, W) bool: samples whose flux the walker changes, by 1e-4 of the range or more
    failed: np.ndarray  # (N,) bool: frames of another place
    read_noise: float  # sigma; rounding to counts adds a variance of 1/12
    photons_per_unit: float  # photon noise has variance gain · flux / this; 0: there is none
    scale: float  # picture px per detector px; with own_scenes of frame 0's picture
    psf: np.ndarray  # (K, K), the optics alone, five points per detector px, sum one


@dataclass(frozen=True)
class Simulation:
    """A burst (N, H, W), float32 or uint16, and its truth."""

    frames: np.ndarray
    truth: Truth
    settings: Settings
    seed: int

    def save(self, path: str | Path) -> tuple[Path, Path]:
        """Write `path` (frames; settings as JSON) and, beside it, STEM_truth.npz (the fields of `Truth`).

        Returns:
            Both paths.

        Raises:
            DataError: The name does not end in .npz.
        """
        settings = {"seed": self.seed, **asdict(self.settings)}
        return save_with_truth(Path(path), self.truth, settings, frames=self.frames)


def simulate(
    scene: Scene | Sequence[Scene] | None = None, settings: Settings = DEFAULT_SETTINGS, *, seed: int = 0
) -> Simulation:
    """Record a burst of a scene, or with `own_scenes` a frame of each of several.

    Motion, pattern, level, noise and every optional effect have independent random streams: another noise leaves the
    motion unchanged.

    Args:
        scene: Picture (height, width) in [0, 1], finer than the detector; or a function that draws one of a given
            shape, twice as fine as the truth's scene. None: `procedural(seed)`. With `own_scenes` one for each frame,
            or None.
        settings: The camera and its motion.
        seed: The same seed gives the same burst.

    Raises:
        DataError: A picture is invalid, too small for the frames and their motion, or there are too few.
    """
    # A new effect takes a new stream at the end: those before it stay as they are.
    streams = np.random.default_rng(seed).spawn(11)
    motion_rng, pattern_rng, level_rng, noise_rng, shading_rng, defects_rng, walk_rng, place_rng = streams[:8]
    # Of lag, parallax, own scenes and stray flux there is mostly one.
    rare_rng, bolometer_rng, lines_rng = streams[8:]
    motion, tau, beside = random_motion(settings, motion_rng), np.zeros(settings.shape), None
    if settings.tau:
        motion, tau = (
            homographies(settings, smooth_path(settings, rare_rng)),
            time_constants(settings, rare_rng),
        )
    gain, offset, bad = fixed_pattern(settings, pattern_rng, shading_rng)
    if settings.bolometer:
        gain, offset, slowness = bolometer_pixels(settings, bolometer_rng)
        tau = tau * slowness
    if settings.own_scenes:
        motion = np.tile(np.eye(3), (settings.n_frames, 1, 1))
        flux, static, scale = render_own_scenes(scene, settings, rare_rng)
        moving = np.zeros(flux.shape, bool)
    else:
        reach = visible_reach(motion, settings)
        picture = draw_scene(partial(procedural, seed) if scene is None else scene, reach, settings)
        scale = picture_scale(picture.shape, reach, settings)
        if settings.parallax:
            beside = parallax(motion, relief(settings, rare_rng), settings)
        flux, moving, static = observe(picture, motion, scale, settings, beside, walk_rng, place_rng)
        if settings.tau:
            flux, motion, moving = (
                apply_lag(flux, tau, settings),
                motion[:: settings.substeps],
                moving[:: settings.substeps],
            )
        if settings.factor > 1 or settings.sharp:
            static = render_reference(picture, scale, settings)
    dark = settings.pedestal if settings.counts else 0.0
    warmth = housing_flux(settings)
    flux, static = settings.range * flux + dark + warmth, settings.range * static + dark

    bad = add_defects(bad, settings, defects_rng)
    gain, offset = gain / gain[bad == 0].mean(), offset - offset[bad == 0].mean()
    stray = settings.range * stray_flux(settings, rare_rng)
    flux, static, stray = flux + stray, static + stray[bad == 0].mean(), stray - stray[bad == 0].mean()
    level = settings.range * settings.level_drift * np.cumsum(level_rng.standard_normal(settings.n_frames))
    level -= level.mean()
    rows, columns = line_noise(settings, lines_rng)
    failed = np.arange(settings.n_frames) == (settings.failed_frame or -1)
    truth = Truth(
        scene=static,
        gain=gain,
        offset=offset,
        level=level,
        rows=rows,
        columns=columns,
        stray=stray,
        motion=motion,
        flow=dense_flow(motion, settings.shape, beside),
        tau=tau,
        housing=warmth,
        bad_pixels=bad > 0,
        moving=moving,
        failed=failed,
        read_noise=settings.read_noise * settings.range,
        photons_per_unit=settings.photons / settings.range,
        scale=scale,
        psf=psf(settings),
    )
    jumps = rows[:, :, None] + columns[:, None]
    frames = expose(flux, gain, offset + jumps, level, bad, settings, noise_rng, defects_rng)
    return Simulation(frames, truth, settings, seed)
