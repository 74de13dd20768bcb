"""Small files of every format that is read, written by other means than deepir's own readers."""

import gzip
import importlib.util
import io
import math
import struct

import imagecodecs
import numpy as np
import pytest
import scipy.io
import tifffile
from PIL import Image

from deepir.config.schema import Data
from deepir.io import read_frames, stream_data


def stream_frames(path, **layout):
    """Frame after frame of a file, all of each."""
    return stream_data(Data(path=str(path), **layout))


def npz(path, frames):
    np.savez_compressed(path, frames=frames)


def npy(path, frames):
    with path.open("wb") as file:
        np.save(file, frames)


def sparse_npy(path, shape, dtype="|u1"):
    """An array of zeros that takes no room on the disk."""
    with path.open("wb") as file:
        header = {"descr": dtype, "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(file, header)
        file.truncate(file.tell() + np.dtype(dtype).itemsize * math.prod(shape))


INTERLEAVES = {"bsq": "nhw", "bil": "hnw", "bip": "hwn"}  # ENVI's orders of the axes


def envi(path, frames, interleave="bsq", extra="", before=b""):
    """Samples, and a header beside them."""
    turned = frames.transpose(["nhw".index(each) for each in INTERLEAVES[interleave]])
    path.write_bytes(before + np.ascontiguousarray(turned).tobytes())
    n, h, w = frames.shape
    number = {"u1": 1, "i2": 2, "i4": 3, "f4": 4, "f8": 5, "u2": 12, "u4": 13}[frames.dtype.str[1:]]
    path.with_suffix(".hdr").write_text(
        f"ENVI\ndescription = {{\n  a flight}}\nsamples = {w}\nlines   = {h}\nbands = {n}\n"
        f"header offset = {len(before)}\ndata type = {number}\n"
        f"byte order = {int(frames.dtype.str[0] == '>')}\ninterleave = {interleave}\n{extra}"
    )


def tiff(path, frames, **options):
    tifffile.imwrite(path, frames, photometric="minisblack", **options)


def big_tiff(path, frames):
    tiff(path, frames, bigtiff=True, byteorder=">")


def lzw_tiff(path, frames):
    tiff(path, frames, compression="lzw", predictor=True)


def png(path, frames):
    path.write_bytes(imagecodecs.png_encode(frames[0]))


def pgm(path, frames, largest=65535, comment=b"", plain=False):
    head = b"%s\n%s%d %d\n%d\n" % (b"P2" if plain else b"P5", comment, *frames.shape[:0:-1], largest)
    dtype = "u1" if largest < 256 else ">u2"
    words = (b" ".join(b"%d" % value for value in frame.ravel()) + b"\n" for frame in frames)
    samples = (frame.astype(dtype).tobytes() for frame in frames)
    path.write_bytes(b"".join(head + each for each in (words if plain else samples)))


def folder(path, frames):
    path.mkdir()
    for k, frame in enumerate(frames):
        Image.fromarray(frame).save(path / f"frame{k + 8}.png")


def mat(path, frames):
    scipy.io.savemat(path, {"frames": np.moveaxis(frames, 0, -1)}, do_compression=True)


def hdf5(path, frames, **options):
    import h5py

    with h5py.File(path, "w", **options) as file:
        file.create_dataset("camera/frames", data=frames, compression="gzip")
        file["temperature"] = np.zeros(3)


def mat73(path, frames):
    import h5py

    with h5py.File(path, "w", userblock_size=512) as file:
        file["frames"] = np.swapaxes(frames, -1, -2)
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64")


def film(path, frames, codec="ffv1", stored="gray16le", given=None, size=None):
    """A film of arrays in the pixel format `stored`, made of those that are `given` in another; `size`: of a frame."""
    import av

    with av.open(path, "w") as container:
        track = container.add_stream(codec, rate=30)
        track.height, track.width = size or frames.shape[1:3]
        track.pix_fmt = stored
        for frame in frames:
            container.mux(track.encode(av.VideoFrame.from_ndarray(frame, format=given or stored)))
        container.mux(track.encode())


def unnamed_film(path, frames):
    """Uncompressed 16 bits a sample, which FFmpeg takes for colours."""
    import av

    height, width = frames.shape[1:]
    with av.open(path, "w") as container:
        track = container.add_stream("rawvideo", rate=9)
        track.width, track.height, track.pix_fmt = width, height, "rgb555le"
        for frame in frames:
            shown = av.VideoFrame(width, height, "rgb555le")
            shown.planes[0].update(frame.astype("<u2").tobytes().ljust(shown.planes[0].buffer_size, b"\0"))
            container.mux(track.encode(shown))
        container.mux(track.encode())


#: A FLIR T640's constants, as its files hold them.
PLANCK = {"r1": 16556.0, "b": 1428.0, "f": 1.0, "o": -342, "r2": 0.0451}
AIR = {"alpha1": 0.006569, "alpha2": 0.01262, "beta1": -0.002276, "beta2": -0.00667, "x": 1.9}
SCENE = {"emissivity": 0.95, "distance": 2.0, "reflected": 293.15, "atmosphere": 295.15, "humidity": 0.5}
WINDOW = {"window": 298.15, "window_transmission": 0.9}


def fff(frame, packed=None, order="<", camera=True):
    """FLIR's FFF of one frame, with what the camera says of itself."""
    height, width = frame.shape
    pixels = frame.astype(f"{order}u2").tobytes() if packed is None else packed
    raw = struct.pack(f"{order}HHH", 2, width, height).ljust(32, b"\0") + pixels
    about = bytearray(struct.pack(f"{order}H", 2).ljust(0x310, b"\0"))
    for offset, value in {
        0x20: SCENE["emissivity"],
        0x24: SCENE["distance"],
        0x28: SCENE["reflected"],
        0x2C: SCENE["atmosphere"],
        0x30: WINDOW["window"],
        0x34: WINDOW["window_transmission"],
        0x3C: SCENE["humidity"],
        0x58: PLANCK["r1"],
        0x5C: PLANCK["b"],
        0x60: PLANCK["f"],
        0x30C: PLANCK["r2"],
        **dict(zip(range(0x70, 0x84, 4), AIR.values(), strict=True)),
    }.items():
        struct.pack_into(f"{order}f", about, offset, value)
    struct.pack_into(f"{order}i", about, 0x308, PLANCK["o"])
    records = [(1, raw), (32, bytes(about))][: 1 + camera]
    content = b"FFF\0" + b"CAMCTRL".ljust(16, b"\0") + struct.pack(">III", 100, 64, len(records))
    content = content.ljust(64, b"\0")
    offset = 64 + 32 * len(records)
    for kind, record in records:
        content += struct.pack(">HHIIII", kind, 1, 100, 1, offset, len(record)).ljust(32, b"\0")
        offset += len(record)
    return content + b"".join(record for _, record in records)


def seq(path, frames):
    path.write_bytes(b"".join(map(fff, frames)))


def csq(path, frames):
    path.write_bytes(b"".join(fff(frame, imagecodecs.jpegls_encode(frame)) for frame in frames))


def jpeg_of(picture, parts):
    """A grey JPEG of an array (h, w), with segments of a marker and a content before its picture."""
    buffer = io.BytesIO()
    Image.fromarray(picture).save(buffer, format="JPEG")
    segments = b"".join(b"\xff" + bytes([marker]) + (len(part) + 2).to_bytes(2) + part for marker, part in parts)
    return buffer.getvalue()[:2] + segments + buffer.getvalue()[2:]


def jpeg_with(marker, parts, size):
    """A uniform JPEG of `size` (h, w) with segments of one marker before its picture."""
    return jpeg_of(np.full(size, 90, np.uint8), [(marker, part) for part in parts])


def flir_jpeg(path, frames, packed=None, step=400):
    content = fff(frames[0], packed)
    parts = [content[at : at + step] for at in range(0, len(content), step)]
    marked = [b"FLIR\0\1" + bytes([k, len(parts) - 1]) + part for k, part in enumerate(parts)]
    path.write_bytes(jpeg_with(0xE1, marked, frames.shape[1:]))


def flir_jpeg_png(path, frames):
    flir_jpeg(path, frames, imagecodecs.png_encode(frames[0].byteswap()))


def dji_jpeg(path, frames, shown=None):
    content = frames[0].astype("<u2").tobytes()
    parts = [content[at : at + 60_000] for at in range(0, len(content), 60_000)]
    path.write_bytes(jpeg_with(0xE3, parts, shown or frames.shape[1:]))


def infiray_jpeg(path, frames):
    """The first frame as InfiRay's IJPEG: a picture of 16 bits, then kelvin x 64, of a picture twice as large."""
    planes = bytes(frames[0].nbytes) + frames[0].astype("<u2").tobytes()
    parts = [(0xE2, b"\0\1\0\0IJPEG".ljust(64, b"\0"))]
    parts += [(0xE3, planes[at : at + 65000]) for at in range(0, len(planes), 65000)]
    path.write_bytes(jpeg_of(np.kron(frames[0] >> 8, np.ones((2, 2))).astype(np.uint8), parts))


def cptv(path, frames, bits=16):
    """Differences along a line that runs there and back, of the differences from frame to frame."""

    def field(letter, value):
        return bytes([len(value)]) + letter + value

    height, width = frames.shape[1:]
    header = [(b"T", bytes(8)), (b"X", struct.pack("<I", width)), (b"Y", struct.pack("<I", height)), (b"C", b"\1")]
    content = b"CPTV\2H" + bytes([len(header)]) + b"".join(field(*each) for each in header)
    last = np.zeros(height * width, int)
    for frame in frames:
        line = frame.astype(int)
        line[1::2] = line[1::2, ::-1]
        change, last = line.ravel() - last, line.ravel()
        steps = "".join(f"{step % 2**bits:0{bits}b}" for step in np.diff(change))
        packed = struct.pack("<i", change[0]) + int(steps.ljust(-(-len(steps) // 8) * 8, "0"), 2).to_bytes(
            -(-len(steps) // 8)
        )
        section = [(b"w", bytes([bits])), (b"f", struct.pack("<I", len(packed)))]
        content += b"F" + bytes([len(section)]) + b"".join(field(*each) for each in section) + packed
    path.write_bytes(gzip.compress(content, 1))


def changed(write, change):
    """A writer of what `change` makes of the bytes that `write` writes."""

    def write_changed(path, frames):
        write(path, frames)
        path.write_bytes(change(path.read_bytes()))

    return write_changed


def replaced(content, mark, skip, new):
    """Bytes with others `skip` bytes after the start of a mark."""
    at = content.index(mark) + skip
    return content[:at] + new + content[at + len(new) :]


def forged(write, mark, skip, new):
    return changed(write, lambda content: replaced(content, mark, skip, new))


def cut(write, count):
    return changed(write, lambda content: content[:-count])


def needs(library, *values):
    """A parameter of a test that is left out where `library` is not installed."""
    missing = importlib.util.find_spec(library) is None
    return pytest.param(*values, marks=pytest.mark.skipif(missing, reason=f"{library} is not installed"))


def assert_read(path, frames, **options):
    """A file gives these frames, whole and frame by frame; returns what is read of it."""
    read = read_frames(path, **options)
    np.testing.assert_array_equal(read.frames, frames)
    np.testing.assert_array_equal(list(stream_frames(path, **options)), frames)
    return read


def small_picture(kind):
    return lambda path, frames: Image.fromarray(frames[0].astype(np.uint8)).save(path, format=kind)


def colour_png(path, frames):
    path.write_bytes(imagecodecs.png_encode(np.stack([frames[0]] * 4, axis=-1)))


#: Files of each reader that reads files alone, by its name: at least one, or a test fails.
FILES = {
    "npy": npy,
    "npz": lambda path, frames: np.savez(path, frames=frames),
    "npz, compressed": npz,
    "tiff": tiff,
    "tiff, big": big_tiff,
    "tiff, lzw": lzw_tiff,
    "tiff, imagej": lambda path, frames: tifffile.imwrite(path, frames, imagej=True),
    "png": png,
    "png, colour": colour_png,
    "picture, jpeg": small_picture("JPEG"),
    "picture, bmp": small_picture("BMP"),
    "mat": mat,
    "hdf5": hdf5,
    "hdf5, matlab": mat73,
    "flir_jpeg": flir_jpeg,
    "flir_jpeg, png": flir_jpeg_png,
    "flir_sequence, seq": seq,
    "flir_sequence, csq": csq,
    "cptv": cptv,
    "pgm": pgm,
    "dji_jpeg": lambda path, frames: dji_jpeg(path, np.resize(frames, (1, 120, 160))),
    "infiray_jpeg": lambda path, frames: infiray_jpeg(path, np.resize(frames, (1, 120, 160))),
    "video, mkv": film,
}


def written(folder, kind, frames):
    """A file of that kind, whose name says nothing of it; the test is skipped where its library is missing."""
    library = {"hdf5": "h5py", "video": "av"}.get(kind.partition(",")[0])
    if library is not None:
        pytest.importorskip(library)
    FILES[kind](folder / "file.mkv", frames)
    return next(folder.iterdir())
