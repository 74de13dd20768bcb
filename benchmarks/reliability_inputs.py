"""Damaged inputs of every kind that is read: a number stands for one of them, the same each time."""

from __future__ import annotations

import functools
import gzip
import io
import struct
import tempfile
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import av
import imagecodecs
import numpy as np
import tifffile
from PIL import Image
from reliability_bombs import BOMBS, recordings

from deepir.config import SHIPPED_CONFIGS

FRAMES = np.random.default_rng(0).integers(3000, 9000, (2, 8, 10), dtype=np.uint16)
DJI_FRAMES = np.resize(FRAMES, (1, 120, 160))  # the smallest plane that its reader knows
BOMB_EVERY = 1000  # inputs, of which one is a bomb or a cycle: they take longest
HEAD_BYTES = 256  # in which half of all changes are
MAX_CHANGES = 4  # of one input
SETTINGS = "settings.txt"  # name of the file of `key=value` lines
ENVI_HEADER = (
    b"ENVI\nsamples = 10\nlines = 8\nbands = 2\nheader offset = 0\ndata type = 12\ninterleave = bsq\n"
    b"byte order = 0\ndata ignore value = 65535\n"
)
KEYS = ("data.frames=0:2", "data.crop=[0,16,0,16]", "prior=tv", "seed=3", "physics.warp.motion=affine",
        "noise.read=2", "solver.max_iterations=3", "threads=1", "data.raw={width: 10, height: 8}",
        "effects={shading: false}")  # fmt: skip
#: What a number in a text is replaced by.
NUMBERS = (b"0", b"-1", b"1", b"65536", b"4294967295", b"99999999999999999999", b"1e400", b"nan", b"", b"[1,2]", b"*a")
Files = dict[str, bytes]


@dataclass(frozen=True)
class Input:
    """Files by name, of which the first is opened; `options` are those of `read_frames`."""

    kind: str
    damage: str
    files: Files
    options: dict[str, Any] = field(default_factory=dict)
    links: dict[str, str] = field(default_factory=dict)


def make_input(number: int) -> Input:
    """The input of this number."""
    rng = np.random.default_rng(number)
    if number % BOMB_EVERY == 0:
        name = str(rng.choice(list(BOMBS)))
        files, links = BOMBS[name](rng)
        return Input("bomb, cycle", name, files, links=links)
    whole = whole_files()
    kind = str(rng.choice(list(whole)))
    files = dict(whole[kind])
    name = str(rng.choice(list(files)))
    damage = str(rng.choice(list(DAMAGES)))
    content = files[name]
    seal = SEALS.get(kind) if rng.random() < 0.5 else None
    content = seal[0](content) if seal else content
    content = DAMAGES[damage](rng, content)
    files[name] = seal[1](content) if seal else content
    return Input(kind, damage, files, _layout(rng) if kind == "raw" else {})


@functools.cache
def whole_files() -> dict[str, Files]:
    """Whole files of each kind."""
    found: dict[str, Files] = {}
    for name, (kind, write) in WRITERS.items():
        with tempfile.TemporaryDirectory() as folder:
            write(Path(folder) / name, DJI_FRAMES if kind.startswith(("DJI", "InfiRay")) else FRAMES)
            found[kind] = {name: (Path(folder) / name).read_bytes()}
    png = [imagecodecs.png_encode(frame) for frame in FRAMES]
    found["folder"] = {f"folder/{k}.png": each for k, each in enumerate(png)}
    samples = FRAMES.tobytes()
    found["ENVI"] = {"a.img": samples, "a.hdr": ENVI_HEADER}
    found["raw"] = {"a.raw": samples}
    found["YAML"] = {"a.yaml": (SHIPPED_CONFIGS / "sr.yaml").read_bytes()}
    found["settings"] = {SETTINGS: "\n".join(KEYS).encode()}
    return found


def _picture(path: Path, frames: Any) -> None:
    Image.fromarray((frames[0] >> 6).astype(np.uint8)).save(path)


def _stored_npz(path: Path, frames: Any) -> None:
    np.savez(path, frames=frames, scene=frames[0].astype(float))


def _plain_pgm(path: Path, frames: Any) -> None:
    path.write_bytes(b"".join(b"P2\n# a\n10 8\n9000\n" + b" ".join(b"%d" % v for v in f.flat) + b"\n" for f in frames))


def _y16(path: Path, frames: Any) -> None:
    recordings.film(path, frames, "rawvideo", "gray16le")
    content = bytearray(path.read_bytes())
    for at in (content.index(b"vids") + 4, content.index(b"strf") + 8 + 16):  # of the track, and of its pictures
        content[at : at + 4] = b"Y16 "
    path.write_bytes(content)


def _lossy(path: Path, frames: Any) -> None:
    with av.open(path, "w") as container:
        track = container.add_stream("mpeg4", rate=30)
        track.height, track.width, track.pix_fmt = 16, 20, "yuv420p"
        for frame in frames:
            luma = np.kron(frame >> 6, np.ones((2, 2))).astype(np.uint8)
            yuv = np.concatenate((luma, np.full((8, 20), 128, np.uint8)))
            container.mux(track.encode(av.VideoFrame.from_ndarray(yuv, format="yuv420p")))
        container.mux(track.encode())


def _aff(path: Path, frames: Any) -> None:
    path.write_bytes(b"AFF\0" + recordings.fff(frames[0])[4:])


def _deflate(path: Path, frames: Any) -> None:
    tifffile.imwrite(path, frames, compression="deflate", imagej=False, photometric="minisblack")


#: Names of files: kinds, and what writes them.
WRITERS: dict[str, tuple[str, Callable[..., Any]]] = {
    "a.npy": ("npy", recordings.npy),
    "a.npz": ("npz", recordings.npz),
    "stored.npz": ("npz, stored", _stored_npz),
    "a.tif": ("TIFF", recordings.tiff),
    "big.tif": ("BigTIFF", recordings.big_tiff),
    "lzw.tif": ("TIFF, LZW", recordings.lzw_tiff),
    "deflate.tif": ("TIFF, deflate", _deflate),
    "a.png": ("PNG", recordings.png),
    "a.jpg": ("JPEG", _picture),
    "a.bmp": ("BMP", _picture),
    "a.pgm": ("PGM", recordings.pgm),
    "plain.pgm": ("PGM, plain", _plain_pgm),
    "a.mat": ("MATLAB", recordings.mat),
    "a.h5": ("HDF5", recordings.hdf5),
    "v73.mat": ("MATLAB 7.3", recordings.mat73),
    "a.mkv": ("FFV1", recordings.film),
    "y16.avi": ("AVI, Y16", _y16),
    "a.mp4": ("MPEG-4", _lossy),
    "a.seq": ("FLIR SEQ", recordings.seq),
    "a.csq": ("FLIR CSQ", recordings.csq),
    "aff.seq": ("FLIR AFF", _aff),
    "flir.jpg": ("FLIR JPEG", recordings.flir_jpeg),
    "flir_png.jpg": ("FLIR JPEG, PNG", recordings.flir_jpeg_png),
    "dji.jpg": ("DJI JPEG", recordings.dji_jpeg),
    "infiray.jpg": ("InfiRay JPEG", recordings.infiray_jpeg),
    "a.cptv": ("CPTV", recordings.cptv),
}


def _place(rng: np.random.Generator, size: int) -> int:
    near = rng.random() < 0.5
    return int(rng.integers(max(1, min(size, HEAD_BYTES) if near else size)))


def _flip(rng: np.random.Generator, content: bytes) -> bytes:
    found = bytearray(content)
    for _ in range(rng.integers(1, MAX_CHANGES + 1) if found else 0):
        found[_place(rng, len(found))] ^= int(rng.integers(1, 256))
    return bytes(found)


def _splice(rng: np.random.Generator, content: bytes) -> bytes:
    others = [content, *(next(iter(files.values())) for files in whole_files().values())]
    other = others[int(rng.integers(len(others))) if rng.random() < 0.5 else 0]
    return content[: _place(rng, len(content))] + other[_place(rng, len(other)) :]


def _truncate(rng: np.random.Generator, content: bytes) -> bytes:
    start, stop = sorted((_place(rng, len(content)), _place(rng, len(content))))
    return (content[:start], content[:start] + content[stop:], content[:stop] + content[start:])[rng.integers(3)]


def _fields(rng: np.random.Generator, content: bytes) -> bytes:
    """Lengths and offsets: numbers of 16, 32 or 64 bits that become zero, all ones, huge, their own place ..."""
    found = bytearray(content)
    for _ in range(rng.integers(1, MAX_CHANGES)):
        kind = "<>"[rng.integers(2)] + "HIIIQ"[rng.integers(5)]
        size, at = struct.calcsize(kind), _place(rng, len(found))
        at -= at % 2 if rng.random() < 0.8 else 0
        if at + size > len(found):
            continue
        old, most = struct.unpack_from(kind, found, at)[0], 2 ** (8 * size)
        values = (0, 1, most - 1, most // 2, most // 2 - 1, at, len(found), len(found) - at, old + 1, old - 1, 2 * old,
                  old << 8, old // 2, int(rng.integers(len(found))))  # fmt: skip
        struct.pack_into(kind, found, at, values[rng.integers(len(values))] % most)
    return bytes(found)


def _digits(rng: np.random.Generator, content: bytes) -> bytes:
    """Numbers in texts: headers of arrays, pictures and samples, settings."""
    at = _place(rng, len(content))
    begin = next((k for k in range(at, len(content)) if content[k : k + 1].isdigit()), at)
    end = next((k for k in range(begin, len(content)) if not content[k : k + 1].isdigit()), len(content))
    return content[:begin] + NUMBERS[rng.integers(len(NUMBERS))] + content[end:]


DAMAGES: dict[str, Callable[[np.random.Generator, bytes], bytes]] = {
    "bytes": _flip,
    "splice": _splice,
    "truncation": _truncate,
    "fields": _fields,
    "digits": _digits,
}


def _layout(rng: np.random.Generator) -> dict[str, Any]:
    sides = (0, 1, 2, 5, 8, 10, 16, 40, 2**15, 2**31)
    return {
        "raw": {
            "width": int(rng.choice(sides)),
            "height": int(rng.choice(sides)),
            "bits": int(rng.integers(-1, 18)),
            "offset": int(rng.choice((0, 1, 80, 320, 2**40))),
            "type": [None, "uint8", "int16", "float32", "float64"][rng.integers(5)],
        }
    }


def _open_npz(content: bytes) -> bytes:
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        return archive.read("frames.npy")


def _close_npz(content: bytes) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("frames.npy", content)
    return buffer.getvalue()


def _close_png(content: bytes) -> bytes:
    """Checksums of a PNG's chunks put right."""
    found, at = bytearray(content), 8
    while at + 12 <= len(found):
        end = at + 8 + int.from_bytes(found[at : at + 4])
        if end + 4 > len(found):
            break
        found[end : end + 4] = zlib.crc32(found[at + 4 : end]).to_bytes(4)
        at = end + 4
    return bytes(found)


#: What takes the packing, or the checksums, off a file, and what puts them on again after the damage.
SEALS: dict[str, tuple[Callable[[bytes], bytes], Callable[[bytes], bytes]]] = {
    "npz": (_open_npz, _close_npz),
    "CPTV": (gzip.decompress, lambda content: gzip.compress(content, 1)),
    "PNG": (bytes, _close_png),
    "folder": (bytes, _close_png),
}
