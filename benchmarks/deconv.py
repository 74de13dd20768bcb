"""Deconvolution against scikit-image's, tuned on the truth, and how wide a blur is found: `make bench-deconv`.

Frames of 96 x 128 px, noise 30 dB below the blurred picture's standard deviation. The rivals are given the
point-spread function, mirrored edges, and the setting that is best on the truth; deepir is given the function or finds
its width, and nothing else. Constants were tuned on other pictures and seeds.
"""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import numpy as np
import torch
from nuc_regimes import picture
from skimage.restoration import richardson_lucy, unsupervised_wiener, wiener
from written import write

import deepir
from deepir.metrics import scores
from deepir.registry import lookup
from deepir.report.panels import write_panels
from deepir.simulate import Settings, Simulation, simulate

PICTURES = ("coffee", "rocket", "coins", "brick", "cat", "procedural 40", "procedural 41", "procedural 42")
SEED, SNR = 401, 30.0  # dB
SIGMAS = (1.0, 1.5, 2.0)  # px
PRIORS = ("tv", "tgv", "hessian")
#: A kind of blur, what the simulator is told, and the field's width.
KINDS: dict[str, tuple[dict[str, float], str, float]] = {
    "airy": ({"airy_radius": 3.0}, "radius", 3.0),
    "defocus": ({"defocus_radius": 3.0}, "radius", 3.0),
    "motion_blur": ({"motion_blur": 5.0, "motion_blur_angle": 30.0}, "length", 5.0),
}
RADIUS, MARGIN = 10, 24  # px of the kernels, and of the rivals' mirrored edges

LIFT = 0.05  # Richardson and Lucy's is for positive data
#: What a rival makes of a picture about [0, 1] and a point-spread function, with one setting after the other.
TRIED: dict[str, Callable[[np.ndarray, np.ndarray], Iterator[np.ndarray]]] = {
    "Richardson-Lucy": lambda y, psf: (
        richardson_lucy(y + LIFT, psf, num_iter=n, clip=False) - LIFT for n in (5, 10, 15, 20, 30, 40, 60, 80, 120, 200)
    ),
    "Wiener": lambda y, psf: (wiener(y, psf, balance, clip=False) for balance in np.logspace(-5, 1, 25)),
    "unsupervised Wiener": lambda y, psf: iter([unsupervised_wiener(y, psf, clip=False, rng=0)[0]]),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--picture", action="append", help="only this one")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--panels", type=Path, help="write a picture of the first burst here")
    parser.add_argument("--output", type=Path, help="write the report to this file too")
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    write(report(options), "benchmarks/deconv.py", options.output)


def report(options: argparse.Namespace) -> Iterator[str]:
    """Lines of markdown: Gaussian blur that is known and not, then other kinds."""
    pictures = options.picture or PICTURES
    yield from gaussian(pictures, options)
    yield ""
    yield from kinds(pictures)


def gaussian(pictures: tuple[str, ...], options: argparse.Namespace) -> Iterator[str]:
    """PSNR of the rivals and of deepir's priors with the blur given, and of the first prior without; its width."""
    rivals = ("Richardson-Lucy", "Wiener", "unsupervised Wiener")
    header = ["picture", "sigma", "frame", *rivals, *PRIORS, "tv less best rival", "tv, blind", "width", "seconds"]
    yield f"| {' | '.join(header)} |"
    yield "|---" * len(header) + "|"
    gains, widths = [], []
    for name in pictures:
        for sigma in SIGMAS:
            sim = frame(name, {"psf_sigma": sigma})
            given = f"{{type: gaussian, sigma: {sigma:g}, fixed: true}}"
            found = {prior: solved(sim, given, prior) for prior in PRIORS}
            blind = solved(sim, "gaussian", "tv")
            best = {kind: psnr(image, sim) for kind, image in tuned(sim, kernel("gaussian", sigma=sigma)).items()}
            quality = [psnr(result.scene, sim) for result in found.values()]
            gains.append(quality[0] - max(best.values()))
            widths.append(spread(blind.extra["psf"]) / sigma)
            cells = [psnr(sim.frames[0], sim), *(best[each] for each in rivals), *quality]
            seconds = found["tv"].metrics["seconds"]
            yield (
                f"| {name} | {sigma:g} | {' | '.join(f'{cell:.2f}' for cell in cells)} | {gains[-1]:+.2f} | "
                f"{psnr(blind.scene, sim):.2f} | {100 * (widths[-1] - 1):+.0f} % | {seconds:.1f} |"
            )
            if options.panels and len(gains) == 2:
                panels = [
                    ("frame", sim.frames[0]),
                    ("Richardson-Lucy", tuned(sim, kernel("gaussian", sigma=sigma))[rivals[0]]),
                ]
                panels += [("deepir, blind", blind.scene), ("truth", sim.truth.scene)]
                low, high = np.percentile(sim.truth.scene, [0.5, 99.5])
                write_panels(options.panels, [(title, each, low, high) for title, each in panels])
    apart = np.abs(np.array(widths) - 1)
    yield ""
    yield (
        f"tv less the best rival: {np.mean(gains):+.2f} dB in the mean, {min(gains):+.2f} at least, 0.7 or more in "
        f"{sum(gain >= 0.7 for gain in gains)} of {len(gains)}. Width: {100 * apart.mean():.0f} % off in the mean, "
        f"{100 * apart.max():.0f} % at most, 10 % or less in {int((apart <= 0.1).sum())} of {len(apart)}."
    )


def kinds(pictures: tuple[str, ...]) -> Iterator[str]:
    """PSNR for each other kind of blur: given, of that kind with its width found, and of any shape."""
    yield "| picture | blur | frame | given | width found | width | any shape | its correlation with the truth's |"
    yield "|---" * 8 + "|"
    for name in pictures:
        for kind, (camera, option, width) in KINDS.items():
            sim = frame(name, {"psf_sigma": 0.0, **camera})
            more = f", angle: {camera['motion_blur_angle']:g}" if kind == "motion_blur" else ""
            given = solved(sim, f"{{type: {kind}, {option}: {width:g}{more}, fixed: true}}", "tv")
            found, free = solved(sim, kind, "tv"), solved(sim, "simplex", "tv")
            true = given.extra["psf"]
            alike = float((true * free.extra["psf"]).sum() / np.linalg.norm(true) / np.linalg.norm(free.extra["psf"]))
            off = spread(found.extra["psf"]) / spread(true) - 1
            yield (
                f"| {name} | {kind} | {psnr(sim.frames[0], sim):.2f} | {psnr(given.scene, sim):.2f} | "
                f"{psnr(found.scene, sim):.2f} | {100 * off:+.0f} % | {psnr(free.scene, sim):.2f} | {alike:.2f} |"
            )


def frame(name: str, camera: Mapping[str, float]) -> Simulation:
    """One frame without a pattern, whose truth is sharp."""
    still = dict.fromkeys(
        ["gain_pixel", "gain_column", "offset_pixel", "offset_column", "offset_row", "shading", "dead_pixels"], 0.0
    )
    settings = Settings(n_frames=1, shape=(96, 128), sharp=True, read_noise=0.0, **still, **camera)  # type: ignore[arg-type]
    clean = simulate(picture(name), settings, seed=SEED)
    noise = float(clean.frames[0].std()) * 10 ** (-SNR / 20)
    return simulate(picture(name), dataclasses.replace(settings, read_noise=noise), seed=SEED)


def solved(sim: Simulation, psf: str, prior: str) -> deepir.Result:
    """What deepir makes of it."""
    options = [f"physics.blur.radius={RADIUS}", f"physics.blur.psf={psf}", "threads=1"]
    return deepir.run("deconv", *options, frames=sim.frames, prior=prior)


def kernel(kind: str, **options: float) -> np.ndarray:
    """A point-spread function as deepir has it."""
    side = 2 * RADIUS + 1
    field = lookup("field", kind)((1, 1, side, side), size=(96, 128), **options)
    found: np.ndarray = field().detach().numpy()[0, 0]
    return found


def tuned(sim: Simulation, psf: np.ndarray) -> dict[str, np.ndarray]:
    """Each of the rivals with the setting that is best on the truth."""
    return {name: best(name, sim.frames[0], sim.truth.scene, psf) for name in TRIED}


def best(name: str, frame: np.ndarray, truth: np.ndarray, psf: np.ndarray) -> np.ndarray:
    """What a rival makes of a frame (h, w), with the setting that is best on the truth."""
    y = frame.astype(float)
    low, span = y.min(), np.ptp(y)
    padded = np.pad((y - low) / span, MARGIN, mode="symmetric")
    inside = np.s_[MARGIN:-MARGIN, MARGIN:-MARGIN]
    images = (span * each[inside] + low for each in TRIED[name](padded, psf))
    return max(images, key=lambda image: scores(image, truth)["psnr"])


def psnr(scene: np.ndarray, sim: Simulation) -> float:
    """As it is: a single frame's level and gain are known."""
    return scores(scene, sim.truth.scene)["psnr"]


def spread(psf: np.ndarray) -> float:
    """Its standard deviation along an axis, px."""
    at = np.arange(len(psf)) - len(psf) // 2
    return float(np.sqrt((psf * (at**2 + at[:, None] ** 2)).sum() / 2))


if __name__ == "__main__":
    main()
