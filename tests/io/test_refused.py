"""What cannot be read is refused in a line that says what is wrong, and at once, however much a file claims."""

import gzip
import importlib
import os
import pickle
import struct
import sys
import zipfile
import zlib
from functools import partial
from pathlib import Path

import imagecodecs
import numpy as np
import pytest
import recordings
import scipy.io
import tifffile
from PIL import Image
from recordings import changed, cut, forged, replaced

from deepir.config.schema import Raw
from deepir.errors import DataError
from deepir.io import read_frames


def content(make):
    """A writer of the bytes that `make` makes of the frames."""
    return lambda path, frames: path.write_bytes(make(frames))


def zeros(shape, dtype=float):
    return lambda path, frames: np.save(path, np.zeros(shape, dtype))


def arrays(**named):
    return lambda path, frames: np.savez(path, **{name: make(frames) for name, make in named.items()})


def matlab(**named):
    return lambda path, frames: scipy.io.savemat(path, {name: make(frames) for name, make in named.items()})


def hdf5(*names):
    """A writer of one frame each by these names."""

    def write(path, frames):
        with importlib.import_module("h5py").File(path, "w") as file:
            for name, frame in zip(names, frames, strict=False):
                file[name] = frame

    return write


def huge_hdf5(path, frames):
    with importlib.import_module("h5py").File(path, "w") as file:
        file.create_dataset("frames", (10**6, 1000, 1000), "f4", chunks=(1, 100, 100))


def huge_npy(path, frames):
    with path.open("wb") as file:
        header = {"descr": "<f4", "fortran_order": False, "shape": (10**6, 1000, 1000)}
        np.lib.format.write_array_header_1_0(file, header)
        file.write(bytes(100))


def huge_npy_in_npz(path, frames):
    huge_npy(path.with_suffix(".npy"), frames)
    with zipfile.ZipFile(path, "w") as archive:
        archive.write(path.with_suffix(".npy"), "frames.npy")


def zip_of(name):
    def write(path, frames):
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr(name, b"x")

    return write


def zip_bomb(field):
    """The sizes of the directory stand at bytes 20 and 24."""
    return forged(zip_of("frames.npy"), b"PK\x01\x02", field, b"\xfe\xff\xff\xff")


def huge_cptv(width):
    width = width.to_bytes(4, "little")
    return changed(recordings.cptv, lambda c: gzip.compress(replaced(gzip.decompress(c), b"\4X", 2, width)))


def huge_tiff(path, frames):
    tifffile.imwrite(path, frames[0], compression="zlib")
    with tifffile.TiffFile(path, mode="r+") as tiff:
        for tag in ("ImageWidth", "ImageLength", "RowsPerStrip"):
            tiff.pages[0].tags[tag].overwrite(10**6, dtype="I")


def circular_tiff(following):
    """A library that follows its directories would never end."""
    values = [(256, 32), (257, 24), (258, 16), (259, 1), (262, 1), (273, 8), (277, 1), (278, 24), (279, 1536)]
    tags = [(tag, 4, 1, value) for tag, value in values]
    directory = struct.pack("<H", len(tags)) + b"".join(struct.pack("<HHII", *tag) for tag in tags)
    head = b"II*\0" + struct.pack("<I", 1544)
    return content(lambda _: head + bytes(1536) + directory + struct.pack("<I", following))


def pages_of_two_sizes(path, frames):
    for size in (20, 24):
        tifffile.imwrite(path, np.zeros((size, size), np.uint16), append=True)


def palette_tiff(path, frames):
    colours = np.zeros((3, 256), np.uint16)
    tifffile.imwrite(path, frames[0].astype(np.uint8), photometric="palette", colormap=colours)


def coloured(path, frames):
    hot = np.zeros((20, 24, 3), np.uint8)
    hot[..., 0] = np.arange(24) * 10
    Image.fromarray(hot).save(path)


def of_type(kind, packed):
    """An array of MATLAB's whose values are of no numeric type: SciPy's reader would end the process."""

    def pack(whole):
        body = zlib.compress(whole[128:])
        return whole[:128] + struct.pack("<II", 15, len(body)) + body

    plain = forged(matlab(frames=lambda f: f.transpose(1, 2, 0)), b"frames\0\0", 8, bytes([kind]))
    return changed(plain, pack) if packed else plain


def without_a_segment(whole):
    second = whole.index(b"FLIR\0\1\1") - 4
    return whole[:second] + whole[second + 412 :]


def fff(*makers):
    return content(lambda frames: b"".join(recordings.fff(make(frames)) for make in makers))


def broken_in_the_midst(path, frames):
    first, second, third = map(recordings.fff, frames)
    path.write_bytes(first + second[:80] + third)


def csq_with(packed):
    return content(lambda frames: recordings.fff(frames[0], packed(frames[0])))


def jpeg(marker, *parts, after=b""):
    return content(lambda _: recordings.jpeg_with(marker, parts, (120, 160)) + after)


def infiray_of_another_size(path, frames):
    forged(recordings.infiray_jpeg, b"\xff\xc0", 5, b"\0\x65\0\x70")(path, np.resize(frames, (1, 192, 256)))


def envi(old, new=""):
    def write(path, frames):
        recordings.envi(path, frames)
        header = path.with_suffix(".hdr")
        header.write_text(header.read_text().replace(old, new))

    return write


def envi_header_alone(path, frames):
    recordings.envi(path.with_suffix(".img"), frames)
    path.with_suffix(".img").unlink()


def in_folder(*pictures):
    def write(path, frames):
        path.mkdir()
        for number, make in enumerate(pictures):
            recordings.png(path / f"{number}.png", make(frames)[None])

    return write


def folder_with_a_damaged_picture(path, frames):
    recordings.folder(path, frames)
    (path / "frame9.png").write_bytes(b"")


def folder_of_two_formats(path, frames):
    in_folder(lambda f: f[0])(path, frames)
    recordings.tiff(path / "a.tif", frames)


def film_in_colour(path, frames):
    colours = np.repeat(frames[..., None] // 64, 3, axis=-1).astype(np.uint8)
    colours[..., 2] = 0
    recordings.film(path, colours, stored="bgr0", given="rgb24")


def film_of_a_huge_table(path, frames):
    """Of the times of its frames."""
    grey = np.full((3, 32, 32), 90, np.uint8)
    recordings.film(path.with_suffix(".mp4"), grey, "mpeg4", "yuv420p", given="gray")
    path.write_bytes(replaced(path.with_suffix(".mp4").read_bytes(), b"stts", 8, b"\x7f\xff\xff\xff"))


#: Writers of files that are refused, and what is said, by the names of the files.
REFUSED = {
    "a.npy": [
        (huge_npy, "declares 4,000,000,000,000 bytes of data but holds 100"),
        (lambda p, _: recordings.sparse_npy(p, (9, 2**15, 2**15)), r"9\.0 GiB of data; at most 8 GiB"),
        (content(lambda _: b"\x93NUMPY\2\0" + b"\xff" * 104), "its header claims 4,294,967,295 bytes"),
        *((zeros(each), r"an array of shape .*expected \(frames,") for each in ((480,), (2, 2, 12, 10), (0, 20, 24))),
        *((zeros((20, 20), kind), "integers or real numbers") for kind in (bool, complex, "U4", "M8[s]")),
        (lambda p, _: p.touch(), "the file is empty"),
    ],
    "a.npz": [
        (huge_npy_in_npz, "4,000,000,000,000"),
        (arrays(day=lambda f: f, cal=lambda f: f[0]), r"Arrays: cal \(20, 24\), day \(3, 20, 24\)"),
        (zip_of("readme.txt"), "without NumPy arrays"),
        *((zip_bomb(field), "declares 4,294,967,294 bytes") for field in (20, 24)),  # bytes packed, unpacked
        (content(lambda _: b"frames"), r"does not begin as a \.npz file does: damaged"),
    ],
    "a.cptv": [
        (content(lambda _: gzip.compress(b"notes")), r"does not begin as a \.cptv file does"),
        *((huge_cptv(width), "declares") for width in (2**20, 2**32 - 1)),
    ],
    "a.jpg": [
        (jpeg(0xE3, bytes(50_000)), "50,000 bytes of raw plane fit no detector"),
        # DJI's XT S keeps its raw data in other segments.
        *(
            (jpeg(each, *[bytes(60_000)] * 10), rf"APP{each - 0xE0}: 600,000 bytes\).*preview")
            for each in (0xE2, 0xE4, 0xE5, 0xE8, 0xEF)
        ),
        (jpeg(0xE1, b"Exif\0\0", after=bytes(40_000)), "after the picture: 40,000 bytes"),
        (infiray_of_another_size, "of a kind that is not known"),
        (changed(recordings.flir_jpeg, without_a_segment), "of FLIR's 5 segments it has 4"),
    ],
    "a.img": [
        (envi("data type = 12", "data type = 6"), "no ENVI header of real numbers"),
        (envi("samples = 24"), "wrong or missing: 'samples'"),
        (envi("lines   = 20", "lines = 200"), "where a.hdr says 28,800"),
        (envi("bands = 3", "bands = 3\nfile compression = 1"), "without compression"),
    ],
    "a.hdr": [(envi_header_alone, "its samples are missing")],
    "a.seq": [
        (fff(lambda f: f[0], lambda f: f[1, :18]), r"frames differ in size: \(20, 24\) and \(18, 24\)"),
        (csq_with(lambda f: imagecodecs.jpegls_encode(f[:18])), r"raw plane is \(18, 24\), its record says \(20,"),
        (
            csq_with(lambda f: replaced(imagecodecs.jpegls_encode(f), b"\xff\xf7", 5, b"\xff" * 4)),
            "declares 8,589,672,450 bytes",
        ),
        (broken_in_the_midst, "a.seq: "),
        (forged(recordings.seq, b"FFF\0", 0, b"AFF\0"), r"older SEQ \(AFF\), which is not read; export"),
    ],
    "folder": [
        (in_folder(lambda f: f[0], lambda f: f[0, :18]), r"0\.png is 20 x 24, 1\.png is 18 x 24"),
        (in_folder(lambda f: f[0], lambda f: f[0].astype(np.uint8)), r"0\.png is uint16, 1\.png is uint8"),
        (folder_with_a_damaged_picture, r"frame9\.png: the file is empty"),
        (in_folder(), r"no pictures in this folder \(\.avi"),
        (folder_of_two_formats, r"several formats lie side by side \(\.png, \.tif\).*/\*\.tif'"),
    ],
    "*.png": [(lambda p, _: None, "no file matches")],
    "a.h5": [
        (hdf5("day/one", "day/two"), r"Arrays: day/one \(20, 24\), day/two \(20, 24\)"),
        (hdf5("0", "1", "2"), "look like a frame each: join them"),
        (huge_hdf5, "declares 4,000,000,000,000 bytes"),
    ],
    "a.mat": [
        (
            matlab(camera=lambda f: {"frames": f}, notes=lambda f: np.array([f], object)),
            r"no array of frames but camera \(struct\), notes \(cell\); join",
        ),
        (matlab(camera=lambda f: {"frames": f}, fps=np.ndim), r"no array of frames but camera \(struct\), fps"),
        (forged(matlab(frames=lambda f: f[0]), struct.pack("<II", 20, 24), 0, b"\xff\xff\xff\x7f" * 2), "declares"),
        *((of_type(kind, packed), "which no number has") for kind in (8, 14, 99) for packed in (False, True)),
        (lambda p, f: scipy.io.savemat(p, {"frame": f[0] * 1.0}, format="4"), "MATLAB 4"),
        (matlab(frames=lambda f: f), r"data\.axes=wnh reads 3 frames"),  # saved by Python
    ],
    "a.pgm": [
        (lambda p, f: recordings.pgm(p, (8000 + f // 64).byteswap()), r"data\.swap_bytes=true"),
        *((cut(partial(recordings.pgm, plain=each), 100), r"damaged|truncated") for each in (False, True)),
    ],
    "a.bmp": [(coloured, r"palette picture carries no radiometry.*16-bit")],
    "b.jpg": [(coloured, r"palette picture carries no radiometry.*16-bit")],
    "a.png": [
        (coloured, r"palette picture carries no radiometry.*16-bit"),
        (forged(recordings.png, b"IHDR", 4, b"\x7f\xff\xff\xff" * 2), "declares"),
    ],
    "a.tif": [
        (pages_of_two_sizes, r"frames differ in size: \(20, 20\) and \(24, 24\)"),
        (lambda p, f: tifffile.imwrite(p, np.moveaxis(f, 0, -1), photometric="rgb"), "radiometry"),
        (palette_tiff, "radiometry"),
        (
            lambda p, f: tifffile.imwrite(p, np.moveaxis(np.tile(f, (3, 1, 1)), 0, -1), planarconfig="contig"),
            r"data\.axes=hwn reads 9 frames",
        ),
        (huge_tiff, "declares 2,000,000,000,000 bytes"),
        (circular_tiff(1544), "reached twice"),
        *(
            (cut(write, lost), "truncated")
            for write in (recordings.tiff, recordings.big_tiff, recordings.lzw_tiff)
            for lost in (20, 200, 1500)
        ),
    ],
    "film.avi": [
        (film_in_colour, "carries no radiometry"),
        (recordings.unnamed_film, "16 bits a sample without a name"),
        (film_of_a_huge_table, "damaged: it declares a part that is too large"),
    ],
}


@pytest.mark.parametrize(
    ("name", "write", "message"), [(name, *each) for name, cases in REFUSED.items() for each in cases]
)
def test_it_is_refused_with_the_reason(tmp_path, burst, name, write, message):
    for library in {"a.h5": ["h5py"], "film.avi": ["av"]}.get(name, ()):
        pytest.importorskip(library)
    write(tmp_path / name, burst)
    with pytest.raises(DataError, match=message) as refused:
        read_frames(tmp_path / name)
    assert str(tmp_path) in str(refused.value)


@pytest.mark.parametrize(
    ("write", "message"),
    [(lambda p, f: recordings.cptv(p, f[:0]), "without frames"), (cut(recordings.cptv, 400), "damaged or truncated")],
)
def test_what_is_read_frame_by_frame_is_refused_where_the_damage_is_reached(tmp_path, burst, write, message):
    write(tmp_path / "a", burst)
    with pytest.raises(DataError, match=message):
        list(recordings.stream_frames(tmp_path / "a"))


def test_pickles_are_never_loaded(tmp_path):
    class Bomb:
        def __reduce__(self):
            return (os.mkdir, (str(tmp_path / "owned"),))

    np.save(tmp_path / "a.npy", np.array([Bomb()], dtype=object))
    np.savez(tmp_path / "a.npz", np.array([Bomb()], dtype=object))
    (tmp_path / "raw.npy").write_bytes(pickle.dumps(Bomb()))
    for name, key in (("a.npy", None), ("a.npz", "arr_0"), ("raw.npy", None)):
        with pytest.raises(DataError, match=r"never loaded|does not begin"):
            read_frames(tmp_path / name, key=key)
    assert not (tmp_path / "owned").exists()


@pytest.mark.parametrize(
    ("write", "key", "message"),
    [
        (recordings.npz, "frmes", "no array 'frmes'; did you mean 'frames'"),
        (matlab(camera=lambda f: {"frames": f}), "camera", "no array 'camera'"),
    ],
)
def test_a_key_that_there_is_not_is_answered_with_the_nearest(tmp_path, burst, write, key, message):
    write(tmp_path / "a.npz", burst)
    with pytest.raises(DataError, match=message):
        read_frames(tmp_path / "a.npz", key=key)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({}, "after 0 bytes there are 2,879, and a frame of 20 x 24 px of 16 bits takes 960"),
        ({"offset": 9999}, "after 9999 bytes there are 0"),
    ],
)
def test_a_layout_that_does_not_fit_says_what_there_is(tmp_path, burst, given, message):
    (tmp_path / "a.raw").write_bytes(burst.tobytes()[:-1])
    with pytest.raises(DataError, match=message):
        read_frames(tmp_path / "a.raw", raw=Raw(width=24, height=20, **given))


def test_other_files_than_the_hdf5_file_itself_are_never_opened(tmp_path, burst):
    h5py = pytest.importorskip("h5py")
    recordings.hdf5(tmp_path / "other.h5", burst)
    (tmp_path / "raw").write_bytes(burst.tobytes())
    layout = h5py.VirtualLayout(burst.shape, "u2")
    layout[:] = h5py.VirtualSource("other.h5", "camera/frames", burst.shape)
    for number, (add, message) in enumerate(
        {
            lambda file: file.__setitem__("frames", h5py.ExternalLink("other.h5", "camera/frames")): "none",
            lambda file: file.create_virtual_dataset("frames", layout): "never opened",
            lambda file: file.create_dataset("frames", burst.shape, "u2", external=str(tmp_path / "raw")): "never",
        }.items()
    ):
        with h5py.File(tmp_path / f"{number}.h5", "w") as file:
            add(file)
        with pytest.raises(DataError, match=message):
            read_frames(tmp_path / f"{number}.h5")


@pytest.mark.parametrize(
    ("library", "extra", "write"), [("h5py", "hdf5", recordings.hdf5), ("av", "video", recordings.film)]
)
def test_without_the_library_the_extra_is_named(tmp_path, burst, monkeypatch, library, extra, write):
    pytest.importorskip(library)
    write(tmp_path / "a.mkv", burst)
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(DataError, match=rf"a\.mkv: this needs {library}.*pip install 'deepir\[{extra}\]'"):
        read_frames(tmp_path / "a.mkv")


def test_a_missing_file_is_answered_with_the_nearest_names(tmp_path, burst):
    np.save(tmp_path / "flight_07.npy", burst)
    with pytest.raises(DataError, match=r"no such file or folder; did you mean 'flight_07\.npy'\?"):
        read_frames(tmp_path / "flight_7.npy")
    with pytest.raises(DataError, match="there is no folder"):
        read_frames(tmp_path / "nowhere" / "a.npy", raw=Raw(width=24, height=20))


def test_a_file_without_permission_says_so(tmp_path, burst, monkeypatch):
    def deny(*_):
        raise PermissionError

    np.save(tmp_path / "a.npy", burst)
    monkeypatch.setattr(Path, "open", deny)  # root, as which containers run, may read everything
    with pytest.raises(DataError, match="no permission"):
        read_frames(tmp_path / "a.npy")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
def test_a_pipe_does_not_block(tmp_path):
    os.mkfifo(tmp_path / "pipe.npy")
    with pytest.raises(DataError, match="not an ordinary file"):
        read_frames(tmp_path / "pipe.npy")


@pytest.mark.parametrize(
    ("name", "write"),
    [
        ("a.npy", recordings.npy),
        ("a.tif", recordings.tiff),
        ("a.seq", recordings.seq),
        recordings.needs("h5py", "a.h5", recordings.hdf5),
        ("a.raw", lambda path, frames: path.write_bytes(frames.tobytes())),
    ],
)
def test_a_file_that_is_cut_while_it_is_read_is_an_error(tmp_path, name, write):
    frames = np.random.default_rng(0).integers(1, 2**14, (40, 128, 160)).astype(np.uint16)
    write(tmp_path / name, frames)
    stream = recordings.stream_frames(tmp_path / name, raw=Raw(width=160, height=128) if name == "a.raw" else None)
    next(stream)
    with (tmp_path / name).open("r+b") as file:
        file.truncate(frames.nbytes // 3)
    found = []
    with pytest.raises(DataError, match=r"truncated|damaged"):
        found.extend(stream)
    assert all(np.array_equal(*each) for each in zip(found, frames[1:], strict=False))
