import imagecodecs
import numpy as np
import pytest
from PIL import Image

from deepir.errors import DataError
from deepir.io import read_frames


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("channels", [1, 2, 3, 4])
def test_grey_pngs_keep_every_bit_in_any_number_of_channels(tmp_path, burst, dtype, channels):
    grey = burst[0].astype(dtype)
    pixels = np.stack([grey] * channels, axis=-1) if channels > 1 else grey
    (tmp_path / "a.png").write_bytes(imagecodecs.png_encode(pixels))
    read = read_frames(tmp_path / "a.png")
    assert read.dtype == np.dtype(dtype).name
    np.testing.assert_array_equal(read.frames[0], grey)


@pytest.mark.parametrize("name", ["a.bmp", "a.jpg"])
def test_other_grey_pictures_are_read(tmp_path, name):
    ramp = np.tile(np.arange(0, 240, 10, np.uint8), (20, 1))
    Image.fromarray(ramp).save(tmp_path / name, quality=100)
    np.testing.assert_allclose(read_frames(tmp_path / name).frames[0], ramp, atol=6)


@pytest.mark.parametrize("name", ["a.png", "a.bmp", "a.jpg"])
def test_a_palette_picture_carries_no_radiometry(tmp_path, name):
    hot = np.zeros((20, 24, 3), np.uint8)
    hot[..., 0] = np.arange(24) * 10
    Image.fromarray(hot).save(tmp_path / name)
    with pytest.raises(DataError, match=r"palette picture carries no radiometry.*16-bit"):
        read_frames(tmp_path / name)


def test_a_coloured_marker_in_a_grey_picture_has_no_value(tmp_path):
    picture = np.full((40, 40, 3), 90, np.uint8)
    picture[3:6, 4:7] = (0, 255, 0)
    Image.fromarray(picture).save(tmp_path / "a.png")
    frame = read_frames(tmp_path / "a.png").frames[0]
    assert np.isnan(frame[3:6, 4:7]).all()
    assert np.isnan(frame).sum() == 9


def test_a_png_that_claims_a_huge_picture_is_refused_at_once(tmp_path, burst):
    content = bytearray(imagecodecs.png_encode(burst[0]))
    content[16:24] = (2**31 - 1).to_bytes(4) * 2
    (tmp_path / "a.png").write_bytes(content)
    with pytest.raises(DataError, match="declares"):
        read_frames(tmp_path / "a.png")


def test_the_colours_of_a_mark_are_lost_where_a_lossy_codec_has_spread_them(tmp_path):
    ramp = np.repeat(np.tile(np.arange(20, 180, dtype=np.uint8), (120, 1))[..., None], 3, axis=-1)
    ramp[60, 74:84], ramp[56:64, 79] = (255, 0, 0), (255, 0, 0)
    Image.fromarray(ramp).save(tmp_path / "a.jpg", quality=85)
    found = read_frames(tmp_path / "a.jpg").frames[0]
    assert np.isnan(found[60, 74:84]).all()
    assert np.isnan(found).mean() < 0.05
