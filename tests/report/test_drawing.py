import numpy as np
import pytest
from PIL import Image

from deepir.io.tone_mapping import COLOURS, DEVIATIONS, SIGNED, WHITE_HOT, colour_table
from deepir.report.drawing import (
    MISSING_COLOUR,
    Axes,
    Scale,
    draw_map,
    enlarged,
    labels,
    linear_ticks,
    log_ticks,
    write_figure,
)
from deepir.report.panels import write_panels


@pytest.mark.parametrize(
    ("limits", "shown"),
    [
        ((0.0016, 0.0028), ["0.0016", "0.0018", "0.0020", "0.0022", "0.0024", "0.0026", "0.0028"]),
        ((-1.0, 1.0), ["-1.0", "-0.5", "0.0", "0.5", "1.0"]),
        ((3000, 3750), ["3000", "3200", "3400", "3600"]),
        ((0, 3e7), ["0", "5e+06", "1e+07", "1.5e+07", "2e+07", "2.5e+07", "3e+07"]),
        ((1e-9, 3e-9), ["1e-09", "1.5e-09", "2e-09", "2.5e-09", "3e-09"]),
        ((2.0, 2.0), []),
    ],
)
def test_a_scale_has_round_numbers(limits, shown):
    assert labels(linear_ticks(*limits)) == shown


def test_a_logarithmic_scale_has_powers_of_ten():
    assert labels(log_ticks(0.8, 2e4)) == ["1", "10", "100", "1000", "10000"]
    assert labels(log_ticks(0.9, 30)) == ["1", "2", "5", "10", "20"]
    assert labels(log_ticks(3.1, 3.4)) == ["3.10", "3.15", "3.20", "3.25", "3.30", "3.35", "3.40"]


def colours_in(picture):
    return {tuple(each) for each in np.asarray(picture).reshape(-1, 3).tolist()}


def test_the_centre_of_a_signed_map_is_white():
    image = np.full((40, 50), 1.0)
    image[:5] = 4.0
    middle = np.asarray(draw_map(image, "gain", SIGNED, (300, 220), centre=1.0))[150, 100]
    assert (middle > 240).all()


def test_what_is_not_finite_has_its_own_colour():
    image = np.arange(30.0).reshape(5, 6)
    assert MISSING_COLOUR not in colours_in(draw_map(image, "all", WHITE_HOT, (300, 200)))
    image[2, 3] = np.nan
    assert MISSING_COLOUR in colours_in(draw_map(image, "one missing", WHITE_HOT, (300, 200)))


@pytest.mark.parametrize("image", [np.zeros((4, 5)), np.full((4, 5), np.nan), np.eye(4, dtype=bool)])
@pytest.mark.parametrize("palette", [WHITE_HOT, DEVIATIONS, SIGNED])
def test_a_map_of_one_value_or_none_is_drawn(image, palette):
    assert draw_map(image, "map", palette, (200, 150)).size == (200, 150)


def test_deviations_that_differ_much_are_drawn_by_their_logarithm():
    image = np.geomspace(1e-3, 1, 100 * 100).reshape(100, 100)
    picture = np.asarray(draw_map(image, "deviation", DEVIATIONS, (400, 350)), int)
    np.testing.assert_allclose(picture[32 + 150, 160], colour_table(DEVIATIONS)[128], atol=8)


def test_a_pixel_stays_a_square_and_smaller_pictures_are_means():
    colours = np.zeros((2, 2, 3), np.uint8)
    colours[0, 0] = 200
    np.testing.assert_array_equal(np.asarray(enlarged(colours, (6, 6)))[:3, :3], 200)
    assert np.asarray(enlarged(colours, (1, 1)))[0, 0, 0] == 50


def test_a_curve_is_drawn_where_its_values_are():
    axes = Axes((300, 250), "loss", Scale(0, 10), Scale(1, 1000, log=True), "iteration")
    axes.line(np.array([0.0, 10.0]), np.array([10.0, 10.0]), "#ff0000", "stage")
    picture = np.asarray(axes.picture(), int)
    rows = np.flatnonzero((picture[:, 100] == [255, 0, 0]).all(1))
    assert len(rows)
    assert abs(rows.mean() - (32 + (250 - 32 - 56) * 2 / 3)) < 1.5


def test_rows_of_pictures_become_one_file(tmp_path):
    one = Image.new("RGB", (30, 20), "red")
    write_figure(tmp_path / "all.png", [[one, one], [one]])
    with Image.open(tmp_path / "all.png") as whole:
        assert whole.size == (60, 40)
        assert whole.getpixel((45, 30)) == (255, 255, 255)


def test_panels_take_black_and_white_from_the_caller(tmp_path):
    write_panels(tmp_path / "panels.png", [("one", np.full((30, 40), 5.0), 0.0, 10.0)] * 3, rows=2)
    with Image.open(tmp_path / "panels.png") as whole:
        assert whole.convert("L").getpixel((300, 200)) in range(124, 132)


def test_palettes_are_those_of_matplotlib():
    colormaps = pytest.importorskip("matplotlib").colormaps
    for name in {*COLOURS} & {*colormaps}:
        expected = 255 * np.asarray(colormaps[name](np.arange(256)))[:, :3]
        assert np.abs(colour_table(name) - expected).max() < 1.6
