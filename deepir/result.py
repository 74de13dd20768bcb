"""The result of a run, and its comparison with the truth."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch

from deepir.arrays import Array
from deepir.burst import Burst
from deepir.config.schema import Config, Output
from deepir.errors import DataError
from deepir.io import write_json, write_mat, write_npz, write_preview, write_tiff
from deepir.io.radiometry import KELVIN, Radiometry, unit_metadata
from deepir.messages import Message
from deepir.metrics import motion_error, scores
from deepir.operators.warp import rescale_motion
from deepir.paths import expanded


def compare_to_truth(result: Result, burst: Burst) -> dict[str, float | None]:
    """Scores of the scene and errors of gain, offset, stray flux and motion, as far as the truth has them.

    Returns:
        Root mean square errors by name: of maps over good pixels, in the data's units; of the motion in px of a frame.
        With a radiometry, `radiometric_rmse_mk` is the scene's error without its mean, mK. Empty, with a message of the
        result, if the scene's shape differs from the truth's.
    """
    truth = burst.truth
    if "scene" not in truth:
        return {}
    if truth["scene"].shape != result.scene.shape:
        result.messages.append(
            Message(
                "truth-not-compared",
                f"data.truth: the scene is {truth['scene'].shape}, the result {result.scene.shape}: not compared",
            )
        )
        return {}
    bound = result.extra.get("clipped", np.zeros((), np.int8)) != 0  # of which the frames do not show more
    known = np.where(bound, np.nan, truth["scene"])
    found: dict[str, float | None] = {k: float(v) for k, v in scores(result.scene, known).items()}
    if burst.radiometry is not None:
        kelvin = [burst.radiometry.kelvin(each).astype(float) for each in (result.scene, known)]
        found["radiometric_rmse_mk"] = 1000 * float(np.nanstd(kelvin[0] - kelvin[1]))
    maps = {"gain": result.gain, "offset": result.offset, "stray": result.extra.get("stray")}
    for name, array in maps.items():
        if array is not None and name in truth and truth[name].shape == array.shape:
            off = (array - truth[name])[~result.bad_pixels]
            found[f"{name}_rmse"] = float(np.sqrt(np.mean(off.astype(float) ** 2)))
    if "motion" in truth and truth["motion"].shape == result.motion.shape:
        coarser = np.divide(burst.size, result.scene.shape[-2:])
        motion = rescale_motion(torch.from_numpy(result.motion), coarser).numpy()
        error = motion_error(motion, truth["motion"], burst.size)
        found["motion_rmse"] = None if math.isnan(error) else error
    return found


@dataclass(eq=False, repr=False)
class Result:
    """Scene, sensor and motion in the input's units; estimates that a method does not make are neutral.

    Attributes:
        scene: (H, W), float32, on frame 0's grid; (N, H, W) where each frame has a scene of its own. Of several bands,
            scene, gain, offset, level and bad pixels have the bands first, (C, H, W).
        gain: (h, w).
        offset: (h, w).
        motion: (N, 3, 3), pull homographies in px of the scene's grid about the centre; NaN for unused frames.
        level: (N,), offset of each frame.
        bad_pixels: (h, w) bool.
        frames_used: (N,) bool.
        metrics: Figures by name.
        history: One entry for each iteration: stage, loss ...
        messages: Warnings.
        extra: Arrays of some problems: stray, psf ...; a dense motion is `flow` (N, 2, h, w), from each pixel to the
            point where it looks, x and y, px. `motion` is then the nearest homographies.
        radiometry: Conversion to kelvin; `extra` then holds `scene_kelvin`.
        uncertainty: Standard deviations of scene, gain and offset; with `uncertainty.samples` of all unknowns.
        example: (h, w), a raw frame to compare with; None for a result without a run.
        config: The configuration of the run; None for a result without a run.
    """

    scene: Array
    gain: Array
    offset: Array
    motion: Array
    level: Array
    bad_pixels: Array
    frames_used: Array
    metrics: dict[str, Any] = field(default_factory=dict)
    history: list[dict[str, Any]] = field(default_factory=list)
    messages: list[str] = field(default_factory=list)
    extra: dict[str, Array] = field(default_factory=dict)
    radiometry: Radiometry | None = None
    uncertainty: dict[str, Array] = field(default_factory=dict)
    example: Array | None = None
    config: Config | None = None

    def __repr__(self) -> str:
        used, warnings = int(self.frames_used.sum()), "".join(f"\n- {message}" for message in self.messages)
        return (
            f"Result: scene {' x '.join(map(str, self.scene.shape))} of {used} frames, gain σ {self.gain.std():.3g}, "
            f"offset σ {self.offset.std():.3g}, {self.bad_pixels.sum()} bad pixels{warnings}"
        )

    def arrays(self) -> dict[str, Array]:
        """All arrays by name, as in `result.npz`."""
        names = ("scene", "gain", "offset", "motion", "level", "bad_pixels", "frames_used")
        return {name: getattr(self, name) for name in names} | self.extra

    def tensors(self, like: torch.Tensor) -> dict[str, torch.Tensor]:
        """All arrays by name as tensors, on the device of `like`; real ones in its dtype, if that is real."""
        found = {name: torch.as_tensor(array, device=like.device) for name, array in self.arrays().items()}
        both = like.is_floating_point()
        return {n: each.to(like.dtype) if both and each.is_floating_point() else each for n, each in found.items()}

    def save(self, folder: str | os.PathLike[str]) -> None:
        """Write the files of a finished run that `config.output` asks for, each atomically.

        A result without a run has no `report.html` and no `summary.png`.

        Args:
            folder: It is made if it is not there; files of the same names are replaced.

        Raises:
            DataError: A file cannot be written.
        """
        from deepir.report.html import write_report
        from deepir.report.panels import montage, write_flow, write_summary

        config = self.config
        output, folder = config.output if config else Output(), expanded(folder)
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise DataError(f"{folder}: the folder cannot be made: {error.strerror or error}") from None
        arrays, unit = self.arrays(), unit_metadata(self.radiometry)
        files: list[tuple[Callable[..., None], str, tuple[Any, ...]]] = [
            (write_npz, "result.npz", (arrays,)),
            (write_tiff, "scene.tiff", (self.scene, unit)),
            (write_preview, "scene_preview.png", (montage(self.scene), output.palette, output.tones)),
        ]
        if self.example is not None:
            files.insert(0, (write_summary, "summary.png", (self, self.example)))
            if config is not None:
                files.insert(1, (write_report, "report.html", (self, self.example, config)))
        if output.mat:
            files.append((write_mat, "result.mat", (arrays,)))
        if self.uncertainty:
            files.append((write_npz, "uncertainty.npz", (self.uncertainty,)))
        if "scene_kelvin" in self.extra:
            kelvin = self.extra["scene_kelvin"], unit_metadata(KELVIN)
            files.append((write_tiff, "scene_kelvin.tiff", kelvin))
        if "flow" in self.extra:
            files.append((write_flow, "flow.png", (self.extra["flow"], self.motion)))
        with ThreadPoolExecutor() as pool:  # one compresses while another waits for the disk
            written = [pool.submit(write, folder / name, *what) for write, name, what in files]
            for each in written:
                each.result()
        write_json(folder / "metrics.json", self.metrics)


def neutral(scene: Array, n_frames: int, size: tuple[int, int], bad_pixels: Array) -> Result:
    """A result with gain one, offset zero and no motion.

    Args:
        scene: (H, W) or (N, H, W).
        n_frames: Number of frames of the burst.
        size: Height and width of a frame.
        bad_pixels: (h, w) bool.
    """
    return Result(
        scene=scene.astype(np.float32),
        gain=np.ones(size, np.float32),
        offset=np.zeros(size, np.float32),
        motion=np.tile(np.eye(3), (n_frames, 1, 1)),
        level=np.zeros(n_frames, np.float32),
        bad_pixels=bad_pixels,
        frames_used=np.ones(n_frames, bool),
    )


def to_gauge(result: Result, *, known_gain: bool = False, flux: Sequence[str] = ()) -> None:
    """Fix the gauge: gain mean one, offset and level mean zero, over good pixels and used frames.

    The prediction does not change.

    Args:
        result: Is changed in place.
        known_gain: True: the gain stays as it is.
        flux: Names in `extra` of fluxes that add to the scene; their means become zero.
    """
    good = ~result.bad_pixels
    mean = 1.0 if known_gain else result.gain[good].mean(dtype=np.float64)
    result.gain, result.scene = result.gain / mean, result.scene * mean
    for name in flux:
        stray = result.extra[name] * mean
        level = stray[good].mean(dtype=np.float64)
        result.extra[name], result.scene = (stray - level).astype(np.float32), result.scene + level
    drift = np.nanmean(np.where(result.frames_used, result.level, np.nan))
    result.level, result.offset = result.level - drift, result.offset + drift
    shift = result.offset[good].mean(dtype=np.float64)
    result.scene, result.offset = result.scene + shift, result.offset - shift * result.gain
    for name in ("scene", "gain", "offset", "level"):
        setattr(result, name, getattr(result, name).astype(np.float32))
