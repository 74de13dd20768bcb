"""The protocols of the benchmark of record."""

from __future__ import annotations

from nuc_regimes import CLEAN, COUNTS, NO_OFFSET, UNIT
from real import CROP, HELD_OUT
from record_bursts import Recorded, Simulated
from record_protocol import (
    ALL,
    CALIBRATED,
    DEFAULT,
    NETWORKS,
    ORACLE,
    PRIORS,
    STRONG,
    TELLING,
    WEAK,
    Burst,
    Group,
    Protocol,
    looks,
    methods,
)  # fmt: skip
from record_single import quieter, sharper

# Nobody tunes on these pictures with these seeds.
PICTURES = {"coffee": 401, "rocket": 402, "chelsea": 403, "procedural 60": 404}
MORE = {"coins": 405, "stereo_motorcycle": 406, "procedural 61": 407, "procedural 62": 408}
NUMBERS = (3, 5, 10)


def paper() -> Protocol:
    """The 2021 paper's."""
    camera = {
        **CLEAN, **NO_OFFSET, "n_frames": 20, "max_rotation": 6.0, "photons": 1000.0, "read_noise": 0.002,
        "gain_distribution": "uniform", "gain_column": 0.5, "gain_pixel": 0.0, "psf_sigma": 0.0,
    }  # fmt: skip
    first, more = looks(PICTURES, camera), looks(MORE, camera)
    alone = methods("mire", "guided_1d", "destripe_cnn", "one_frame", more=("problem=generic",))
    return Protocol(
        "a",
        "The 2021 paper's: column gain U(.5, 1), 1,000 photons, shifts +-10 px, rotations to 6 degrees; 160 x 192",
        first | more,
        (
            Group(ALL, NUMBERS, tuple(first)),
            Group(PRIORS, (5,), tuple(first)),
            Group(alone, (1,), tuple(first), full=True),
            Group(ALL, (2, 20), tuple(first), full=True),
            Group(ALL, NUMBERS, tuple(more), full=True),
            Group(PRIORS, (3, 10), tuple(first), full=True),
            Group(NETWORKS, NUMBERS, tuple(first)[:1], full=True),
        ),
    )


NETD, NOISE = 0.05, 0.004  # K, and of the range: what a count is in kelvin
MICROBOLOMETER = {"counts": True, "n_frames": 10, "read_noise": NOISE}
KELVIN = (f"data.radiometry.scale={NETD / (NOISE * 1500):.6f}", "data.radiometry.zero=200")
H30T = {"H30T 1": 411, "H30T 2": 412, "H30T 3": 413}


def sensor() -> Protocol:
    """A realistic camera before clean thermal pictures."""
    bursts = looks(H30T, MICROBOLOMETER | {"shape": (512, 640)}, KELVIN)
    return Protocol(
        "b",
        "14-bit microbolometer of 640 x 512 px (NETD 50 mK) before thermal pictures of a DJI H30T",
        bursts,
        (
            Group({**STRONG, **CALIBRATED}, NUMBERS, tuple(bursts)),
            Group(ORACLE, (5,), tuple(bursts)),
            Group(ORACLE, (3, 10), tuple(bursts), full=True),
            Group(WEAK, NUMBERS, tuple(bursts), full=True),
        ),
    )


def small_sensor() -> Protocol:
    """The same, small: for what is slow."""
    bursts = looks(H30T, MICROBOLOMETER, KELVIN)
    first = tuple(bursts)[:1]
    return Protocol(
        "b-small",
        "The same camera with 192 x 160 px: also for priors that take more than a minute at 640 x 512",
        bursts,
        (
            Group({**STRONG, **TELLING, **PRIORS}, (5,), first),
            Group(WEAK, (5,), first, full=True),
            Group({**ALL, **PRIORS}, (5,), tuple(bursts)[1:], full=True),
            Group({**ALL, **PRIORS}, (3, 10), tuple(bursts), full=True),
            Group(NETWORKS, NUMBERS, first, full=True),
        ),
    )


def finer(factor: int) -> Protocol:
    """Super-resolution."""
    camera = {"counts": True, "dead_pixels": 0.0, "factor": factor, "shape": (64, 80), "n_frames": 16}
    pictures = {"coffee": 441, "rocket": 442, "stereo_motorcycle": 443, "procedural 60": 444}
    bursts = looks(pictures, camera, (f"physics.downsample.factor={factor}",))
    rivals = {**methods(DEFAULT, "bicubic", "shift_and_add", "vdsr"), **STRONG, **methods("oracle")}
    del rivals["one_frame"]
    everything = tuple(bursts)
    first = everything if factor == 2 else everything[:2]
    rest = everything[len(first) :]
    return Protocol(
        f"sr{factor}",
        f"Super-resolution by {factor}: 14-bit counts, 64 x 80 px",
        bursts,
        (
            Group(rivals, (16,), first, "sr"),
            *([Group(rivals, (16,), rest, "sr", full=True)] if rest else []),
            Group(rivals, (4, 8), everything, "sr", full=True),
            Group(methods("joint pnp", "joint red", "joint tgv"), (16,), everything, "sr", full=True),
            Group(WEAK, (16,), everything, "sr", full=True),
        ),
    )


def narcissus() -> Protocol:
    """Stray flux in front of the sensor."""
    cameras = {"counts": COUNTS | {"read_noise": NOISE, "pedestal": 4000.0}, "photons": UNIT}
    pictures = {"coffee": 421, "rocket": 422, "coins": 423, "procedural 60": 424}
    bursts: dict[str, Burst] = {}
    for name, camera in cameras.items():
        for strength in (0.2, 1.0, 4.0) if name == "photons" else (1.0,):
            for shape, picture in zip(("smooth", "radial", "ring", "edge"), pictures, strict=True):
                look = CLEAN | camera | {"stray": strength, "stray_shape": shape}
                seed = pictures[picture]
                bursts[f"{name}-{shape}-{strength:g}-{seed}"] = Simulated(picture, seed, look)
    first, more = tuple(bursts)[:4], tuple(bursts)[4:]
    ours, other = methods(DEFAULT, "joint red"), methods("joint tgv", "joint hessian")
    rivals = methods("hardie_droege2007", "irlms", "average") | TELLING | {"joint as nuc": ("method=joint",)}
    return Protocol(
        "narcissus",
        "Stray flux of the scene's contrast (smooth, radial, a ring, an edge): 160 x 192 px",
        bursts,
        (
            Group(ours, (5,), first, "narcissus"),
            Group(rivals, (5,), first),
            Group(ours, (5,), more, "narcissus", full=True),
            Group(rivals, (5,), more, full=True),
            Group(other, (5,), tuple(bursts), "narcissus", full=True),
        ),
    )


def real() -> Protocol:
    """Real bursts, of which no truth is known."""
    bursts: dict[str, Burst] = {
        "a65": Recorded("a65/a65_frames_000-009.npz", (f"data.crop={CROP}", "physics.warp.motion.type=affine")),
        "lepton": Recorded("lepton/lepton_tlinear_82x120x160.npz", ("data.radiometry.scale=0.01",)),
        "seek": Recorded("seek/seek_face.mat", key="raw", shutter="cal"),
    }
    kept = str([k for k in range(10) if k != HELD_OUT])
    alone = {
        **methods("one_frame", "mire", "guided_1d", "destripe_cnn", more=("problem=generic",)),
        "flat_field": ('method={type: flat_field, shutter: "STEM_shutter.npy"}', "problem=generic"),
    }
    return Protocol(
        "real",
        "Real bursts: a FLIR A65 from a car, a Lepton that stands still, one frame of a Seek",
        bursts,
        (
            Group(STRONG, (kept,), ("a65",)),
            Group({**WEAK, **PRIORS}, (kept,), ("a65",), full=True),
            Group(STRONG, (10,), ("lepton",)),
            Group(alone, (1,), ("seek",)),
        ),
    )


def protocols() -> list[Protocol]:
    """All of them, in the page's order."""
    return [paper(), sensor(), small_sensor(), finer(2), finer(4), narcissus(), sharper(), quieter(), real()]
