"""Whether films of one camera, each of another scene, tell the same shading: `python benchmarks/same_optics.py`.

The makers of the films of `tensoristd` have corrected their pixels, and no truth of a shading is known. What different
scenes agree on is the camera's. `DEEPIR_DATA` names the folder of the data (default ../shared/data).
"""

from __future__ import annotations

import numpy as np
from recordings_cases import DATA
from recordings_scores import parts

import deepir

FILMS = ("sequence1", "sequence5", "sequence8", "sequence9")


def main() -> None:
    """Print the correlation of the low-order parts of each two films, and of the halves of each."""
    low, halves = {}, {}
    for name in FILMS:
        frames = np.load(DATA / "tensoristd" / f"{name}.npz")["frames"]
        middle = len(frames) // 2
        low[name], *pair = (
            parts(deepir.correct(each).estimate.offset)[0].ravel()
            for each in (frames, frames[:middle], frames[middle:])
        )
        halves[name] = np.corrcoef(pair)[0, 1]
    found = np.corrcoef(list(low.values()))
    print("| film | deviation | its halves | " + " | ".join(FILMS) + " |\n|---|---|---|" + "---|" * len(FILMS))
    for name, row in zip(FILMS, found, strict=True):
        shown = " | ".join(f"{each:.2f}" for each in row)
        print(f"| {name} | {low[name].std():.1f} | {halves[name]:.2f} | {shown} |")


if __name__ == "__main__":
    main()
