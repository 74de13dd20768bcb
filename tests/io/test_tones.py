import typing

import numpy as np
import pytest

from deepir.config.schema import Output
from deepir.io.tone_mapping import PALETTES, TONE_MAPPINGS, apply_palette, colour_table


@pytest.fixture
def scene():
    """A cold and a hot part, each with little contrast of its own."""
    y, x = np.mgrid[:64, :96]
    return 290 + 60 * (x > 48) + np.sin(x / 3) + np.cos(y / 4)


@pytest.mark.parametrize("palette", PALETTES)
def test_palettes_go_from_cold_to_hot(palette):
    light = colour_table(palette) @ [0.299, 0.587, 0.114]
    assert colour_table(palette).shape == (256, 3)
    if palette == "black-hot":
        light = light[::-1]
    if palette != "turbo":  # a rainbow
        assert light[0] < 20
        assert (np.diff(light) > -1.5).all()
        assert light[-1] > 180


def test_white_hot_is_grey():
    np.testing.assert_array_equal(apply_palette(np.array([[0, 0.5, 1]]), "white-hot"), [[0, 128, 255]])
    np.testing.assert_array_equal(colour_table("white-hot")[:, 0], np.arange(256))


@pytest.mark.parametrize("tones", TONE_MAPPINGS)
def test_shades_lie_between_nought_and_one(scene, tones):
    scene[3, 4] = np.nan
    shades = TONE_MAPPINGS[tones](scene)
    assert shades.shape == scene.shape
    assert shades.min() >= 0
    assert shades.max() <= 1


def test_clahe_shows_both_parts(scene):
    cold = np.s_[:, :40]
    assert TONE_MAPPINGS["clahe"](scene)[cold].std() > 2 * TONE_MAPPINGS["percentile"](scene)[cold].std()


@pytest.mark.parametrize("tones", TONE_MAPPINGS)
@pytest.mark.parametrize("value", [7.0, np.nan])
def test_nothing_to_see_is_black(tones, value):
    assert not TONE_MAPPINGS[tones](np.full((20, 24), value)).any()


def test_all_can_be_chosen():
    choices = {key: typing.get_args(field.annotation) for key, field in Output.model_fields.items()}
    assert choices["palette"] == PALETTES
    assert choices["tones"] == tuple(TONE_MAPPINGS)
