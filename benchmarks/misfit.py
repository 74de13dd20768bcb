"""Whether a fault of a burst is named: `make bench-misfit` draws bursts with one fault each, and without any.

    python benchmarks/misfit.py --workers 2 --output docs/benchmarks/misfit.md

Pictures and random shapes are seen by a camera with a pattern, at a strength that is drawn. Even seeds were looked at
while the messages were made, odd ones were not.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
import skimage.data
from cells import EVERYTHING, Cell, worked
from nuc_store import Arrays, code
from scipy import ndimage
from skimage.transform import resize
from written import write

import deepir
from deepir.errors import DeepIRError

#: Fault -> messages that name it; any will do.
FAULTS: dict[str, tuple[str, ...]] = {
    "none": (),
    "a gain control": (),
    "someone walks": (),
    "vibration": ("rows-displaced",),
    "rows that jitter": ("rows-displaced",),
    "interlaced": ("interlaced-frames",),
    "sub-pages": ("subpage-frames",),
    "torn": ("torn-frames",),
    "refocus": ("unsharp-frames",),
    "motion blur": ("unsharp-frames",),
    "lag": ("thermal-lag",),
    "zoom and tilt": (),  # its motion is found
    "parallax": ("parallax",),
    "drifting shading": ("shading-changes",),
    "a still part": ("still-region",),
}
NAMED = sorted({name for names in FAULTS.values() for name in names})
SIZE, FRAMES = (96, 128), 8
PICTURES = ("camera", "coffee", "astronaut", "chelsea", "rocket", "brick", "gravel", "moon", "coins", "page")
LEVEL, CONTRAST, NOISE = 8000.0, 1500.0, 5.0  # counts
STRENGTHS = (0.6, 1.5)  # from which that of a fault is drawn
SEEDS = 15

Array = np.ndarray


def picture(seed: int) -> Array:
    """A picture, or random ellipses, (400, 500), counts."""
    rng = np.random.default_rng(seed)
    if seed // 2 % 2:
        y, x = np.mgrid[:400, :500]
        image = 0.3 * np.sin(x / 97 + seed) + 0.3 * np.cos((x + y) / 61)
        for _ in range(80):
            (cy, cx), (a, b) = rng.uniform(0, (400, 500)), rng.uniform(4, 40, 2)
            image = np.where(((y - cy) / a) ** 2 + ((x - cx) / b) ** 2 < 1, rng.normal(0, 0.5), image)
        image = image + 0.3 * ndimage.gaussian_filter(rng.normal(size=image.shape), 2)
    else:
        image = getattr(skimage.data, PICTURES[seed // 4 % len(PICTURES)])().astype(float)
        image = resize(image.mean(2) if image.ndim == 3 else image, (400, 500), anti_aliasing=True)
    low, high = np.percentile(image, (0.5, 99.5))
    return LEVEL + CONTRAST * ndimage.gaussian_filter(np.clip((image - low) / (high - low), 0, 1), 0.7)


class Camera:
    """A hand-held camera before a picture; `view` is what it sees in a frame, its samples displaced."""

    def __init__(self, seed: int, rng: np.random.Generator) -> None:
        self.picture = picture(seed)
        turns = np.cumsum(rng.uniform(0.6, 1.5, FRAMES))
        steps = rng.uniform(4, 8, FRAMES)[:, None] * np.stack([np.sin(turns), np.cos(turns)], 1)
        self.at = steps.cumsum(0) - steps.cumsum(0).mean(0)
        self.speed = np.vstack([steps[1], steps[1:]])

    def view(self, k: int, down: Array | float = 0.0, across: Array | float = 0.0) -> Array:
        y, x = np.mgrid[: SIZE[0], : SIZE[1]].astype(float)
        start = (np.array(self.picture.shape) - SIZE) / 2 + self.at[k]
        return ndimage.map_coordinates(
            self.picture, [y + start[0] + down, x + start[1] + across], order=3, mode="nearest"
        )


def burst(fault: str, seed: int) -> Array:
    """Frames (N, h, w), uint16."""
    rng = np.random.default_rng([seed, *map(ord, fault)])
    camera, strength = Camera(seed, rng), rng.uniform(*STRENGTHS)
    frames = np.stack([camera.view(k) for k in range(FRAMES)])
    frames = faulty(fault, camera, frames, strength, rng)
    pattern = 40 * rng.normal(size=SIZE) + 50 * rng.normal(size=(1, SIZE[1])) + 30 * rng.normal(size=(SIZE[0], 1))
    counts = (1 + 0.03 * rng.normal(size=SIZE)) * (frames - LEVEL) + LEVEL + pattern
    counts += NOISE * rng.normal(size=frames.shape)
    if fault == "a gain control":
        counts = 5000 + (1 + 0.1 * rng.normal(size=(FRAMES, 1, 1))) * (counts - counts.mean((1, 2), keepdims=True))
    return np.clip(np.rint(counts), 0, 16383).astype(np.uint16)


def faulty(  # noqa: PLR0912 - a branch for each fault
    fault: str, camera: Camera, frames: Array, strength: float, rng: np.random.Generator
) -> Array:
    """What reaches the pixels."""
    y, x = np.mgrid[: SIZE[0], : SIZE[1]].astype(float)
    for k in range(FRAMES):
        across, down = 0.5 * strength * camera.speed[k][::-1]
        if fault == "vibration":
            phase = 2 * np.pi * (rng.uniform(2, 4) * y / SIZE[0] + rng.uniform())
            frames[k] = camera.view(k, 0.5 * strength * np.sin(phase), strength * np.cos(phase))
        elif fault == "rows that jitter":
            frames[k] = camera.view(k, 0.0, 0.5 * strength * rng.normal(size=(SIZE[0], 1)) + 0 * x)
        elif fault == "interlaced":
            frames[k] = camera.view(k, down * (y % 2), across * (y % 2))
        elif fault == "sub-pages":
            frames[k] = camera.view(k, down * ((x + y) % 2), across * ((x + y) % 2))
        elif fault == "zoom and tilt":
            v, u = y - SIZE[0] / 2, x - SIZE[1] / 2
            zoom, pitch, yaw = 0.03 * strength * rng.normal(size=3)
            scale = (1 + zoom) / (1 + pitch * v / SIZE[0] + yaw * u / SIZE[1])
            frames[k] = camera.view(k, (scale - 1) * v, (scale - 1) * u)
        elif fault == "parallax":
            depth = np.cos(x / 30 + 1) * np.sin(y / 25)
            frames[k] = camera.view(k, *(0.2 * strength * depth * each for each in camera.at[k]))
        elif fault == "refocus" and k >= FRAMES // 2:
            frames[k] = ndimage.gaussian_filter(frames[k], strength * (0.6 + 0.2 * (k - FRAMES // 2)))
        elif fault == "motion blur" and k in (2, 5):
            path = np.linspace(-0.5, 0.5, 9)
            frames[k] = np.mean([camera.view(k, down * t, across * t) for t in path], axis=0)
        elif fault == "lag" and k:
            frames[k] += 0.25 * strength * (frames[k - 1] - frames[k])
        elif fault == "drifting shading":
            glow = ndimage.gaussian_filter(rng.normal(size=SIZE), 18)
            frames[k] += 50 * strength * glow / glow.std()
        elif fault == "someone walks":
            place = (y - 50 - camera.at[k, 0]) ** 2 / 200 + (x - 20 - 7 * k - camera.at[k, 1]) ** 2 / 40
            frames[k] = np.where(place < 1, LEVEL + 1.2 * CONTRAST, frames[k])
    if fault == "torn":
        k, row = int(rng.integers(1, FRAMES)), int(rng.integers(SIZE[0] // 4, 3 * SIZE[0] // 4))
        frames[k, row:] = camera.view(k - 1)[row:]
    if fault == "a still part":
        frames[:, int(SIZE[0] * (1 - 0.2 * strength)) :] = frames[0, int(SIZE[0] * (1 - 0.2 * strength)) :]
    return frames


def measure(fault: str, seed: int) -> Arrays:
    """The messages that name a fault."""
    try:
        messages = deepir.run("nuc", frames=burst(fault, seed), threads=1).messages
        names = [each.name for each in messages if getattr(each, "name", "") in NAMED]
    except DeepIRError as error:
        names = [f"refused: {error}"]
    return {"names": np.array(names, dtype=str)}


def page(found: Mapping[Cell, Arrays], seeds: int) -> Iterator[str]:
    yield "# Faults that are named\n"
    yield (
        f"Bursts of {FRAMES} frames of {SIZE[0]} x {SIZE[1]} px, one fault each, of drawn strength, "
        f"{seeds} seeds; `nuc` by its defaults. Even seeds were looked at while the messages were made, odd ones were "
        "not. [How a fault is found](../explanation/accuracy.md#residuals-that-are-not-noise)\n"
    )
    yield "| fault | named right: even seeds | odd seeds | said otherwise |\n| --- | --- | --- | --- |"
    for fault, names in FAULTS.items():
        right, other = Counter(), Counter()
        for seed in range(seeds):
            said = found[fault, seed]["names"].tolist()
            fits = set(said) == set(names)
            right[seed % 2] += fits
            other.update([] if fits else [", ".join(said) or "nothing"])
        even, odd = (seeds + 1) // 2, seeds // 2
        words = "; ".join(f"{text} ({count})" for text, count in other.most_common())
        yield f"| {fault} | {right[0]} of {even} | {right[1]} of {odd} | {words} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=SEEDS)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    cells: list[Cell] = [(fault, seed) for fault in FAULTS for seed in range(options.seeds)]
    key = code(*EVERYTHING, "../benchmarks/misfit.py")
    found = worked("misfit", cells, measure, code=key, workers=options.workers)
    write(page(found, options.seeds), "benchmarks/misfit.py", options.output)


if __name__ == "__main__":
    main()
