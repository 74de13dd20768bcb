"""A simulated camera without imperfections, for tests of one."""

from deepir.simulate import Settings

#: Pattern and noise that are off, and optics that are sharp.
CLEAN = dict.fromkeys(
    [
        "gain_pixel", "gain_column", "offset_pixel", "offset_column", "offset_row", "shading", "read_noise",
        "dead_pixels", "psf_sigma",
    ],
    0.0,
)  # fmt: skip


def clean(**changes: object) -> Settings:
    """Settings with no imperfection but those that are given."""
    return Settings(**(CLEAN | changes))
