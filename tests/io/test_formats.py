"""Every format gives the frames that are stored in it, whatever the file is called."""

import subprocess
import sys

import imagecodecs
import numpy as np
import pytest
import recordings
import scipy.io
import tifffile
from documentation import ROOT, rows
from PIL import Image
from recordings import assert_read, needs

from deepir.config.schema import Raw
from deepir.io import read_frames, readers


def layout(**given):
    return Raw(width=24, height=20, **given)


@pytest.mark.parametrize("kind", sorted(recordings.FILES.keys() - {"picture, jpeg"}))
def test_every_format_gives_its_frames_exactly_whatever_the_name(tmp_path, burst, kind):
    path = recordings.written(tmp_path, kind, burst)
    assert readers.find_reader(path).name == kind.partition(",")[0]
    read = read_frames(path)
    stored = np.uint8 if kind == "picture, bmp" else np.uint16
    assert (read.frames.dtype, read.dtype, read.source) == (np.float32, np.dtype(stored).name, str(path))
    np.testing.assert_array_equal(read.frames, np.resize(burst, read.frames.shape).astype(stored))
    has_one = kind.startswith(("png", "picture", "flir_jpeg", "dji_jpeg", "infiray_jpeg"))
    assert len(read.frames) == (1 if has_one else 3)
    streamed = list(recordings.stream_frames(path))
    assert {frame.dtype.newbyteorder("=") for frame in streamed} == {np.dtype(stored)}
    np.testing.assert_array_equal(streamed, read.frames)


def appended_pages(path, frames):
    for frame in frames:
        tifffile.imwrite(path, frame, append=True)


def rgb_tiff(path, frames):
    tifffile.imwrite(path, np.stack([frames[0]] * 3, axis=-1), photometric="rgb")


def npy_2(path, frames):
    with path.open("wb") as file:
        np.lib.format.write_array(file, frames, version=(2, 0))


def with_a_reduced_picture(path, frames):
    with tifffile.TiffWriter(path) as tiff:
        tiff.write(frames[0], subifds=1)
        tiff.write(frames[0, ::2, ::2], subfiletype=1)


def of_fff(**options):
    return lambda path, frames: path.write_bytes(b"".join(recordings.fff(f, **options) for f in frames))


def matlab(**arrays):
    """A writer of what these functions make of the frames in MATLAB's order of axes."""
    return lambda path, frames: scipy.io.savemat(
        path, {name: make(np.moveaxis(frames, 0, -1)) for name, make in arrays.items()}
    )


def small_png(channels, dtype):
    """A writer of the first frame's bits in any number of channels."""

    def write(path, frames):
        grey = frames[0].astype(dtype)
        pixels = np.stack([grey] * channels, axis=-1) if channels > 1 else grey
        path.write_bytes(imagecodecs.png_encode(pixels))

    return write


#: Files in other ways than the usual ones, by what is unusual.
UNUSUAL = {
    "big-endian FFF": ("a.seq", of_fff(order=">")),
    "between frames": ("a.seq", lambda p, f: p.write_bytes(b"padding 123".join(map(recordings.fff, f)))),
    "appended pages": ("a.tif", appended_pages),
    "ImageJ": ("a.tif", lambda p, f: tifffile.imwrite(p, f, imagej=True)),
    "grey stored as RGB": ("a.tif", rgb_tiff),
    "three colour planes": ("a.tif", lambda p, f: tifffile.imwrite(p, f, photometric="rgb", planarconfig="separate")),
    "sub-directories": ("a.tif", with_a_reduced_picture),
    "npy of version 2": ("a.npy", npy_2),
    "brackets in the name": ("burst[1].npy", np.save),
    "axis of one in npy": ("a.npy", lambda p, f: np.save(p, f[:, None])),
    "last axis of one in npy": ("a.npy", lambda p, f: np.save(p, f[..., None])),
    "axis of one in npz": ("a.npz", lambda p, f: np.savez(p, frames=f[:, None])),
    "last axis of one in npz": ("a.npz", lambda p, f: np.savez(p, frames=f[..., None])),
    "Fortran's order": ("a.npz", lambda p, f: np.savez(p, frames=np.asfortranarray(f))),
    "one frame (h, w)": ("a.npy", lambda p, f: np.save(p, f[0])),
    "one frame (1, 1, h, w)": ("a.npy", lambda p, f: np.save(p, f[:1, None])),
    "one frame (1, h, w, 1)": ("a.npy", lambda p, f: np.save(p, f[:1, ..., None])),
    "the only picture": ("a.npz", lambda p, f: np.savez(p, raw=f, exposure=8.3, times=np.arange(3))),
    "frames before others": ("a.npz", lambda p, f: np.savez(p, frames=f, shutter=f[0])),
    "raw before processed": ("a.npz", lambda p, f: np.savez(p, raw=f, shutter=f[0], processed=f / 2)),
    "MATLAB's only frames": ("a.mat", matlab(burst=lambda f: f, name=lambda _: "flight", rate=lambda _: 30.0)),
    "MATLAB's axis of one colour": ("a.mat", matlab(video=lambda f: f[:, :, None])),
    "one frame of MATLAB": ("a.mat", matlab(raw=lambda f: f[..., 0], cal=lambda f: f[..., 1])),
    "comments in PGM": ("a.pgm", lambda p, f: recordings.pgm(p, f, 16383, b"# a camera\n# of 14 bits\n")),
    "plain PGM": ("a.pgm", lambda p, f: recordings.pgm(p, f, 16383, plain=True)),
    "grey and alpha": ("a.png", small_png(2, np.uint16)),
    "grey stored as RGB in PNG": ("a.png", small_png(3, np.uint16)),
    "RGB and alpha": ("a.png", small_png(4, np.uint16)),
}


@pytest.mark.parametrize("what", UNUSUAL)
def test_unusual_files_give_their_frames_too(tmp_path, burst, what):
    name, write = UNUSUAL[what]
    write(tmp_path / name, burst)
    assert_read(tmp_path / name, burst[:1] if what.startswith(("one frame", "grey", "RGB", "sub")) else burst)


@pytest.mark.parametrize(
    ("name", "write"),
    [
        ("a.pgm", lambda p, f: recordings.pgm(p, f, 255)),
        ("plain.pgm", lambda p, f: recordings.pgm(p, f, 255, b"# 8 bits\n", plain=True)),
        *(("a.png", small_png(channels, np.uint8)) for channels in (1, 2, 3, 4)),
        needs("av", "a.avi", lambda p, f: recordings.film(p, f, stored="gray")),
        needs("av", "a.mkv", lambda p, f: recordings.film(p, f, stored="gray")),
    ],
)
def test_eight_bits_stay_eight(tmp_path, burst, name, write):
    burst = (burst // 64).astype(np.uint8)
    write(tmp_path / name, burst)
    assert assert_read(tmp_path / name, burst[:1] if name == "a.png" else burst).dtype == "uint8"


def raw(path, frames):
    path.write_bytes(frames.tobytes())


@pytest.mark.parametrize(
    ("write", "dtype"),
    [
        *((np.save, dtype) for dtype in (">u2", "i4", "u8", "f2", "f8", ">f4")),
        *((matlab(frames=lambda f: f), dtype) for dtype in ("u1", "i2", "i4", "u8", "f4", "f8")),
        *((recordings.envi, dtype) for dtype in ("u1", ">i2", "<i4", ">f4", "<f8", ">u2", "<u4")),
        *((raw, dtype) for dtype in ("<i2", ">i2", "<f4", ">f4", "<i4", "<f8", ">f8")),
        (recordings.tiff, "f4"),
    ],
)
def test_numbers_of_any_type_and_order_of_bytes_are_read_as_stored(tmp_path, burst, write, dtype):
    stored = (burst // 128).astype(dtype)
    path = tmp_path / ("a.img" if write is recordings.envi else "a.npy" if write is np.save else "a")
    write(path, stored)
    order = "big" if dtype.startswith(">") else "little"
    given = layout(type=stored.dtype.name, endian=order) if write is raw else None
    assert assert_read(path, stored, raw=given).dtype == stored.dtype.name


@pytest.mark.parametrize("endian", ["little", "big"])
def test_a_file_without_a_header_has_the_layout_that_the_user_gives(tmp_path, burst, endian):
    raw(tmp_path / "a", (burst | 0x8000).astype({"little": "<u2", "big": ">u2"}[endian]))
    (tmp_path / "a").write_bytes(b"head" + (tmp_path / "a").read_bytes())
    given = layout(offset=4, endian=endian, bits=14)  # flags above the bits that count are cleared
    assert assert_read(tmp_path / "a", burst, raw=given).dtype == "uint16"


def test_up_to_eight_bits_take_one_byte(tmp_path, burst):
    raw(tmp_path / "a", (burst // 64).astype(np.uint8))
    assert assert_read(tmp_path / "a", burst // 64, raw=layout(bits=8)).dtype == "uint8"


@pytest.mark.parametrize("interleave", recordings.INTERLEAVES)
@pytest.mark.parametrize("name", ["a.img", "a.raw", "a.hdr"])
def test_every_order_of_envis_axes_is_read_by_the_samples_or_their_header(tmp_path, burst, interleave, name):
    recordings.envi(tmp_path / "a.raw" if name == "a.hdr" else tmp_path / name, burst, interleave, before=b"head")
    assert_read(tmp_path / name, burst)


@pytest.mark.parametrize(
    ("write", "key", "number"),
    [
        (lambda p, f: np.savez(p, frames=f, shutter=f[1]), "shutter", 1),
        (lambda p, f: scipy.io.savemat(p, {"raw": f[0], "cal": f[1]}), "cal", 1),
        needs("h5py", lambda p, f: recordings.hdf5(p, f[2:]), "camera/frames", 2),
    ],
)
def test_a_key_chooses_an_array(tmp_path, burst, write, key, number):
    write(tmp_path / "a.npz", burst)
    np.testing.assert_array_equal(read_frames(tmp_path / "a.npz", key=key).frames, burst[[number]])


def test_a_grey_jpeg_is_read(tmp_path):
    ramp = np.tile(np.arange(0, 240, 10, np.uint8), (20, 1))
    Image.fromarray(ramp).save(tmp_path / "a.jpg", quality=100)
    np.testing.assert_allclose(read_frames(tmp_path / "a.jpg").frames[0], ramp, atol=6)


def test_counts_that_look_like_flirs_mark_are_counts(tmp_path, burst):
    burst[1, 4, 6:8] = np.frombuffer(b"FFF\0", "<u2")
    recordings.seq(tmp_path / "a.seq", burst)
    assert_read(tmp_path / "a.seq", burst)


@pytest.mark.parametrize("bits", [9, 12, 16, 24])
def test_differences_of_any_width_are_exact(tmp_path, burst, bits):
    burst = burst % 60 + 3000
    recordings.cptv(tmp_path / "a.cptv", burst, bits)
    assert_read(tmp_path / "a.cptv", burst)


@pytest.mark.parametrize("size", [(120, 160), (512, 640)])
def test_djis_raw_plane_is_read_and_not_the_picture_of_any_size(tmp_path, size):
    plane = np.random.default_rng(1).integers(0, 2**14, (1, *size), dtype=np.uint16)
    recordings.dji_jpeg(tmp_path / "a.jpg", plane, shown=(120, 160))
    assert assert_read(tmp_path / "a.jpg", plane).dtype == "uint16"


def test_infirays_temperatures_are_read(tmp_path):
    plane = np.random.default_rng(0).integers(18000, 20000, (192, 256)).astype(np.uint16)
    recordings.infiray_jpeg(tmp_path / "a.jpg", plane[None])
    law = assert_read(tmp_path / "a.jpg", plane[None]).radiometry
    np.testing.assert_allclose(law.kelvin(plane), plane / 64)


@pytest.mark.parametrize("swapped", [False, True])
def test_pngs_of_flir_are_read_in_either_order_of_bytes(tmp_path, swapped):
    plane = np.random.default_rng(0).integers(12000, 13000, (1, 20, 24)).astype(np.uint16)
    packed = imagecodecs.png_encode((plane.byteswap() if swapped else plane)[0])
    recordings.flir_jpeg(tmp_path / "a.jpg", plane, packed)
    np.testing.assert_array_equal(read_frames(tmp_path / "a.jpg").frames, plane)


def test_a_plain_jpeg_stays_a_plain_jpeg(tmp_path):
    picture = recordings.jpeg_with(0xE1, [b"Exif\0\0"], (120, 160))
    for content in (picture, picture + picture + bytes(40_000)):  # a second picture behind the first
        (tmp_path / "a.jpg").write_bytes(content)
        assert read_frames(tmp_path / "a.jpg").dtype == "uint8"


def test_what_float32_cannot_hold_becomes_infinite(tmp_path):
    np.save(tmp_path / "a.npy", np.full((20, 20), 1e300))
    assert np.isinf(read_frames(tmp_path / "a.npy").frames).all()


def test_nine_gib_are_streamed(tmp_path):
    recordings.sparse_npy(tmp_path / "a.npy", (9 * 2**10, 2**10, 2**10))
    assert next(recordings.stream_frames(tmp_path / "a.npy")).shape == (2**10, 2**10)


def test_nothing_here_imports_torch():
    code = "import sys, deepir.io, deepir.io.readers as r; r.all_readers(); sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_a_new_format_is_one_new_file_and_comes_before_general_readers(tmp_path, monkeypatch):
    (tmp_path / "thermal_jpeg.py").write_text(
        "import numpy as np\n"
        "from deepir.io.readers import Reader\n"
        "class ThermalJpeg(Reader):\n"
        "    name, suffixes, signatures = 'thermal_jpeg', ('.rjpg',), (b'\\xff\\xd8\\xff\\xe1FLIR',)\n"
        "    def read(self, path, key): return np.full((20, 24), 7.0)\n"
    )
    (tmp_path / "a.jpg").write_bytes(b"\xff\xd8\xff\xe1FLIR")
    monkeypatch.setattr(readers, "__path__", [*readers.__path__, str(tmp_path)])
    readers.all_readers.cache_clear()
    try:
        assert (read_frames(tmp_path / "a.jpg").frames == 7).all()
        assert ".rjpg" in readers.suffixes()
    finally:
        readers.all_readers.cache_clear()
        sys.modules.pop("deepir.io.readers.thermal_jpeg", None)


def test_the_table_of_formats_is_that_of_the_readers():
    shown = {
        name.strip("`"): suffixes.replace("`", "").split(", ")
        for name, suffixes, _ in rows(ROOT / "docs/reference/files.md", "# Files")
    }
    assert shown == {reader.name: list(reader.suffixes) or [""] for reader in readers.all_readers()}
    assert list(shown) == sorted(shown)
