"""The picture in docs/how-to/apply-maps.md: run its commands with `flight.npz` first, then this, in the same folder."""

from pathlib import Path

import numpy as np
from PIL import Image

from deepir.io import read_frames
from deepir.io.tone_mapping import TONE_MAPPINGS, apply_palette


def main() -> None:
    """Write docs/images/recording.png: a raw frame, the same corrected, and in colours with CLAHE."""
    raw, corrected = (read_frames(name).frames[7] for name in ("flight.npz", "flight_corrected.tif"))
    grey = [
        np.repeat(apply_palette(TONE_MAPPINGS["percentile"](each), "white-hot")[..., None], 3, -1)
        for each in (raw, corrected)
    ]
    picture = Image.fromarray(
        np.concatenate([*grey, apply_palette(TONE_MAPPINGS["clahe"](corrected), "ironbow")], axis=1)
    )
    small = picture.quantize(96, dither=Image.Dither.NONE)
    small.save(Path(__file__).with_name("recording.png"), optimize=True)


if __name__ == "__main__":
    main()
