"""The pictures in docs/how-to/which-prior.md: run this in the repository's root; it runs the commands of that page.

With DEEPIR_DATA it draws the real burst too.
"""

import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

import deepir
from deepir.metrics import scores
from deepir.report.panels import write_panels

HERE = Path(__file__).parent
PAGE = HERE.parent / "how-to" / "which-prior.md"
PRIORS = ("tv", "red", "tgv", "dip")
DETAIL = (slice(20, 84), slice(50, 136))
REAL = "[130,226,280,408]"  # of the A65's frames: trees before the sky


def main() -> None:
    """Write docs/images/which_prior.png, and which_prior_real.png."""
    with tempfile.TemporaryDirectory() as folder:
        commands = "\n".join(re.findall(r"^```sh\n(.*?)^```$", PAGE.read_text(), re.MULTILINE | re.DOTALL))
        path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
        environment = os.environ | {"PATH": path, "PYTHONPATH": str(HERE.parent.parent)}
        subprocess.run(commands, shell=True, check=True, cwd=folder, env=environment)
        truth = np.load(Path(folder, "burst_truth.npz"))["scene"]
        frame = np.load(Path(folder, "burst.npz"))["frames"][0].astype(float)
        scenes = {name: np.load(Path(folder, f"runs/{name}/result.npz"))["scene"] for name in PRIORS}
    low, high = np.percentile(truth, [0.5, 99.5])
    panels = [("the scene", truth[DETAIL], low, high), ("one frame", frame[DETAIL], low, high)]
    for name, scene in scenes.items():
        found = scores(scene, truth)["psnr_aligned"]
        print(f"{name}: {found:.2f} dB")
        panels.append((f"{name}: {found:.1f} dB", scene[DETAIL], low, high))
    write_panels(HERE / "which_prior.png", panels)
    if data := os.environ.get("DEEPIR_DATA"):
        write_panels(HERE / "which_prior_real.png", real(f"{data}/a65/a65_frames_000-009.npz"))


def real(path: str) -> list[tuple[str, np.ndarray, float, float]]:
    """A part of the A65's first six frames, and what each prior makes of it."""
    settings = {"path": path, "frames": 6, "crop": [int(each) for each in REAL[1:-1].split(",")]}
    found = {name: deepir.run("nuc", data=settings, prior=name).scene for name in PRIORS}
    y0, y1, x0, x1 = settings["crop"]
    frame = np.load(path)["frames"][0, y0:y1, x0:x1].astype(float)
    low, high = np.percentile(frame, [0.5, 99.5])
    return [("one frame", frame, low, high), *((name, scene, low, high) for name, scene in found.items())]


if __name__ == "__main__":
    main()
