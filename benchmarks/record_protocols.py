"""What the benchmark of record runs: protocols, their bursts, and methods."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from nuc_regimes import CLEAN, NO_OFFSET
from record_bursts import Recorded, Simulated

Burst = Simulated | Recorded
#: What a method is called, and its settings.
Methods = Mapping[str, tuple[str, ...]]


def methods(*names: str) -> Methods:
    """Registered methods by their own names; `joint PRIOR` is deepir with that prior."""
    return {
        name: (f"prior={name.split()[1]}",) if name.startswith("joint ") else (f"method={name}",)
        for name in names
    }


DEFAULT = "joint"
CALIBRATED: Methods = {"flat_field": ("method={type: flat_field, cold: STEM_cold.npy, hot: STEM_hot.npy}",)}
RIVALS = (
    "average", "constant_statistics", "destripe_cnn", "galms", "guided_1d", "hardie2000", "hardie_droege2007",
    "irlms", "mire", "multiview_tv", "multiview_tv_recursive",
)  # fmt: skip
FINER = ("bicubic", "shift_and_add", "vdsr")  # of super-resolution
#: Told more than the burst: never a rival's figure.
TOLD = ("oracle", "flat_field", "Richardson-Lucy", "Wiener", "unsupervised Wiener")
CLASSIC = methods(DEFAULT, *RIVALS, "one_frame")
PRIORS = methods("joint tgv", "joint hessian", "joint red", "joint pnp", "joint grid")
NETWORKS = methods(
    "joint dip", "joint dip_residual", "joint deep_decoder", "joint siren", "joint fourier", "joint wire"
)
ORACLE = methods("oracle")


@dataclass(frozen=True)
class Group:
    """All combinations of methods, numbers of frames and bursts."""

    methods: Methods
    frames: tuple[int | str, ...]
    bursts: tuple[str, ...]
    config: str = "nuc"
    full: bool = False  # in the full run only


@dataclass(frozen=True)
class Protocol:
    """Bursts of one kind, and what is run on them."""

    key: str
    title: str
    bursts: Mapping[str, Burst]
    groups: tuple[Group, ...]
    #: Whether the margin of the default over the best rival is asked for.
    margin: bool = False


def looks(
    names: Mapping[str, int], camera: Mapping[str, object], settings: tuple[str, ...] = ()
) -> dict[str, Simulated]:
    """A burst of each picture, with its seed."""
    return {
        f"{name.replace(' ', '')}-{seed}": Simulated(name, seed, camera, settings)
        for name, seed in names.items()
    }


PICTURES = {"coffee": 401, "rocket": 402, "chelsea": 403, "procedural 60": 404}
MORE = {"coins": 405, "stereo_motorcycle": 406, "procedural 61": 407, "procedural 62": 408}
PAPER = {
    **CLEAN, **NO_OFFSET, "n_frames": 20, "psf_sigma": 0.0, "read_noise": 0.002, "photons": 1000.0, "max_rotation": 6.0,
    "gain_distribution": "uniform", "gain_column": 0.5, "gain_pixel": 0.0,
}  # fmt: skip


def paper() -> Protocol:
    """The 2021 paper's."""
    first, more = looks(PICTURES, PAPER), looks(MORE, PAPER)
    return Protocol(
        "a",
        "The 2021 paper's: column gain U(.5, 1), 1,000 photons, shifts +-10 px, rotations up to 6 degrees; 160 x 192 px",
        first | more,
        (Group(CLASSIC | CALIBRATED | ORACLE, (3, 5, 10), tuple(first)),),
        margin=True,
    )


def protocols() -> list[Protocol]:
    """All of them, in the page's order."""
    return [paper()]
