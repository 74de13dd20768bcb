"""What a protocol of the benchmark of record is: bursts, and the methods that are run on them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from record_bursts import Recorded, Simulated
from record_deepinv import MISSING

Burst = Simulated | Recorded
Methods = Mapping[str, tuple[str, ...]]  # what a method is called, and its settings


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
    missing: tuple[str, ...] = ()  # what is left out, and why


def methods(*names: str, more: tuple[str, ...] = ()) -> Methods:
    """Registered methods by their own names; `joint PRIOR` is deepir with that prior."""
    found = {}
    for name in names:
        method, _, prior = name.partition(" ")
        found[name] = (f"method={method}", *([f"prior={prior}"] if prior else []), *more)
    return found


def looks(
    pictures: Mapping[str, int], camera: Mapping[str, object], settings: tuple[str, ...] = ()
) -> dict[str, Burst]:
    """A burst of each picture, with its seed."""
    return {
        f"{name.replace(' ', '')}-{seed}": Simulated(name, seed, camera, settings) for name, seed in pictures.items()
    }


DEFAULT = "joint"
TOLD = ("oracle", "flat_field")  # told more than the burst: never a rival's figure
STRONG = methods(DEFAULT, "hardie_droege2007", "irlms", "mire", "average", "one_frame")
WEAK = methods(
    "constant_statistics", "destripe_cnn", "galms", "guided_1d", "hardie2000", "multiview_tv", "multiview_tv_recursive",
)  # fmt: skip
CALIBRATED: Methods = {"flat_field": ('method={type: flat_field, cold: "STEM_cold.npy", hot: "STEM_hot.npy"}',)}
ORACLE = methods("oracle")
TELLING = {**CALIBRATED, **ORACLE}
ALL = {**STRONG, **WEAK, **TELLING}
PRIORS = methods("joint red", "joint tgv", "joint hessian")
NETWORKS = methods(
    "joint dip", "joint dip_residual", "joint deep_decoder", "joint grid", "joint siren", "joint fourier", "joint wire",
)  # fmt: skip

DEEPINV = ("deepinv_tv", "deepinv_dip")
WITHOUT_DEEPINV = (f"deepinv's total variation and deep image prior: {MISSING}",) if MISSING else ()
