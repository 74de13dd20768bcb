"""The benchmark of record's protocols of one frame: deconvolution and denoising, beside scikit-image and deepinv."""

from __future__ import annotations

from nuc_regimes import NO_OFFSET
from record_bursts import Simulated
from record_deepinv import MISSING
from record_methods import PEERS
from record_protocol import DEEPINV, DEFAULT, PRIORS, WITHOUT_DEEPINV, Burst, Group, Protocol, looks, methods


def sharper() -> Protocol:
    """Deconvolution of one frame."""
    still = dict.fromkeys(("gain_pixel", "gain_column", "shading", "dead_pixels"), 0.0) | NO_OFFSET
    pictures = {"coffee": 431, "rocket": 432, "coins": 433, "procedural 60": 434}
    bursts: dict[str, Burst] = {}
    groups: list[Group] = []
    for sigma in (1.5, 1.0, 2.0):
        camera = still | {"n_frames": 1, "shape": (96, 128), "sharp": True, "read_noise": 0.006, "psf_sigma": sigma}
        these = {
            f"{name}-{sigma:g}": Simulated(look.picture, look.seed, look.camera)
            for name, look in looks(pictures, camera).items()
        }
        bursts |= these
        kernel = f"physics.blur.psf={{type: gaussian, sigma: {sigma:g}, fixed: true}}"
        radius = "physics.blur.radius=10"
        ours = methods(DEFAULT, *PRIORS, more=(kernel, radius)) | {"joint blind": ("method=joint", radius)}
        peers = [*PEERS, *([] if MISSING else DEEPINV)]
        theirs = {name: (f"method={{type: {name}, sigma: {sigma:g}}}",) for name in peers}
        whole = {**ours, **theirs, **methods("one_frame")}
        groups.append(Group(whole, (1,), tuple(these), "deconv", full=sigma != 1.5))
    return Protocol(
        "deconvolution",
        "One frame of 96 x 128 px behind a Gaussian blur of 1.5 px (all: 1, 1.5 and 2) that is known",
        bursts,
        tuple(groups),
        WITHOUT_DEEPINV,
    )


def quieter() -> Protocol:
    """Denoising of one frame."""
    still = dict.fromkeys(("gain_pixel", "gain_column", "shading", "dead_pixels", "psf_sigma"), 0.0) | NO_OFFSET
    camera = still | {"n_frames": 1, "shape": (96, 128), "read_noise": 0.05}
    bursts = looks({"coffee": 451, "rocket": 452, "coins": 453, "procedural 60": 454}, camera)
    known = ("problem=generic", "physics.sensor.gain=1.0", "physics.sensor.offset=0.0", "physics.sensor.level=0.0")
    peers = methods("one_frame", *([] if MISSING else DEEPINV), more=known[:1])
    return Protocol(
        "denoising",
        "One frame of 96 x 128 px, noise of 5 % of the range, no pattern",
        bursts,
        (Group({**methods(DEFAULT, *PRIORS, more=known), **peers}, (1,), tuple(bursts)),),
        WITHOUT_DEEPINV,
    )
