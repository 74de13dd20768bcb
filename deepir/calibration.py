"""A camera's fixed pattern as correction maps: from flat frames or from a run."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import ndimage

from deepir.arrays import Array
from deepir.arrays.samples import as_float32, pattern_outliers
from deepir.errors import DataError
from deepir.io import write_npz
from deepir.io.inspection.samples import FULL_SCALE_COUNTS
from deepir.io.readers.numpy_arrays import read_npz

MAX_GAIN_DEVIATION = 0.5  # deviation from the median gain, as a share of it, from which a pixel is bad
MAX_BAD_SHARE = 0.5  # share of deviating pixels from which the recordings are not flat
MAX_SATURATED_SHARE = 0.25  # share of pixels at an end of the range from which the surface is too cold or too hot


@dataclass(frozen=True)
class CorrectionMaps:
    """Gain, offset and bad pixels of a detector: frame = gain scene + offset.

    `result.npz` of a run holds such maps too.

    Attributes:
        gain: (h, w).
        offset: (h, w), in the data's units.
        bad_pixels: (h, w) bool.
    """

    gain: Array
    offset: Array
    bad_pixels: Array

    def save(self, path: Path) -> None:
        """Write the maps to an `.npz`."""
        write_npz(path, {"gain": self.gain, "offset": self.offset, "bad_pixels": self.bad_pixels})

    def correct(self, frames: Array) -> Array:
        """Correct frames; bad pixels take the mean of their neighbours.

        Args:
            frames: (..., h, w), of any type; NaN stays NaN.

        Returns:
            (..., h, w), float32.

        Raises:
            DataError: The frames are of another size.
        """
        self.check(frames)
        scale, shift = self._factors
        scene = as_float32(frames)
        scene *= scale
        scene += shift
        bad, sources, good = self._neighbours
        flat = scene.reshape(*scene.shape[:-2], -1)
        flat[..., bad] = flat[..., sources].mean(-1, where=good)
        return scene

    def check(self, frames: Array, source: str = "") -> None:
        """Check the size of frames (..., h, w).

        Raises:
            DataError: It is another than that of the maps; the message names `source`.
        """
        if frames.shape[-2:] != self.gain.shape:
            sizes = [" x ".join(map(str, shape)) for shape in (frames.shape[-2:], self.gain.shape)]
            where = source and f"{source}: "
            raise DataError(f"{where}the frames are {sizes[0]} px, the maps {sizes[1]} px: another camera, or a crop")

    def roughness_ratio(self, frame: Array) -> float:
        """Median difference between neighbouring pixels of a frame (h, w), after correction over before."""
        known = as_float32(frame)
        before, after = (np.abs(np.diff(each, axis=1)) for each in (known, self.correct(frame)))
        valid = np.isfinite(before) & np.isfinite(after)
        rough = np.median(before[valid]) if valid.any() else 0.0
        return float(np.median(after[valid]) / rough) if rough > 0 else 1.0

    @functools.cached_property
    def _factors(self) -> tuple[Array, Array]:
        gain = np.where(self.bad_pixels, 1, self.gain)
        return (1 / gain).astype(np.float32), (-self.offset / gain).astype(np.float32)

    @functools.cached_property
    def _neighbours(self) -> tuple[Array, Array, Array]:
        """Bad pixels (B,), their neighbours (B, 9), and which of these replace them: good ones, or the nearest."""
        height, width = self.gain.shape
        y, x = np.nonzero(self.bad_pixels)
        dy, dx = np.mgrid[-1:2, -1:2].reshape(2, 9)
        near_y, near_x = y[:, None] + dy, x[:, None] + dx
        inside = (near_y >= 0) & (near_y < height) & (near_x >= 0) & (near_x < width)
        near_y, near_x = near_y.clip(0, height - 1), near_x.clip(0, width - 1)
        good = inside & ~self.bad_pixels[near_y, near_x]
        isolated = ~good.any(axis=1)
        if isolated.any():
            nearest = ndimage.distance_transform_edt(self.bad_pixels, return_distances=False, return_indices=True)
            near_y[isolated], near_x[isolated] = (each[y, x][isolated, None] for each in nearest)
            good[isolated] = True
        return y * width + x, near_y * width + near_x, good


def read_maps(path: Path) -> CorrectionMaps:
    """Read maps from an `.npz` with `gain` and `offset`, or from the folder of a run.

    Raises:
        DataError: They are missing, differ in size, or no pixel has a positive gain.
    """
    file = path / "result.npz" if path.is_dir() else path
    if (found := read_npz(file)) is None:
        raise DataError(f"{file}: maps are an .npz with gain and offset, or the folder of a run")
    if missing := [name for name in ("gain", "offset") if name not in found]:
        raise DataError(f"{file}: no {' and no '.join(missing)}; maps are made by `deepir calibrate` or a run")
    gain, offset = (np.squeeze(found[name]).astype(np.float64) for name in ("gain", "offset"))
    bad = np.squeeze(found.get("bad_pixels", np.zeros(gain.shape))).astype(bool)
    if gain.ndim == 3 and gain.shape == offset.shape == bad.shape:
        raise DataError(
            f"{file}: maps of {len(gain)} bands; save gain, offset and bad pixels of one band, gain[0], as an .npz"
        )
    if gain.ndim != 2 or not gain.shape == offset.shape == bad.shape:
        raise DataError(f"{file}: gain {gain.shape}, offset {offset.shape} and bad pixels {bad.shape} differ in size")
    if "stray" in found:  # flux in front of the detector, which each pixel of it sees by its gain
        offset = offset + gain * np.squeeze(found["stray"])
    bad |= ~np.isfinite(gain) | ~np.isfinite(offset) | (gain <= 0)
    if bad.all():
        raise DataError(f"{file}: not one pixel has a gain above zero")
    return CorrectionMaps(gain, np.where(bad, 0, offset), bad)


def mean_frame(frames: Iterable[Array], source: str) -> Array:
    """Mean (h, w) of the frames of a uniform surface, float64; NaN for pixels without a value.

    Raises:
        DataError: There are no frames; the message names `source`.
    """
    total, count = None, 0
    for frame in frames:
        values = np.ma.filled(frame.astype(np.float64), np.nan)
        total = values if total is None else total + values
        count += 1
    if total is None:
        raise DataError(f"{source}: a recording without frames")
    return total / count


def maps_from_flats(flats: Sequence[Array], sources: Sequence[str] = ()) -> CorrectionMaps:
    """Maps from mean frames of uniform surfaces at different temperatures.

    One flat gives the offset, with gain one; more give both, by least squares over the flats' mean values. Over good
    pixels the gain has mean one and the offset mean zero.

    Args:
        flats: Mean frames, (h, w) each.
        sources: Their names, for messages.

    Raises:
        DataError: The flats differ in size or have the same temperature; no pixel has a value in all; or most pixels
            deviate from the others.
    """
    for k, flat in enumerate(flats):
        if flat.shape != flats[0].shape:
            sizes = [" x ".join(map(str, each.shape)) for each in (flat, flats[0])]
            raise DataError(
                f"{sources[k] if sources else f'flat {k}'}: flat frames differ in size: {sizes[0]} px and {sizes[1]}"
            )
    stack = np.stack(flats)
    known = np.isfinite(stack).all(axis=0)
    if not known.any():
        raise DataError("no pixel has a value in all of the flat frames")
    known &= ~_saturated(stack)
    stack = np.where(known, stack, np.median(stack[:, known], axis=1)[:, None, None])
    levels = np.median(stack, axis=(1, 2))
    gain = np.ones(stack.shape[1:])
    if len(flats) > 1:
        deviations = levels - levels.mean()
        variance = (deviations**2).sum()
        if variance <= (1e-3 * np.abs(levels).max()) ** 2:
            raise DataError(f"the flat frames are at {levels[0]:g} and {levels[-1]:g}: two temperatures are needed")
        gain = np.tensordot(deviations, stack - stack.mean(axis=0), 1) / variance
    offset = stack.mean(axis=0) - gain * levels.mean()
    bad = ~known | (np.abs(gain - 1) > MAX_GAIN_DEVIATION)
    for each in (gain, offset):
        bad = bad | pattern_outliers(each, ~bad)
    if bad.mean() > MAX_BAD_SHARE:
        raise DataError(
            f"{100 * bad.mean():.0f}% of the pixels answer unlike the others: flat recordings show something uniform, "
            "such as a shutter or a wall; of a scene that moves, give one burst with --burst"
        )
    scale = gain[~bad].mean()
    gain, shift = gain / scale, offset[~bad].mean()
    return CorrectionMaps(gain.astype(np.float32), (offset - shift * gain).astype(np.float32), bad)


def _saturated(flats: Array) -> Array:
    """Pixels (h, w), bool, that are zero or at full scale in all flats (N, h, w), where these are a minority."""
    ends = {0, *FULL_SCALE_COUNTS} & {np.nanmin(flats), np.nanmax(flats)}
    found = [(flats == end).all(axis=0) for end in ends]
    few = [each for each in found if each.mean() < MAX_SATURATED_SHARE]
    return np.logical_or.reduce(few) if few else np.zeros(flats.shape[1:], bool)
