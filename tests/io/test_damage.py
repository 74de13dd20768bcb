"""Whatever happens to a file: frames or a `DeepIRError`, never another exception, never a warning."""

import io

import imagecodecs
import numpy as np
import pytest
import tifffile
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image

from deepir.errors import DeepIRError
from deepir.io import read_frames

RAMP = np.arange(2 * 18 * 16, dtype=np.uint16).reshape(2, 18, 16)


def written(write):
    buffer = io.BytesIO()
    write(buffer)
    return buffer.getvalue()


FILES = {
    "npy": written(lambda file: np.save(file, RAMP)),
    "npz": written(lambda file: np.savez(file, frames=RAMP)),
    "compressed npz": written(lambda file: np.savez_compressed(file, frames=RAMP, other=RAMP)),
    "tiff": written(lambda file: tifffile.imwrite(file, RAMP, photometric="minisblack")),
    "lzw tiff": written(
        lambda file: tifffile.imwrite(file, RAMP, photometric="minisblack", compression="lzw", predictor=True)
    ),
    "imagej tiff": written(lambda file: tifffile.imwrite(file, RAMP, imagej=True)),
    "png": imagecodecs.png_encode(RAMP[0]),
    "colour png": imagecodecs.png_encode(np.stack([RAMP[0]] * 4, axis=-1)),
    **{
        kind: written(
            lambda file, kind=kind: Image.fromarray(RAMP[0].astype(np.uint8)).save(file, format=kind)
        )
        for kind in ("JPEG", "BMP")
    },
}

damaged = settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


def read_or_refuse(path, content):
    """The frames in `content`, or None where they are refused."""
    path.write_bytes(content)
    frames, message = None, ""
    try:
        frames = read_frames(path).frames
    except DeepIRError as error:
        message = str(error)
    assert "\n" not in message
    assert not message or str(path) in message
    return frames


@pytest.mark.parametrize("kind", FILES)
def test_whole_files_are_read(tmp_path, kind):
    (tmp_path / "file").write_bytes(FILES[kind])
    assert read_frames(tmp_path / "file").frames.shape[1:] == (18, 16)


@pytest.mark.parametrize("kind", FILES)
@damaged
@given(share=st.floats(0, 1, exclude_max=True))
def test_truncated_files_lose_nothing_or_are_refused_in_one_line(tmp_path, kind, share):
    whole = read_or_refuse(tmp_path / "file", FILES[kind])
    frames = read_or_refuse(tmp_path / "file", FILES[kind][: int(share * len(FILES[kind]))])
    if frames is not None:  # only padding, a checksum or an end mark is gone
        np.testing.assert_array_equal(frames, whole)


@pytest.mark.parametrize("kind", FILES)
@damaged
@given(
    places=st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.integers(1, 255)), min_size=1, max_size=4)
)
def test_flipped_bits_are_read_or_refused_in_one_line(tmp_path, kind, places):
    content = bytearray(FILES[kind])
    for where, bits in places:
        content[int(where * len(content))] ^= bits
    read_or_refuse(tmp_path / "file", bytes(content))


@pytest.mark.parametrize("kind", FILES)
@damaged
@given(where=st.integers(0, 255), bits=st.integers(1, 255))
def test_damaged_headers_are_read_or_refused_in_one_line(tmp_path, kind, where, bits):
    content = bytearray(FILES[kind])
    content[where % len(content)] ^= bits
    read_or_refuse(tmp_path / "file", bytes(content))


@damaged
@given(content=st.binary(max_size=200), kind=st.sampled_from(sorted(FILES)))
def test_rubbish_behind_a_signature_is_refused_in_one_line(tmp_path, content, kind):
    read_or_refuse(tmp_path / "file", FILES[kind][:12] + content)
