"""A simulated burst and its truth."""

from __future__ import annotations

import functools
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from deepir.errors import ConfigError, DataError
from deepir.io import atomic_files
from deepir.simulate.detector import (
    add_defects,
    bolometer_pixels,
    expose,
    fixed_pattern,
    housing_flux,
    lagged,
    line_noise,
    rolling_readout,
    smooth_path,
    time_constants,
)
from deepir.simulate.optics import (
    blur_picture,
    dense_flow,
    draw_scene,
    homographies,
    parallax,
    psf,
    random_motion,
    relief,
    render,
    render_reference,
    stray_flux,
)
from deepir.simulate.scenes.objects import distance_from_line
from deepir.simulate.scenes.procedural import Scene, load_picture, procedural
from deepir.simulate.settings import DEFAULT_SETTINGS, Settings, settings_from_mapping

MIN_FLUX_CHANGE = 1e-4  # change of flux, in ranges, from which a sample counts as moving


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
class Simulated:
    """Frames (N, H, W), their truth, and what made them."""

    frames: np.ndarray
    truth: Any
    settings: Any
    seed: int

    def save(self, path: str | Path) -> tuple[Path, Path]:
        """Write `path` (arrays; settings as JSON) and, beside it, STEM_truth.npz (the fields of the truth).

        Returns:
            Both paths.

        Raises:
            DataError: The name does not end in .npz, or the files cannot be written.
        """
        path = Path(path)
        if path.suffix != ".npz":
            raise DataError(f"{path}: simulated data are saved as .npz")
        beside = path.with_name(f"{path.stem}_truth.npz")
        arrays = {each.name: getattr(self, each.name) for each in fields(self)}
        truth, seed, settings = (arrays.pop(name) for name in ("truth", "seed", "settings"))
        made = np.array(json.dumps({"seed": seed, **asdict(settings)}))
        with atomic_files(path, beside) as (part, part_beside):
            np.savez(part, settings=made, **arrays)
            np.savez(part_beside, **{each.name: getattr(truth, each.name) for each in fields(truth)})
        return path, beside


@dataclass(frozen=True)
class Simulation(Simulated):
    """A burst (N, H, W), float32 or uint16, and its truth."""

    truth: Truth
    settings: Settings


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
        motion = homographies(settings, smooth_path(settings, rare_rng))
        tau = time_constants(settings, rare_rng)
    gain, offset, bad = fixed_pattern(settings, pattern_rng, shading_rng)
    if settings.bolometer:
        gain, offset, slowness = bolometer_pixels(settings, bolometer_rng)
        tau = tau * slowness
    if settings.own_scenes:
        motion = np.tile(np.eye(3), (settings.n_frames, 1, 1))
        flux, static, scale = render_own_scenes(scene, settings, rare_rng)
        moving = np.zeros(flux.shape, bool)
    else:
        picture, scale = draw_scene(partial(procedural, seed) if scene is None else scene, motion, settings)
        if settings.parallax:
            beside = parallax(motion, relief(settings, rare_rng), settings)
        flux, moving, static = observe(picture, motion, scale, settings, beside, walk_rng, place_rng)
        if settings.tau:
            shown = np.stack(list(lagged(flux, 1000 / (settings.fps * settings.substeps) / tau)))
            flux, read = rolling_readout(shown, settings), slice(None, None, settings.substeps)
            motion, moving = motion[read], moving[read]
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


def render_own_scenes(
    scenes: Scene | Sequence[Scene] | None, settings: Settings, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, float]:
    """Render one frame of each scene; None: they are drawn with seeds of `rng`.

    Returns:
        Flux of each frame in ranges, (N, H, W); the same on the truth's grid; picture px per detector px of frame 0.

    Raises:
        DataError: There are fewer scenes than frames, or one is invalid or too small.
    """
    if scenes is None:
        seeds = rng.integers(2**31, size=settings.n_frames)
        scenes = [partial(procedural, int(seed)) for seed in seeds]
    scenes = list(scenes) if isinstance(scenes, Sequence) else [scenes]
    if len(scenes) < settings.n_frames:
        raise DataError(f"scene: {len(scenes)} picture(s) for {settings.n_frames} frames, each of a scene of its own")
    still = np.eye(3)[None]
    frames, fine, scales = [], [], []
    for scene in scenes[: settings.n_frames]:
        picture, scale = draw_scene(scene, still, settings)
        behind = blur_picture(picture, scale, settings)
        frames.append(render(behind, still, settings.shape, scale, settings.psf_sigma)[0])
        fine.append(render_reference(picture, scale, settings) if settings.factor > 1 else frames[-1])
        scales.append(scale)
    return np.array(frames), np.array(fine), scales[0]


def observe(
    picture: np.ndarray,
    motion: np.ndarray,
    scale: float,
    settings: Settings,
    beside: np.ndarray | None,
    walk_rng: np.random.Generator,
    place_rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Render all frames with their events.

    Args:
        picture: (height, width), the scene.
        motion: (N, 3, 3), pull homographies, px.
        scale: Picture px per detector px.
        settings: The camera.
        beside: (N, 2, H, W), parallax, px; None: none.
        walk_rng: Random stream of the walker.
        place_rng: Random stream of the other place.

    Returns:
        Flux (N, H, W) in ranges; samples that the walker changes, (N, H, W) bool; flux of frame 0 without the walker.
    """

    def seen(scene: np.ndarray, frames: slice) -> np.ndarray:
        more = None if beside is None else beside[frames]
        behind = blur_picture(scene, scale, settings)
        return render(behind, motion[frames], settings.shape, scale, settings.psf_sigma, more)

    static = seen(picture, np.s_[:])
    flux, failed = static.copy(), settings.failed_frame
    if settings.walker:
        flux_of_walker = static[0].mean() + settings.walker_contrast
        for k, cover in enumerate(walker_cover(picture.shape, scale, settings, walk_rng)):
            flux[k] = seen(picture + cover * (flux_of_walker - picture), np.s_[k : k + 1])[0]
    if failed:
        another = procedural(int(place_rng.integers(2**31)), (picture.shape[0], picture.shape[1]))
        static[failed] = flux[failed] = seen(another, np.s_[failed : failed + 1])[0]
    return flux, np.abs(flux - static) > MIN_FLUX_CHANGE, static[0]


def walker_cover(
    shape: tuple[int, ...], scale: float, settings: Settings, rng: np.random.Generator
) -> list[np.ndarray]:
    """Cover of each picture px by the walker, in [0, 1], for each frame; the path is central at half time."""
    height, width = settings.shape
    tall, way = settings.walker * height, rng.choice([-1, 1])
    middle, feet = width * rng.uniform(-0.25, 0.25), height * rng.uniform(0.2, 0.45)
    y, x = ((np.arange(n) - (n - 1) / 2) / scale for n in shape)  # px of frame 0 from its centre
    covers = []
    for k in range(settings.n_frames):
        along = middle + way * settings.walker_speed * (k - (settings.n_frames - 1) / 2)
        gait = np.cos(np.pi * settings.walker_speed * k / (0.4 * tall))  # two steps are 0.8 of one's height
        distance = person_distance((x[None, :] - along) / tall, (feet - y[:, None]) / tall, 0.18 * gait)
        covers.append(np.clip(0.5 - distance * tall * scale, 0, 1))
    return covers


def person_distance(x: np.ndarray, y: np.ndarray, stride: float) -> np.ndarray:
    """Signed distance from a person of height one who stands at (0, 0); x to the right, y up."""
    parts = (
        ((0.0, 0.93), (0.0, 0.91), 0.07),  # head
        ((0.0, 0.75), (0.0, 0.52), 0.1),
        ((0.0, 0.48), (stride, 0.05), 0.05),
        ((0.0, 0.48), (-stride, 0.05), 0.05),
    )
    distances = [distance_from_line(x, y, p, q)[0] - radius for p, q, radius in parts]
    return np.asarray(functools.reduce(np.minimum, distances))


def simulate_from_config(given: Mapping[str, Any], seed: int) -> Simulation:
    """Simulate the burst of a configuration.

    Args:
        given: `Settings` by name, `scene` and `seed`; missing or None: the default. The default scene is drawn.
        seed: Seed of the run, unless `given` has its own.

    Raises:
        ConfigError: An unknown setting, or a wrong value.
        DataError: The scene does not exist, or is too small for the frames and their motion.
    """
    settings = dict(given)
    scene, own = settings.pop("scene", None), settings.pop("seed", None)
    if own is not None and (isinstance(own, bool) or not isinstance(own, int) or own < 0):
        raise ConfigError(f"data.simulate.seed = {own!r}: a whole number, zero or more, is needed")
    name = None if scene is None else str(scene)
    changed = Path(name).stat().st_mtime_ns if name and Path(name).is_file() else 0
    camera = settings_from_mapping(settings, Settings, extra=("scene", "seed"))
    return _recorded(camera, name, seed if own is None else own, changed)


@functools.lru_cache(maxsize=2)  # a check of many configurations asks for the same burst again and again
def _recorded(settings: Settings, scene: str | None, seed: int, changed: int) -> Simulation:
    return simulate(None if scene is None else load_picture(scene), settings, seed=seed)


def truth_arrays(simulation: Simulation) -> dict[str, np.ndarray[Any, Any]]:
    """Arrays to compare a result with, float32; the scene is NaN where a walker covers frame 0."""
    found = simulation.truth
    scene = np.where(found.moving[0], np.nan, found.scene) if found.moving[0].any() else found.scene
    arrays = {"scene": scene, "gain": found.gain, "offset": found.offset, "motion": found.motion}
    arrays |= {"stray": found.stray} if simulation.settings.stray else {}
    return {name: array.astype(np.float32) for name, array in arrays.items()}
