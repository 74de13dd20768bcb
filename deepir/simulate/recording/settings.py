"""Settings of a simulated recording."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

import numpy as np

from deepir.errors import ConfigError, nearest
from deepir.simulate.settings import MAX_SAMPLES, Settings

RECORDING_KINDS = ("drive", "walk", "pan", "tripod", "drone")  # how the camera moves
COMPRESSIONS = ("none", "mpeg4", "h264")  # codecs
FRAME_SIDE_LIMITS = (16, 2048)  # least and largest height and width of a frame, px


@dataclass(frozen=True)
class RecordingSettings:
    """The camera, its motion, and how frames are stored; zero turns an effect off.

    Magnitudes are those of 14-bit microbolometers. "Range" is `contrast`, the counts between scene values 0 and 1.
    """

    kind: str = "drive"  # drive, walk, pan, tripod, drone
    n_frames: int = 300
    shape: tuple[int, int] = (240, 320)  # height and width of a frame, px
    frame_rate: float = 30.0  # frames a second
    field_of_view: float = 45.0  # horizontal, degrees
    objects: int = 6  # cars or people that cross the view in the course of the recording
    psf_sigma: float = 0.5  # sigma of the optics' Gaussian blur, px; the pixel's box comes on top
    gain_pixel: float = 0.03  # sigma of a pixel's gain, fraction
    gain_column: float = 0.01  # sigma of a column's gain, fraction
    gain_row: float = 0.0  # sigma of a row's gain, fraction
    gain_shading: float = 0.0  # smooth (quadratic) factor of the gain, peak to peak, fraction
    offset_pixel: float = 0.027  # sigma of a pixel's offset, fraction of the range
    offset_column: float = 0.04  # sigma of a column's offset, fraction of the range
    offset_row: float = 0.027  # sigma of a row's offset, fraction of the range
    shading: float = 0.1  # smooth (quadratic) part of the offset, peak to peak, fraction of the range
    drift: float = 0.0  # rms change of the offset in the first second, fraction of the range
    drift_time: float = 0.0  # correlation time of an Ornstein-Uhlenbeck drift, s; 0: a random walk
    #: Seconds between closures of the shutter; the camera then takes what it sees of it as its new zero.
    shutter_every: float = 0.0
    shutter_residual: float = 0.1  # share of the offset's sigmas that is left after a closure
    tau_ms: float = 0.0  # thermal time constant of the pixels, ms
    substeps: int = 1  # instants for each frame at which a pixel that lags sees the scene
    read_noise: float = 0.003  # sigma of the Gaussian noise of a sample, fraction of the range
    dead_pixels: float = 0.002  # fraction of bad pixels: a third each stuck low, stuck high, flickering
    agc: bool = False  # True: an automatic gain control stretches each frame to 8 bits, uint8
    compression: str = "none"  # mpeg4 or h264: lossy, of frames of 8 bits
    bits_per_pixel: float = 1.0  # bit rate of the compressed film, bits for each pixel of a frame
    pedestal: float = 8000.0  # counts at scene value 0; a flux too: the gain acts on it
    contrast: float = 1500.0  # counts between scene values 0 and 1

    def __post_init__(self) -> None:
        for key, allowed in {"kind": RECORDING_KINDS, "compression": COMPRESSIONS}.items():
            if (name := getattr(self, key)) not in allowed:
                raise ConfigError(f"recording.{key}: '{name}' is unknown; {nearest(name, allowed)}")
        for key, value in asdict(self).items():
            if isinstance(value, int | float) and not 0 <= value < np.inf:
                raise ConfigError(f"recording.{key} = {value}: must be zero or more, and finite")
        if (
            self.n_frames < 1
            or not FRAME_SIDE_LIMITS[0] <= min(self.shape) <= max(self.shape) <= FRAME_SIDE_LIMITS[1]
        ):
            raise ConfigError(
                f"recording: at least one frame (n_frames) with sides of {FRAME_SIDE_LIMITS[0]} to "
                f"{FRAME_SIDE_LIMITS[1]} px (shape) is needed"
            )
        if (samples := math.prod((self.n_frames, *self.shape))) > MAX_SAMPLES:
            raise ConfigError(
                f"recording: {samples:.3g} samples (n_frames times shape); at most {MAX_SAMPLES:.3g} are simulated"
            )
        if not (self.frame_rate > 0 and self.contrast > 0 and 1 <= self.substeps <= 100):
            raise ConfigError(
                "recording: frame_rate and contrast must be positive, and substeps a whole number from 1 to 100"
            )
        if not 5 <= self.field_of_view <= 100:
            raise ConfigError(
                f"recording.field_of_view = {self.field_of_view:g}: 5 to 100 degrees are simulated"
            )
        if self.substeps > 1 and not self.tau_ms:
            raise ConfigError(
                "recording.substeps: only pixels that lag need more than one; set recording.tau_ms"
            )
        if self.compression != "none" and not (self.agc and self.bits_per_pixel > 0):
            raise ConfigError(
                f"recording.compression: {self.compression} takes 8 bits at a bit rate; set recording.agc to true "
                "and recording.bits_per_pixel above zero, or take compression: none"
            )
        if self.dead_pixels > 0.5:
            raise ConfigError(f"recording.dead_pixels = {self.dead_pixels:g}: a fraction up to 0.5 is needed")

    @property
    def focal(self) -> float:
        """Focal length, px."""
        return self.shape[1] / 2 / math.tan(math.radians(self.field_of_view) / 2)

    @property
    def flat(self) -> float:
        """Flux of the closed shutter, counts."""
        return self.pedestal + self.contrast / 2

    def sensor(self, offset: float = 1.0) -> Settings:
        """The same sensor as `Settings` of a burst; `offset` is a factor of its offset's sigmas."""
        same = ("shape", "gain_pixel", "gain_column", "gain_row", "gain_shading", "read_noise", "dead_pixels")
        scaled = ("offset_pixel", "offset_column", "offset_row", "shading")
        return Settings(
            n_frames=1,
            counts=True,
            pedestal=self.pedestal,
            contrast=self.contrast,
            **{key: getattr(self, key) for key in same},
            **{key: offset * getattr(self, key) for key in scaled},
        )
