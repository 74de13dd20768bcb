"""The bursts of `make bench-nuc`: regimes, pictures and seeds, in two halves.

Half A is what the figures up to version 0.1.0 were of. Half B was put aside: nobody has looked at its pictures and
seeds while choosing a constant, and nobody should.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import skimage.data
from skimage.color import rgb2gray
from skimage.transform import downscale_local_mean

from deepir.simulate import Settings
from deepir.simulate.scenes.procedural import procedural, sky

SEEDS = {"A": (101, 102, 103), "B": (201, 202, 203)}
PICTURE_SIZE = (430, 500)  # px of the scenes that are drawn: twice as fine as the frames

CLEAN: dict[str, Any] = {"shading": 0.0, "dead_pixels": 0.0, "level_drift": 0.0}
UNIT: dict[str, Any] = {"photons": 1000.0, "read_noise": 0.002}
NO_OFFSET: dict[str, Any] = {"offset_pixel": 0.0, "offset_column": 0.0, "offset_row": 0.0}
COUNTS: dict[str, Any] = {"counts": True, "read_noise": 0.003}


@dataclass(frozen=True)
class Regime:
    """A camera, what it looks at in each half, and with how many frames."""

    pictures: tuple[str, str]  # of A and B: a picture of scikit-image, `procedural SEED` or `sky SEED`
    camera: Mapping[str, Any]
    frames: tuple[int, ...] = (3, 5, 10)
    #: Number of frames -> why physics forbids a small gap there.
    forbidden: Mapping[int, str] = field(default_factory=dict)

    def settings(self, n: int) -> Settings:
        """`n` frames of 160 x 192 px."""
        return Settings(n_frames=n, **(CLEAN | dict(self.camera)))

    def picture(self, half: str) -> str:
        """What the camera looks at."""
        return self.pictures["AB".index(half)]


FEW = {3: "three frames tell shading from the scene only in part"}
DRIFT = dict.fromkeys((3, 5, 10), "a slope of scene and offset and levels that follow the shifts are the same frames")
STILL = dict.fromkeys((3, 5, 10), "nothing moves along y: a row's pattern is the scene's as well")

REGIMES: dict[str, Regime] = {
    "columns 10 %": Regime(("coins", "cell"), UNIT | NO_OFFSET | {"gain_column": 0.1, "gain_pixel": 0.02}),
    "columns 30 %": Regime(
        ("rocket", "hubble_deep_field"), UNIT | NO_OFFSET | {"gain_column": 0.3, "gain_pixel": 0.02}
    ),
    "columns U(.5, 1)": Regime(
        ("procedural 20", "procedural 40"),
        UNIT | NO_OFFSET | {"gain_distribution": "uniform", "gain_column": 0.5, "gain_pixel": 0.0},
    ),
    "pixels 5 %": Regime(
        ("brick", "immunohistochemistry"), UNIT | {"gain_pixel": 0.05, "gain_column": 0.02, "max_shift": 6.0}
    ),
    "pixels 10 %": Regime(("procedural 21", "procedural 41"), UNIT | NO_OFFSET | {"gain_pixel": 0.1}),
    "rows 5 %": Regime(("procedural 22", "procedural 42"), UNIT | {"gain_row": 0.05, "offset_row": 0.05}),
    "rotation 6 deg": Regime(("coffee", "retina"), UNIT | {"gain_column": 0.05, "max_rotation": 6.0}),
    "tau 200": Regime(("chelsea", "clock"), UNIT | {"gain_column": 0.05, "gain_pixel": 0.05, "photons": 200.0}),
    "counts": Regime(("stereo_motorcycle", "procedural 43"), {"counts": True, "read_noise": 0.004}),
    "counts, strong offset, rotation": Regime(
        ("procedural 23", "procedural 44"), COUNTS | {"offset_column": 0.1, "offset_pixel": 0.1, "max_rotation": 3.0}
    ),
    # Those above are the ten of version 0.1.0.
    "counts, offsets 40-60": Regime(
        ("coffee", "procedural 49"),
        COUNTS | {"offset_pixel": 60 / 1500, "offset_column": 60 / 1500, "offset_row": 40 / 1500},
        frames=(3, 5, 10, 20),
    ),
    "shading": Regime(("rocket", "procedural 50"), UNIT | {"shading": 0.25, "gain_shading": 0.05}, forbidden=FEW),
    "dead pixels 0.5 %": Regime(
        ("chelsea", "procedural 45"), UNIT | {"dead_pixels": 0.003, "stuck_pixels": 0.001, "noisy_pixels": 0.001}
    ),
    "tau 150": Regime(("procedural 21", "immunohistochemistry"), UNIT | {"photons": 150.0}),
    "level drift 2 %": Regime(("coins", "clock"), UNIT | {"level_drift": 0.02}, forbidden=DRIFT),
    "a walker": Regime(
        ("procedural 20", "procedural 46"), UNIT | {"walker": 0.5, "walker_contrast": 0.3}, frames=(5, 10)
    ),
    "a failed frame": Regime(("stereo_motorcycle", "procedural 47"), UNIT | {"failed_frame": 2}, frames=(5, 10)),
    "sky": Regime(("sky 20", "sky 40"), UNIT),
    "sky, counts": Regime(("sky 21", "sky 41"), COUNTS),
    "jitter along x": Regime(("procedural 23", "procedural 48"), UNIT | {"jitter": "x"}, forbidden=STILL),
}
FORMER = tuple(REGIMES)[:10]


def picture(name: str) -> np.ndarray:
    """A grey picture in [0, 1], by its name in `Regime.pictures`."""
    kind, _, number = name.partition(" ")
    if number:
        return {"procedural": procedural, "sky": sky}[kind](int(number), PICTURE_SIZE)
    found = getattr(skimage.data, name)()
    grey = np.asarray(found[0] if name.startswith("stereo") else found) / 255
    grey = rgb2gray(grey) if grey.ndim == 3 else grey
    factor = max(1, min(grey.shape) // 400)  # the largest are shrunk: fine enough, and quick
    return downscale_local_mean(grey, (factor, factor)) if factor > 1 else grey
