"""The data of a run, in memory."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch

from deepir.arrays import Array
from deepir.arrays.samples import as_float32
from deepir.config import Data
from deepir.errors import ConfigError, DataError
from deepir.io import Frames, crop, fit_truth, read_data, read_mask, read_truth, validate
from deepir.io.frames import is_banded, select_frames, selected_in_float32, to_stack, unselected_pairs
from deepir.io.inspection.checks import (
    telemetry_message,
    telemetry_rows,
    torn_frames,
    torn_message,
    unrecorded_samples,
    unusable_frames,
)
from deepir.io.inspection.samples import (
    clipped_samples,
    drawn_message,
    drawn_pixels,
    is_contrast_stretched,
    oriented,
    saturated_samples,
)
from deepir.io.radiometry import Radiometry, resolve_radiometry
from deepir.messages import Message

Truth = Array | Mapping[str, Any]  # the scene that is known, or arrays by name
BAND_TRUTH = ("scene", "gain", "offset")  # arrays of a truth that each band has for itself
PER_FRAME_TRUTH = ("motion", "level")  # arrays of a truth with one entry for each frame


@dataclass(frozen=True)
class Burst:
    """Frames, their usable samples, and their origin.

    Attributes:
        frames: (N, h, w), float32, in the data's units.
        valid: (N, h, w) bool, finite samples.
        bad_pixels: (h, w) bool, pixels without use, masked ones included.
        source: File or origin, for messages.
        sha256: Digest of the file.
        truth: Known arrays by name: scene (h, w) or (N, h, w), gain, offset, motion ...
        radiometry: Conversion to kelvin.
        stretched: True if each frame may have a contrast of its own (automatic gain control).
        clipped: (N, h, w), 1 or -1 for samples cut off at the top or bottom of the range, else 0; None: no such sample.
        beside: (2 M, h, w), pairs of frames of the same recording outside the burst, by which its correction is scored.
        messages: Warnings on what was left out.
        bands: The other bands of frames of several, each like the first.
        motion: (N, 3, 3), known pull homographies, px, NaN for frames that are left out; None: it is registered.
        datasets: Further data sets of the problem, by name.
    """

    frames: Array
    valid: Array
    bad_pixels: Array
    source: str = "array"
    sha256: str = ""
    truth: dict[str, Array] = field(default_factory=dict)
    radiometry: Radiometry | None = None
    stretched: bool = False
    clipped: Array | None = None
    beside: Array | None = None
    messages: tuple[str, ...] = ()
    bands: tuple[Burst, ...] = ()
    motion: Array | None = None
    datasets: Mapping[str, Burst] = field(default_factory=dict)

    @property
    def size(self) -> tuple[int, int]:
        """Height and width of a frame."""
        return self.frames.shape[1], self.frames.shape[2]


def load(
    data: Data,
    *,
    frames: Array | None = None,
    truth: Truth | None = None,
    needs: int = 1,
    seed: int = 0,
    ordered: bool = False,
    are_pictures: bool = True,
) -> Burst:
    """Read or simulate the data, and check them.

    Frames without content are left out where enough others remain, unless `ordered`.

    Args:
        data: The section `data` of a configuration.
        frames: (N, h, w), or (N, C, h, w) of several bands, in place of the file.
        truth: The known scene, or arrays by name, in place of that of a file or a simulation.
        needs: Least number of frames.
        seed: Of a simulated burst.
        ordered: True: all frames are needed, in their order.
        are_pictures: Whether frames are to be registered. Else they are any samples, such as those of a single pixel,
            or of a mosaic: of any size, with NaN anywhere, and not searched for what cameras draw or lose.

    Raises:
        DataError: The files or the frames are wrong; the message says where.
        ConfigError: There are two sources, or `data.simulate` or `data.radiometry` is wrong.
    """
    known: dict[str, Array] = {}
    if data.path is not None and data.simulate is not None:
        raise ConfigError("data: give a path or simulate, not both (data.path=null or data.simulate=null)")
    if frames is not None:
        given = _array(frames)
        if is_banded(given):
            return _banded(data, given, truth, needs=needs, are_pictures=are_pictures)
        whole = oriented(to_stack(given, "frames"), data.axes, "frames")
        some, beside = selected_in_float32(whole, data.frames, "frames"), unselected_pairs(whole, data.frames)
        read = Frames(some, "frames", whole.dtype.name, "", beside=beside)
    elif data.path is not None:
        read = read_data(data, bands=True)
        if is_banded(read.frames):
            apart = data.model_copy(update={"path": None, "frames": None, "axes": None})
            found_bands = _banded(apart, read.frames, truth, needs=needs, are_pictures=are_pictures)
            return dataclasses.replace(found_bands, source=read.source, sha256=read.sha256)
    elif data.simulate is not None:
        read, known = _simulated(data, seed)
    else:
        raise DataError("data.path is missing: give the burst's file, for example data.path=burst.npz")
    stack, source, beside = read.frames, read.source, read.beside
    kelvin = resolve_radiometry(read.radiometry, data.radiometry)
    mask = read_mask(data.mask, stack.shape[1:]) if data.mask is not None else np.zeros(stack.shape[1:], bool)
    known = _truth(data, truth, known, stack)
    if data.crop is not None:
        size = mask.shape
        stack, mask = crop(stack, data.crop), crop(mask, data.crop)
        beside = None if beside is None else crop(beside, data.crop)
        # Motion is about another centre then.
        known = {k: _cropped(v, data.crop, size) for k, v in known.items() if k != "motion"}
    nothing = {} if ordered or not are_pictures else unusable_frames(stack)
    messages: tuple[str, ...] = ()
    if nothing and len(stack) - len(nothing) >= needs:
        stack, known, messages = _without(nothing, stack, known)
    valid = validate(stack, source, needs=needs, are_pictures=are_pictures)
    stretched = False
    if are_pictures:
        stretched, found_messages = _leave_out(stack, valid)
        messages = (*messages, *found_messages)
    bad = ~valid.any(0)
    if (bad | mask).all():
        raise DataError(f"{source}: the mask leaves no pixel")
    ends = None if stretched else saturated_samples(np.where(valid, stack, np.nan))
    stack = np.where(valid, stack, 0)
    return Burst(stack, valid, bad | mask, source, read.sha256, known, kelvin, stretched, ends, beside, messages)


def _leave_out(stack: Array, valid: Array) -> tuple[bool, list[str]]:
    """Whether each frame has a contrast of its own, and messages; `valid` loses what is no picture."""
    messages = []
    if rows := telemetry_rows(stack):
        valid[:, rows] = False
        messages = [telemetry_message(rows, stack.shape[1:])]
    shown = np.where(valid, stack, np.nan)
    stretched = is_contrast_stretched(shown)
    valid &= ~unrecorded_samples(shown)
    shown = np.where(valid, stack, np.nan)
    messages += torn_message(torn_frames(shown), len(shown)) + drawn_message(drawn_pixels(shown))
    if stretched:
        valid &= ~clipped_samples(shown)
    return stretched, messages


def _banded(data: Data, frames: Array, truth: Truth | None, *, needs: int, are_pictures: bool) -> Burst:
    """The first of several bands, (N, C, h, w), with the others; a truth has the bands first."""
    count = frames.shape[1]

    def of(band: int, known: Any) -> Any:
        split = isinstance(known, np.ndarray | torch.Tensor) and known.ndim == 3 and len(known) == count
        return known[band] if split else known

    def truth_of(band: int) -> Truth | None:
        if isinstance(truth, Mapping):
            per_band = {name: of(band, each) for name, each in truth.items() if name in BAND_TRUTH}
            return {**truth, **per_band}
        return of(band, truth)

    # A frame that is empty in one band stays, so that all bands have the same frames.
    options: dict[str, Any] = {"needs": needs, "ordered": True, "are_pictures": are_pictures}
    first, *others = (load(data, frames=frames[:, band], truth=truth_of(band), **options) for band in range(count))
    return dataclasses.replace(first, bands=tuple(others))


def _without(
    nothing: Mapping[int, str], stack: Array, truth: dict[str, Array]
) -> tuple[Array, dict[str, Array], tuple[str, ...]]:
    """The frames but for those that show nothing, what is known of them, and a message for each of those."""
    rest = [k for k in range(len(stack)) if k not in nothing]
    by_frame = {
        name: array[rest]
        for name, array in truth.items()
        if len(array) == len(stack) and (name in PER_FRAME_TRUTH or (name == "scene" and array.ndim == 3))
    }
    messages = tuple(
        Message("frame-empty", f"frame {k} is left out: it is {why}. Frames are counted without it")
        for k, why in nothing.items()
    )
    if rest[0]:
        messages += (
            Message(
                "reference-frame",
                f"motions and results are relative to what was frame {rest[0]}, the first that is left",
            ),
        )
    return stack[rest], truth | by_frame, messages


def _truth(data: Data, given: Truth | None, simulated: dict[str, Array], stack: Array) -> dict[str, Array]:
    """The truth of a file, of memory or of a simulation, of the frames that are selected."""
    size, known = (stack.shape[1], stack.shape[2]), simulated
    if data.truth is not None and given is not None:
        raise ConfigError("truth: give arrays or data.truth, not both")
    if data.truth is not None:
        known = read_truth(data.truth, size)
    elif given is not None:
        named = given if isinstance(given, Mapping) else {"scene": given}
        known = fit_truth({name: _array(each, f"truth[{name}]") for name, each in named.items()}, size, "truth")
    if data.frames is not None and len(scene := known.get("scene", stack)) > len(stack) and scene.ndim == 3:
        known["scene"] = select_frames(scene, data.frames, "data.truth")
    if data.frames is not None:
        by_frame = {name: known[name] for name in PER_FRAME_TRUTH if len(known.get(name, stack)) > len(stack)}
        known |= {name: select_frames(array, data.frames, "data.truth") for name, array in by_frame.items()}
    return known


def _array(frames: Any, source: str = "frames") -> Array:
    """NumPy's array of an array, a tensor, or a list of either; `DataError` where there is none."""
    try:
        if isinstance(frames, torch.Tensor):
            frames = frames.detach().cpu()
            return np.asarray(frames.float() if frames.dtype == torch.bfloat16 else frames)
        return np.asanyarray(frames)
    except (TypeError, ValueError, RuntimeError) as error:
        why = str(error).splitlines()[0]
        raise DataError(f"{source}: no array can be made of this: {why}") from None


def _simulated(data: Data, seed: int) -> tuple[Frames, dict[str, Array]]:
    """Frames that are selected of a simulated burst, and its truth."""
    from deepir.simulate.burst import simulate_from_config, truth_arrays

    simulation = simulate_from_config(data.simulate or {}, seed)
    if data.fps not in (None, simulation.settings.fps):
        raise ConfigError(f"data.fps={data.fps:g}, but data.simulate.fps={simulation.settings.fps:g}: they must agree")
    source = f"the simulated burst (seed {simulation.seed})"
    if select_frames(np.arange(len(simulation.frames)), data.frames, source)[0] != 0:
        raise ConfigError(
            f"data.frames={data.frames!r}: frame 0, on which the truth of a simulated burst lies, goes first"
        )
    stack = as_float32(select_frames(simulation.frames, data.frames, source))
    return Frames(stack, source, "float32", hashlib.sha256(stack.tobytes()).hexdigest()), truth_arrays(simulation)


def _cropped(truth: Array, box: list[int], size: tuple[int, ...]) -> Array:
    """A map of the truth cut as its frames are, whose `size` it has, or a multiple of it; anything else as it is."""
    factor = truth.shape[-2] // size[0] if truth.ndim in (2, 3) else 0
    fits = factor > 0 and truth.shape[-2:] == tuple(factor * side for side in size)
    return crop(truth, [factor * edge for edge in box]) if fits else truth
