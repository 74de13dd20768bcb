"""From samples to a picture to look at: tone mapping, and palettes."""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np

from deepir.arrays import Array

WHITE_HOT = "white-hot"  # the default palette
PALETTES = (WHITE_HOT, "black-hot", "ironbow", "inferno", "magma", "turbo")  # palettes to choose from
DEVIATIONS = "viridis"  # palette of standard deviations
SIGNED = "blue-red"  # palette of maps about a centre
#: Colours of each palette in hexadecimal, equally far from one another: those that matplotlib calls `gray`, `inferno`,
#: `magma`, `turbo`, `viridis` (van der Walt and Smith; Mikhailov) and `RdBu_r` (Brewer), here without its import;
#: `ironbow` is heated iron.
COLOURS = {
    WHITE_HOT: "000000 ffffff",
    "black-hot": "ffffff 000000",
    "ironbow": "000014 20008c 8b0094 cc4a1f f29100 ffd93b ffffe6",
    "inferno": (
        "000004 02020c 050417 0a0722 10092d 160b39 1e0c45 260c51 2f0a5b 380962 400a67 490b6a "
        "510e6c 59106e 61136e 69166e 71196e 781c6d 801f6c 88226a 902568 982766 a02a63 a82e5f "
        "b0315b b73557 bf3952 c63d4d cc4248 d34743 d94d3d df5337 e45a31 e9612b ed6925 f1711f "
        "f47918 f78212 f98b0b fa9407 fb9d07 fca60c fcb014 fbba1f fac42a f8cd37 f6d746 f4e156 "
        "f2ea69 f2f27d f5f992 fcffa4"
    ),
    "magma": (
        "000004 02020b 050416 090720 0e0b2b 140e36 1a1042 21114e 29115a 311165 390f6e 420f75 "
        "4a1079 52137c 5a167e 621980 6a1c81 721f81 792282 812581 892881 912b81 992d80 a1307e "
        "aa337d b2357b ba3878 c23b75 ca3e72 d2426f d9466b e04c67 e75263 ec5860 f1605d f4695c "
        "f7725c f97b5d fb8560 fc8e64 fd9869 fea16e feaa74 feb47b febd82 fec68a fecf92 fed89a "
        "fde2a3 fdebac fcf4b6 fcfdbf"
    ),
    "turbo": (
        "30123b 36215f 3b2f80 3f3e9c 424bb5 4559cb 4666dd 4773eb 4680f6 458cfd 4099ff 38a5fb "
        "2fb2f4 27bee9 1fc9dd 1ad4d0 18ddc2 1ae4b6 22ebaa 2ff19b 3ff68a 52fa7a 65fd69 79fe59 "
        "8bff4b 9cfe40 a9fb39 b7f735 c3f134 d0ea34 dbe236 e5d938 eecf3a f5c53a faba39 fdae35 "
        "fea130 fe932a fc8423 f9751d f46617 ef5811 e84b0c e14109 d83706 ce2d04 c32503 b71d02 "
        "a91601 9b0f01 8b0902 7a0403"
    ),
    "viridis": (
        "440154 46085c 471063 481769 481d6f 482475 472a7a 46307e 453781 433d84 414287 3f4889 "
        "3d4e8a 3a538b 38598c 355e8d 33638d 31688e 2e6d8e 2c718e 2a768e 297b8e 27808e 25848e "
        "23898e 218e8d 20928c 1f978b 1e9c89 1fa188 21a585 24aa83 28ae80 2eb37c 35b779 3dbc74 "
        "46c06f 50c46a 5ac864 65cb5e 70cf57 7cd250 89d548 95d840 a2da37 b0dd2f bddf26 cae11f "
        "d8e219 e5e419 f1e51d fde725"
    ),
    "blue-red": "053061 2166ac 4393c3 92c5de d1e5f0 f7f7f7 fddbc7 f4a582 d6604d b2182b 67001f",
}
PERCENTILE = "percentile"  # the default tone mapping


@functools.cache
def colour_table(palette: str) -> Array:
    """256 colours (256, 3), uint8, from low to high; not to be changed."""
    anchors = np.array([list(bytes.fromhex(each)) for each in COLOURS[palette].split()])
    at = np.linspace(0, 255, len(anchors))
    table = np.stack([np.interp(np.arange(256), at, channel) for channel in anchors.T], axis=1)
    return np.round(table).astype(np.uint8)


def apply_palette(shades: Array, palette: str) -> Array:
    """Grey levels (..., h, w) from 0 to 1 as uint8: (..., h, w) for `white-hot`, else (..., h, w, 3)."""
    levels = np.round(255 * shades).astype(np.uint8)
    return levels if palette == WHITE_HOT else colour_table(palette)[levels]


def percentile(image: Array) -> Array:
    """Linear tone mapping of an image (h, w) between its percentiles 0.5 and 99.5; 0 where it is not finite."""
    return stretch(image, *display_limits(image))


def clahe(image: Array) -> Array:
    """Contrast-limited adaptive histogram equalisation of an image (h, w), for scenes with hot and cold parts.

    Source: Pizer et al., Adaptive histogram equalization and its variations (1987), as in scikit-image.
    """
    from skimage.exposure import equalize_adapthist

    shades = percentile(image)
    return shades if shades.min() == shades.max() else equalize_adapthist(shades, clip_limit=0.02)


def display_limits(image: Array) -> tuple[float, float]:
    """Percentiles 0.5 and 99.5 of the finite values; zeros if there is none."""
    finite = image[np.isfinite(image)]
    low, high = np.percentile(finite, [0.5, 99.5]) if finite.size else (0.0, 0.0)
    return float(low), float(high)


def stretch(image: Array, low: float, high: float) -> Array:
    """Linear map of [low, high] to [0, 1], clipped; 0 where the image is not finite."""
    scale = 1 / (high - low) if high > low else 0.0
    return np.clip((np.where(np.isfinite(image), image, low) - low) * scale, 0, 1)


TONE_MAPPINGS: dict[str, Callable[[Array], Array]] = {PERCENTILE: percentile, "clahe": clahe}  # tone mappings by name
