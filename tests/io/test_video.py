import numpy as np
import pytest
import recordings

from deepir.errors import DataError
from deepir.io import read_frames
from deepir.io.readers import video

pytest.importorskip("av")


@pytest.mark.parametrize("name", ["a.mp4", "a.mov"])
def test_a_grey_film_in_a_colour_format_is_grey(tmp_path, name):
    ramp = np.tile(np.arange(40, 200, 5, np.uint8), (2, 32, 1))
    film = np.concatenate([ramp, np.full((2, 16, 32), 128, np.uint8)], axis=1)  # luma, then colourless chroma
    recordings.film(tmp_path / name, film, "mpeg4", "yuv420p", size=(32, 32))
    read = read_frames(tmp_path / name)
    assert read.frames.shape == (2, 32, 32)
    expected = (ramp.astype(float) - 16) * 255 / 219  # luma counts from 16 to 235
    np.testing.assert_allclose(read.frames, expected, atol=6)


@pytest.mark.parametrize("name", ["yuv420p", "yuv422p", "yuv444p"])
def test_luma_is_stretched_as_by_ffmpeg(name):
    import av

    luma = np.tile(np.arange(256, dtype=np.uint8), (16, 1))
    frame = av.VideoFrame(256, 16, name)
    frame.planes[0].update(np.pad(luma, ((0, 0), (0, frame.planes[0].line_size - 256))).tobytes())
    for plane in frame.planes[1:]:
        plane.update(bytes([128]) * plane.buffer_size)
    np.testing.assert_array_equal(video.STRETCHED[luma], frame.to_ndarray(format="gray"))


@pytest.mark.parametrize("bits", [10, 12, 14])
def test_counts_of_fewer_bits_than_sixteen_are_not_stretched(tmp_path, burst, bits):
    frames = burst % 2**bits
    recordings.film(tmp_path / "a.mkv", frames, stored=f"gray{bits}le")
    np.testing.assert_array_equal(read_frames(tmp_path / "a.mkv").frames, frames)


def test_of_two_films_in_one_file_the_grey_one_is_read(tmp_path, burst):
    import av

    height, width = burst.shape[1:]
    colour = np.random.default_rng(0).integers(0, 255, (height, width, 3), np.uint8)
    with av.open(tmp_path / "a.mkv", "w") as container:
        tracks = [container.add_stream(codec, rate=9) for codec in ("mpeg4", "ffv1")]
        for track, pixels in zip(tracks, ("yuv420p", "gray16le"), strict=True):
            track.width, track.height, track.pix_fmt = width, height, pixels
        for number, grey in enumerate(burst.astype(np.uint16)):
            for track, values, kind in zip(tracks, (colour, grey), ("rgb24", "gray16le"), strict=True):
                frame = av.VideoFrame.from_ndarray(values, format=kind)
                frame.pts = number
                container.mux(track.encode(frame))
        for track in tracks:
            container.mux(track.encode())
    np.testing.assert_array_equal(read_frames(tmp_path / "a.mkv").frames, burst)


def yuv(path, luma, codec="libx264", stored="yuv420p", colour_range=None, box=None):
    """A film of these luma (N, h, w), colourless but for a box [y0, y1, x0, x1]."""
    import av

    deep = luma.dtype == np.uint16
    with av.open(path, "w") as container:
        track = container.add_stream(codec, rate=9, options={"crf": "4"} if codec == "libx264" else {})
        track.height, track.width = luma.shape[1:]
        track.pix_fmt = stored
        if colour_range is not None:
            track.codec_context.color_range = colour_range
        for planes in luma:
            shown = av.VideoFrame(luma.shape[2], luma.shape[1], stored)
            for number, plane in enumerate(shown.planes):
                values = np.full((plane.height, plane.line_size // luma.itemsize), 128 << 2 * deep, luma.dtype)
                if number == 0:
                    values[:, : plane.width] = planes
                elif box is not None:
                    y0, y1, x0, x1 = (edge // 2 for edge in box)
                    values[y0:y1, x0:x1] = 220
                shown.planes[number].update(values.tobytes())
            container.mux(track.encode(shown))
        container.mux(track.encode())


RAMP = np.tile(np.linspace(0, 255, 64).astype(np.uint8), (2, 64, 1))


@pytest.mark.parametrize(
    ("stored", "colour_range", "name"),
    [("yuvj420p", None, "a.mp4"), ("yuv420p", 2, "a.mkv"), ("yuv420p", None, "a.mp4"), ("gray", None, "a.mp4")],
)
def test_grey_of_the_full_range_is_not_cut_off(tmp_path, stored, colour_range, name):
    yuv(tmp_path / name, RAMP, stored=stored, colour_range=colour_range)
    np.testing.assert_allclose(read_frames(tmp_path / name).frames, RAMP, atol=4)


def test_luma_of_ten_bits_are_the_counts(tmp_path):
    luma = 4 * RAMP.astype(np.uint16) + 1
    yuv(tmp_path / "a.mkv", luma, codec="ffv1", stored="yuv420p10le")
    np.testing.assert_array_equal(read_frames(tmp_path / "a.mkv").frames, luma)


def test_a_colour_bar_is_refused_unless_it_is_cropped(tmp_path):
    yuv(tmp_path / "a.mp4", RAMP // 2 + 64, box=[8, 56, 56, 62])
    with pytest.raises(DataError, match=r"take it off with data\.crop"):
        read_frames(tmp_path / "a.mp4")
    found = read_frames(tmp_path / "a.mp4", grey_within=[0, 64, 0, 48]).frames
    assert np.isfinite(found[..., :40]).all()


def test_uncompressed_sixteen_bits_by_the_name_of_y16_are_read(tmp_path, burst):
    named = recordings.forged(recordings.unnamed_film, b"strf", 24, b"Y16 ")
    recordings.forged(named, b"vids", 4, b"Y16 ")(tmp_path / "a.avi", burst)
    np.testing.assert_array_equal(read_frames(tmp_path / "a.avi").frames, burst)


def test_a_film_that_is_cut_off_is_read_with_a_warning(tmp_path, caplog):
    frames = np.random.default_rng(0).integers(0, 255, (40, 32, 48), np.uint8)
    recordings.film(tmp_path / "whole.avi", frames, codec="rawvideo", stored="gray")
    between_frames = b"00dc".join((tmp_path / "whole.avi").read_bytes().split(b"00dc")[:21])
    (tmp_path / "cut.avi").write_bytes(between_frames)
    found = read_frames(tmp_path / "cut.avi").frames
    np.testing.assert_array_equal(found, frames[: len(found)])
    assert f"{len(found)} of the 40 frames that its header announces" in caplog.text
    caplog.clear()
    read_frames(tmp_path / "whole.avi")
    assert not caplog.text
