"""Settings of the simulated cameras: of bursts, and of recordings."""

from __future__ import annotations

import functools
import math
import typing
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any, ClassVar, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, create_model

from deepir.config.components import validate
from deepir.errors import ConfigError, nearest

#: Allowed values of the settings that are names.
CHOICES = {
    "motion": ("shift", "rigid", "affine", "homography"),
    "jitter": ("both", "x", "y"),
    "gain_distribution": ("normal", "uniform"),
    "stray_shape": ("smooth", "radial", "ring", "edge"),
    "kind": ("drive", "walk", "pan", "tripod", "drone"),
    "compression": ("none", "mpeg4", "h264"),
}

#: Largest values, px: the size of the drawn scene or of the blur kernel grows with them.
MAX_LENGTHS = {"max_shift": 2000, "psf_sigma": 50, "airy_radius": 50, "defocus_radius": 50, "motion_blur": 200}
MAX_SAMPLES = 2**30  # samples of all frames: intermediate arrays then fit into a large memory
FRAME_SIDE_LIMITS = (16, 2048)  # least and largest height and width of a recording's frame, px

#: Effects and the others that each excludes.
EXCLUSIVE_EFFECTS = {
    "tau": ("walker", "failed_frame", "parallax", "own_scenes"),
    "own_scenes": ("walker", "failed_frame", "parallax"),
}


@dataclass(frozen=True)
class Sensor:
    """What both cameras have, with magnitudes of 14-bit microbolometers; zero turns an effect off.

    "Range" is the difference between scene values 0 and 1: one, or `contrast` counts in data of counts.
    """

    section: ClassVar[str]  # name of the settings in messages

    n_frames: int
    shape: tuple[int, int]  # height and width of a frame, px
    psf_sigma: float = 0.5  # sigma of the optics' Gaussian blur, detector px; the pixel's box comes on top
    gain_pixel: float = 0.03  # sigma of a pixel's gain, fraction
    gain_column: float = 0.01  # sigma of a column's gain, fraction
    gain_row: float = 0.0  # sigma of a row's gain, fraction
    gain_shading: float = 0.0  # smooth (quadratic) factor of the gain, peak to peak, fraction
    offset_pixel: float = 0.027  # sigma of a pixel's offset, fraction of the range
    offset_column: float = 0.04  # sigma of a column's offset, fraction of the range
    offset_row: float = 0.027  # sigma of a row's offset, fraction of the range
    shading: float = 0.1  # smooth (quadratic) part of the offset, peak to peak, fraction of the range
    read_noise: float = 0.003  # sigma of the Gaussian noise of a sample, fraction of the range
    dead_pixels: float = 0.002  # fraction of bad pixels: a third each stuck low, stuck high, flickering
    substeps: int = 1  # instants for each frame at which a pixel that lags sees the scene
    pedestal: float = 8000.0  # counts at scene value 0; a flux too: the gain acts on it
    contrast: float = 1500.0  # counts between scene values 0 and 1

    def __post_init__(self) -> None:
        values = asdict(self)
        for key, allowed in CHOICES.items():
            if (name := values.get(key, allowed[0])) not in allowed:
                raise ConfigError(f"{self.section}.{key}: '{name}' is unknown; {nearest(name, allowed)}")
        for key, value in values.items():
            if isinstance(value, int | float) and not 0 <= value < np.inf:
                raise ConfigError(f"{self.section}.{key} = {value}: must be zero or more, and finite")
        for key, most in MAX_LENGTHS.items():
            if (value := values.get(key, 0)) > most:
                raise ConfigError(f"{self.section}.{key} = {value}: at most {most} px")
        for key in ("gain_shading", "readout", "walker"):
            if (value := values.get(key, 0)) > 1:
                raise ConfigError(f"{self.section}.{key} = {value}: a fraction up to 1 is needed")
        if (samples := math.prod((self.n_frames, *self.shape))) > MAX_SAMPLES:
            raise ConfigError(
                f"{self.section}: {samples:.3g} samples (n_frames times shape); at most {MAX_SAMPLES:.3g} are simulated"
            )

    @property
    def range(self) -> float:
        """Flux between scene values 0 and 1, in the data's units."""
        return self.contrast


@dataclass(frozen=True)
class Settings(Sensor):
    """The camera of a burst and its motion; see `Sensor`."""

    section: ClassVar[str] = "simulate"

    n_frames: int = 5  # frame 0 is the reference and does not move
    shape: tuple[int, int] = (160, 192)
    scale: float | None = None  # picture px per detector px, >= 1.2; None: the largest at which all frames fit
    factor: int = 1  # the truth's scene is on a grid so many times finer than the detector's
    motion: str = "rigid"  # shift, rigid, affine (+ 1 % stretch and shear), homography (+ 1 % keystone)
    max_shift: float = 10.0  # shifts are uniform in +- this along each axis, px
    max_rotation: float = 0.0  # rotations about the frame's centre are uniform in +- this, degrees
    jitter: str = "both"  # axis of the shifts: both, x, y
    gain_distribution: str = "normal"  # normal, or uniform: parts are U(1 - s, 1); U(v, 1) columns: gain_column = 1 - v
    photons: float = 0.0  # photons in one range of flux at gain one (the paper's tau); 0: no photon noise
    row_noise: float = 0.0  # sigma of the row noise of each frame, fraction of the range
    column_noise: float = 0.0  # sigma of the column noise of each frame, fraction of the range
    level_drift: float = 0.0  # sigma of the level's random walk from frame to frame, fraction of the range
    stuck_pixels: float = 0.0  # fraction of pixels stuck at a value between the scene's least and largest
    noisy_pixels: float = 0.0  # fraction of pixels with ten times the noise
    walker: float = 0.0  # height of a person that walks through the scene, fraction of the frame's height
    walker_contrast: float = 0.3  # how much warmer than the scene's mean the person is, fraction of the range
    walker_speed: float = 8.0  # px that the person walks from frame to frame
    failed_frame: int = 0  # the frame of this number is of another place
    tau: float = 0.0  # thermal time constant of the pixels, ms; the camera then moves along a smooth path
    tau_pixel: float = 0.0  # sigma of a pixel's time constant, fraction
    fps: float = 60.0  # frames a second
    substeps: int = 16
    tremor: float = 8.0  # highest frequency of the smooth path, Hz
    readout: float = 0.0  # part of the time between frames that reading the rows takes, one after the other
    bolometer: bool = False  # gain, offset and tau's spread from the pixels' physics, not from the keys above
    housing_drift: float = 0.0  # flux that a warming housing adds on the axis, fraction of the range a second
    own_scenes: bool = False  # each frame is of a scene of its own, drawn or given; the camera is at rest
    parallax: float = 0.0  # px that the nearest moves more than the farthest in a frame that is shifted by max_shift
    stray: float = 0.0  # flux in front of the sensor that is not the scene's, peak to peak, of the range
    stray_shape: str = "smooth"  # or radial (about an axis), ring (a ghost), edge (a polariser's reflection)
    airy_radius: float = 0.0  # first dark ring of the optics' diffraction, 1.22 wavelengths x f-number, detector px
    defocus_radius: float = 0.0  # radius of the disc that a point out of focus is seen as, detector px
    motion_blur: float = 0.0  # px that the camera moves, straight and evenly, during the exposure of each frame
    motion_blur_angle: float = 0.0  # direction of that, from +x towards +y, degrees
    sharp: bool = False  # the truth's scene is without the optics' blur, as deconvolution is to find it
    counts: bool = False  # False: scene units, float32; True: 14-bit counts, rounded and clipped, uint16

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.n_frames < 1 or min(self.shape) < 8:
            raise ConfigError("simulate: at least one frame (n_frames) of at least 8 x 8 px (shape) is needed")
        if not 1 <= self.factor <= 8:
            raise ConfigError(f"simulate.factor = {self.factor}: a whole number from 1 to 8 is needed")
        if self.scale is not None and self.scale < self.least_scale:
            than = "finer than the detector" if self.factor == 1 else "as fine as the truth (simulate.factor)"
            raise ConfigError(f"simulate.scale = {self.scale}: must be {self.least_scale:g} or more: {than}")
        if self.motion == "shift" and self.max_rotation:
            raise ConfigError("simulate.max_rotation: motion 'shift' does not rotate; take motion: rigid")
        if (bad := self.dead_pixels + self.stuck_pixels + self.noisy_pixels) > 0.5:
            raise ConfigError(
                f"simulate.dead_pixels, stuck_pixels, noisy_pixels = {bad:g} together: a fraction up to 0.5 is needed"
            )
        if not (self.fps > 0 and 1 <= self.substeps <= 100):
            raise ConfigError("simulate: fps must be positive, and substeps a whole number from 1 to 100")
        for key, others in EXCLUSIVE_EFFECTS.items():
            other = next((each for each in others if getattr(self, each)), None)
            if getattr(self, key) and other:
                raise ConfigError(f"simulate.{key}: not together with simulate.{other}")
        if self.failed_frame >= self.n_frames:
            raise ConfigError(
                f"simulate.failed_frame = {self.failed_frame}: the frames are numbered 1 to {self.n_frames - 1}, "
                "without the reference; 0: none fails"
            )

    @property
    def least_scale(self) -> float:
        """Least picture px per detector px: finer than the detector, and at least as fine as the truth."""
        return max(1.2, self.factor)

    @property
    def range(self) -> float:
        """Flux between scene values 0 and 1, in the data's units."""
        return self.contrast if self.counts else 1.0


DEFAULT_SETTINGS = Settings()


@dataclass(frozen=True)
class RecordingSettings(Sensor):
    """The camera of a recording in counts, its motion, and how frames are stored; see `Sensor`."""

    section: ClassVar[str] = "recording"
    counts: ClassVar[bool] = True
    gain_distribution: ClassVar[str] = "normal"
    photons: ClassVar[float] = 0.0

    kind: str = "drive"  # drive, walk, pan, tripod, drone: how the camera moves
    n_frames: int = 300
    shape: tuple[int, int] = (240, 320)
    frame_rate: float = 30.0  # frames a second
    field_of_view: float = 45.0  # horizontal, degrees
    objects: int = 6  # cars or people that cross the view in the course of the recording
    drift: float = 0.0  # rms change of the offset in the first second, fraction of the range
    drift_time: float = 0.0  # correlation time of an Ornstein-Uhlenbeck drift, s; 0: a random walk
    #: Seconds between closures of the shutter; the camera then takes what it sees of it as its new zero.
    shutter_every: float = 0.0
    shutter_residual: float = 0.1  # share of the offset's sigmas that is left after a closure
    tau_ms: float = 0.0  # thermal time constant of the pixels, ms
    agc: bool = False  # True: an automatic gain control stretches each frame to 8 bits, uint8
    compression: str = "none"  # mpeg4 or h264: lossy, of frames of 8 bits
    bits_per_pixel: float = 1.0  # bit rate of the compressed film, bits for each pixel of a frame

    def __post_init__(self) -> None:
        super().__post_init__()
        least, largest = FRAME_SIDE_LIMITS
        if self.n_frames < 1 or not least <= min(self.shape) <= max(self.shape) <= largest:
            raise ConfigError(
                f"recording: at least one frame (n_frames) with sides of {least} to {largest} px (shape) is needed"
            )
        if not (self.frame_rate > 0 and self.contrast > 0 and 1 <= self.substeps <= 100):
            raise ConfigError(
                "recording: frame_rate and contrast must be positive, and substeps a whole number from 1 to 100"
            )
        if not 5 <= self.field_of_view <= 100:
            raise ConfigError(f"recording.field_of_view = {self.field_of_view:g}: 5 to 100 degrees are simulated")
        if self.substeps > 1 and not self.tau_ms:
            raise ConfigError("recording.substeps: only pixels that lag need more than one; set recording.tau_ms")
        if self.compression != "none" and not (self.agc and self.bits_per_pixel > 0):
            raise ConfigError(
                f"recording.compression: {self.compression} takes 8 bits at a bit rate; set recording.agc to true "
                "and recording.bits_per_pixel above zero, or take compression: none"
            )
        if self.dead_pixels > 0.5:
            raise ConfigError(f"recording.dead_pixels = {self.dead_pixels:g}: a fraction up to 0.5 is needed")

    @property
    def duration(self) -> float:
        """Duration of the recording, s."""
        return self.n_frames / self.frame_rate

    @property
    def focal(self) -> float:
        """Focal length, px."""
        return self.shape[1] / 2 / math.tan(math.radians(self.field_of_view) / 2)

    @property
    def flat(self) -> float:
        """Flux of the closed shutter, counts."""
        return self.pedestal + self.contrast / 2


S = TypeVar("S", bound=Sensor)


@functools.cache
def settings_schema(of: type[Sensor], extra: tuple[str, ...] = ()) -> type[BaseModel]:
    """Schema of a dataclass of settings; `extra` names further keys."""
    hints = typing.get_type_hints(of)
    known: Any = {each.name: (hints[each.name], each.default) for each in fields(of)}
    known |= dict.fromkeys(extra, (Any, None))
    return create_model("Settings", __config__=ConfigDict(extra="forbid"), **known)


def settings_from_mapping(given: Mapping[str, Any], of: type[S], extra: tuple[str, ...] = ()) -> S:
    """Settings from a mapping; None stands for the default.

    Args:
        given: Values by name.
        of: `Settings` or `RecordingSettings`.
        extra: Further keys that a user may give, for messages.

    Raises:
        ConfigError: A key is unknown, or a value is wrong.
    """
    schema = settings_schema(of, extra)  # type: ignore[arg-type]  # a class is hashable
    values = validate(schema, {key: value for key, value in given.items() if value is not None}, of.section)
    return of(**{each.name: values[each.name] for each in fields(of)})
