"""Training pictures: photographs of scikit-image that no benchmark uses, and drawn scenes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from deepir.simulate.scenes.procedural import procedural

#: Pictures of scikit-image for training; all others are for tuning and benchmarks.
PHOTOGRAPHS = ("brick", "cell", "chelsea", "coffee", "hubble_deep_field", "retina")
BENCHMARK_PHOTOGRAPHS = (
    "chelsea",
    "coffee",
)  # test pictures of benchmarks/record.py: no rival learns from them
FIRST_SCENE_SEED = 1000  # seed of the first drawn scene; smaller seeds are for tuning and benchmarks
SCENE_COUNT = 160  # drawn scenes
BATCH_SIZE = 8  # crops of an iteration
SCENE_HEIGHTS = (160, 520)  # px of a drawn scene, from and below
PHOTOGRAPH_REDUCTIONS = (1, 2, 3)  # factors; a reduced photograph is sharper


class Pictures:
    """Pictures in [0, 1], and crops of them: half of photographs, half of scenes, each drawn on demand.

    Args:
        rng: Random stream.
        without: Names of photographs to leave out.
    """

    def __init__(self, rng: np.random.Generator, without: Sequence[str] = ()) -> None:
        self.rng = rng
        self.photographs = _photographs([name for name in PHOTOGRAPHS if name not in without])
        self.heights = rng.integers(*SCENE_HEIGHTS, SCENE_COUNT)
        self.drawn: dict[int, np.ndarray] = {}

    def crops(self, count: int, side: int) -> Tensor:
        """Random crops (count, 1, side, side), float32: rotated, mirrored, and half of them negative."""
        return torch.from_numpy(np.stack([self._crop(side) for _ in range(count)])[:, None])

    def _crop(self, side: int) -> np.ndarray:
        picture = self._photograph() if self.rng.integers(2) else self._scene()
        y, x = (int(self.rng.integers(length - side + 1)) for length in picture.shape)
        crop = np.rot90(picture[y : y + side, x : x + side], int(self.rng.integers(4)))
        return (crop if self.rng.integers(2) else crop.T) * np.float32(self.rng.choice([-1, 1]))

    def _photograph(self) -> np.ndarray:
        """A photograph; larger ones are more frequent."""
        sides = np.sqrt([each.size for each in self.photographs])
        return self.photographs[self.rng.choice(len(sides), p=sides / sides.sum())]

    def _scene(self) -> np.ndarray:
        i = int(self.rng.integers(SCENE_COUNT))
        if i not in self.drawn:
            shape = (int(self.heights[i]), int(1.25 * self.heights[i]))
            self.drawn[i] = procedural(FIRST_SCENE_SEED + i, shape).astype(np.float32)
        return self.drawn[i]


def _photographs(names: Sequence[str]) -> list[np.ndarray]:
    """Each colour of each photograph, in several sizes."""
    import skimage.data
    from skimage.transform import downscale_local_mean

    found = []
    for name in names:
        whole = np.atleast_3d(getattr(skimage.data, name)()).astype(np.float32) / 255
        for colour in np.moveaxis(whole, -1, 0):
            found += [
                downscale_local_mean(colour, (times, times)).astype(np.float32)
                for times in PHOTOGRAPH_REDUCTIONS
            ]
    return found
