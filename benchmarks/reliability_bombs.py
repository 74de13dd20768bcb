"""Small inputs that stand for much, or for themselves: bombs of compressors and cycles of directories and links."""

from __future__ import annotations

import gzip
import io
import runpy
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import h5py
import imagecodecs
import numpy as np
import scipy.io
import tifffile

#: The files that the tests write.
recordings = SimpleNamespace(**runpy.run_path(str(Path(__file__).parents[1] / "tests" / "recordings.py")))
SIDE = 4000  # px, of a frame of zeros that a compressor packs into 20 kB
Made = tuple[dict[str, bytes], dict[str, str]]


def _file(name: str, content: bytes) -> Made:
    return {name: content}, {}


def _npz(rng: np.random.Generator) -> Made:
    """Zeros, many members, or members that hold archives."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        array = io.BytesIO()
        np.save(array, np.zeros((SIDE, SIDE), np.uint8))
        for k in range(int(rng.choice([1, 3]))):
            archive.writestr(f"frames{k or ''}.npy", array.getvalue())
        for k in range(int(rng.choice([0, 3000]))):
            archive.writestr(f"{k}.npy", b"\x93NUMPY")
    return _file("a.npz", buffer.getvalue())


def _png(rng: np.random.Generator) -> Made:
    return _file("a.png", imagecodecs.png_encode(np.zeros((SIDE, SIDE), rng.choice([np.uint8, np.uint16])), level=9))


def _tiff(rng: np.random.Generator) -> Made:
    buffer = io.BytesIO()
    packed = str(rng.choice(["deflate", "lzw", "zstd", "packbits"]))
    tifffile.imwrite(buffer, np.zeros((SIDE, SIDE), np.uint8), compression=packed, photometric="minisblack")
    return _file("a.tif", buffer.getvalue())


def _directories(rng: np.random.Generator) -> Made:
    """A chain of directories without end: the next of each is itself, the first, or thousands follow."""
    entries = struct.pack("<H", 8) + b"".join(
        struct.pack("<HHII", tag, kind, 1, value)
        for tag, kind, value in ((256, 4, 10), (257, 4, 8), (258, 3, 16), (259, 3, 1), (262, 3, 1), (273, 4, 8),
                                 (279, 4, 160), (330, 4, 8))
    )  # fmt: skip
    size, count = len(entries) + 4, int(rng.choice([1, 2, 2000]))
    last = int(rng.choice([0, 8, 8 + size * (count - 1)]))
    chain = b"".join(entries + struct.pack("<I", 8 + size * (k + 1) if k < count - 1 else last) for k in range(count))
    return _file("a.tif", b"II*\0" + struct.pack("<I", 8) + chain)


def _hdf5(rng: np.random.Generator) -> Made:
    """Groups that hold themselves or thousands of arrays, frames of which nothing is stored, zeros."""
    buffer = io.BytesIO()
    with h5py.File(buffer, "w") as file:
        kind = int(rng.integers(5))
        if kind == 0:
            file["a"] = file["/"]
        elif kind == 1:
            file["a"], file["b"] = h5py.SoftLink("/b"), h5py.SoftLink("/a")
            file["frames"] = h5py.ExternalLink("a.h5", "/frames")
        elif kind == 2:
            for k in range(3000):
                file[f"g{k % 7}/{k}"] = np.zeros((2, 2))
        elif kind == 3:
            file.create_dataset("frames", (int(rng.integers(1, 300)), 1000, 1000), "u1", chunks=(1, 1000, 1000))
        else:
            file.create_dataset("frames", data=np.zeros((1, SIDE, SIDE), "u1"), compression="gzip")
    return _file("a.h5", buffer.getvalue())


def _mat(rng: np.random.Generator) -> Made:
    buffer = io.BytesIO()
    scipy.io.savemat(buffer, {"frames": np.zeros((SIDE, SIDE), np.uint8)}, do_compression=True)
    return _file("a.mat", buffer.getvalue())


def _cptv(rng: np.random.Generator) -> Made:
    """Frames of zeros, or a single field as long as the stream."""
    head = b"CPTV\2H\2\4X" + struct.pack("<I", SIDE) + b"\4Y" + struct.pack("<I", SIDE)
    size = SIDE * SIDE
    frame = b"F\2\1w\1\4f" + struct.pack("<I", size // 8 + 4) + bytes(size // 8 + 4)
    return _file("a.cptv", gzip.compress(head + frame * int(rng.integers(1, 4)) + bytes(10**7) * int(rng.integers(2))))


def _seq(rng: np.random.Generator) -> Made:
    """Thousands of frames of one pixel, or of no record."""
    one = recordings.fff(np.ones((1, 1), np.uint16)) if rng.random() < 0.5 else b"FFF\0".ljust(64, b"\0")
    return _file("a.seq", one * (100_000 // len(one)))


def _yaml(rng: np.random.Generator) -> Made:
    levels = [b"a0: &a0 [1, 2, 3, 4, 5, 6, 7, 8, 9]"]
    levels += [b"a%d: &a%d [%s]" % (k, k, b", ".join([b"*a%d" % (k - 1)] * 9)) for k in range(1, 10)]
    texts = (b"\n".join(levels), b"a: &a [*a]", b"[" * 20_000, b"a: " + b"9" * 90_000, b"data: &d {<<: *d}",
             b"data: {path: ${data.path}}", b"a: &a {b: &b {c: *a}}\nd: *b", b"? " * 5000)  # fmt: skip
    return _file("a.yaml", texts[rng.integers(len(texts))])


def _links(rng: np.random.Generator) -> Made:
    """A folder with links to itself, to what is not there, in a circle, and to what never ends."""
    whole = {"folder/1.png": imagecodecs.png_encode(np.ones((8, 10), np.uint16))}
    kinds = ({"folder/2.png": "."}, {"folder/2.png": "2.png"}, {"folder/2.png": "absent.png"},
             {"folder/2.png": "3.png", "folder/3.png": "2.png"}, {"folder/2.png": "/dev/zero"},
             {"folder/2.png": "1.png"}, {"folder/folder": "../folder"})  # fmt: skip
    return whole, kinds[rng.integers(len(kinds))]


BOMBS: dict[str, Callable[[np.random.Generator], Made]] = {
    each.__name__[1:]: each for each in (_npz, _png, _tiff, _directories, _hdf5, _mat, _cptv, _seq, _yaml, _links)
}
