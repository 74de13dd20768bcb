"""What a run gives: the same arrays for every method, and the files that hold them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from deepir.config.schema import Config
from deepir.io import write_json, write_mat, write_npz, write_preview, write_tiff
from deepir.io.radiometry import KELVIN, Radiometry, unit_metadata

Array = np.ndarray[Any, Any]


@dataclass(eq=False, repr=False)
class Result:
    """Scene, sensor and motion in the input's units; what a method does not estimate is neutral.

    `scene` (H, W) float32 lies on frame 0's grid, `gain` and `offset` (h, w) on the detector's; `motion` (N, 3, 3)
    holds pull homographies in px of the scene's grid about the frame's centre, NaN for unused frames; `level` (N,).
    Where each frame has a scene of its own, `scene` is (N, H, W), each on its frame's grid.
    A dense motion is `extra["flow"]` (N, 2, h, w), from each pixel to where it looks, x and y; `motion` is then the
    homographies nearest to it.
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
    extra: dict[str, Array] = field(default_factory=dict)  # what only some problems have: stray, psf ...
    radiometry: Radiometry | None = None  # with which `extra` holds `scene_kelvin`
    uncertainty: dict[str, Array] = field(default_factory=dict)  # standard deviations of scene, gain, offset

    def __repr__(self) -> str:
        used, said = int(self.frames_used.sum()), "".join(f"\n- {message}" for message in self.messages)
        return (
            f"Result: scene {' x '.join(map(str, self.scene.shape))} of {used} frames, gain σ {self.gain.std():.3g}, "
            f"offset σ {self.offset.std():.3g}, {self.bad_pixels.sum()} bad pixels{said}"
        )

    def arrays(self) -> dict[str, Array]:
        """All arrays by name, as `result.npz` holds them."""
        names = ("scene", "gain", "offset", "motion", "level", "bad_pixels", "frames_used")
        return {name: getattr(self, name) for name in names} | self.extra

    def save(self, folder: Path, example: Array, config: Config) -> None:
        """Write all files of a finished run that `config.output` asks for; `example` is a raw frame to compare with.

        Each is replaced whole.
        """
        from deepir.report.flow import write_flow
        from deepir.report.html import write_report
        from deepir.report.panels import montage
        from deepir.report.summary import write_summary

        output = config.output
        write_npz(folder / "result.npz", self.arrays())
        if output.mat:
            write_mat(folder / "result.mat", self.arrays())
        if self.uncertainty:
            write_npz(folder / "uncertainty.npz", self.uncertainty)
        write_tiff(folder / "scene.tiff", self.scene, unit_metadata(self.radiometry))
        if "scene_kelvin" in self.extra:
            write_tiff(folder / "scene_kelvin.tiff", self.extra["scene_kelvin"], unit_metadata(KELVIN))
        write_preview(folder / "scene_preview.png", montage(self.scene), output.palette, output.tones)
        write_summary(folder / "summary.png", self, example)
        if "flow" in self.extra:
            write_flow(folder / "flow.png", self.extra["flow"], self.motion)
        write_report(folder / "report.html", self, example, config)
        write_json(folder / "metrics.json", self.metrics)


def neutral(scene: Array, n_frames: int, size: tuple[int, int], bad_pixels: Array) -> Result:
    """A result with gain one, offset zero and no motion."""
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
    """Gain mean one, offset and level mean zero, over good pixels and used frames; the prediction does not change.

    A known gain stays as it is. `flux` names what in `extra` adds to the scene's: mean zero.
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
