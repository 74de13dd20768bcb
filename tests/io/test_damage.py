"""Whatever happens to a file: frames or a `DeepIRError`, never another exception, never a warning."""

import functools
import os
import time

import numpy as np
import pytest
import recordings
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from deepir.arrays.samples import as_float32
from deepir.errors import DeepIRError
from deepir.io import read_frames, readers
from deepir.kernels.memory import peak_memory

RAMP = np.arange(2 * 18 * 16, dtype=np.uint16).reshape(2, 18, 16)


#: Recordings that do not say how many frames they have: where one ends, there may have been more.
OPEN_ENDED = ("pgm", "flir_sequence, seq", "flir_sequence, csq", "video, mkv")

damaged = settings(
    max_examples=int(os.environ.get("DEEPIR_FUZZ", "60")),
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)


@pytest.fixture(scope="module")
def contents(tmp_path_factory):
    """The bytes of each kind of file, and its frames, written and read once."""

    @functools.cache
    def of(kind):
        path = recordings.written(tmp_path_factory.mktemp("whole"), kind, RAMP)
        content = path.read_bytes()
        return content, read_or_refuse(path.with_name("file"), content)

    return of


@pytest.fixture(scope="module", autouse=True)
def modest():
    """However much a file claims, reading none of them takes a gigabyte."""
    before = peak_memory()
    yield
    assert peak_memory() - before < 2**10  # MiB


def read_or_refuse(path, content):
    """The frames in `content`, or None where they are refused; frame by frame they are the same."""
    path.write_bytes(content)
    begun = time.perf_counter()
    frames = refused_in_one_line(path, lambda: read_frames(path).frames)
    streamed = refused_in_one_line(path, lambda: list(recordings.stream_frames(path)))
    assert time.perf_counter() - begun < 5  # seconds
    if frames is not None and streamed is not None:
        np.testing.assert_array_equal([as_float32(frame) for frame in streamed], frames)
    return frames


def refused_in_one_line(path, read):
    """What `read` gives, or None where it raises what a user may see."""
    found, message = None, ""
    try:
        found = read()
    except DeepIRError as error:
        message = str(error)
    assert "\n" not in message
    assert not message or str(path) in message
    return found


def test_every_reader_is_tried():
    names = {reader.name for reader in readers.all_readers()}
    assert names - {"folder", "envi"} == {kind.partition(",")[0] for kind in recordings.FILES}


@pytest.mark.parametrize("kind", recordings.FILES)
@damaged
@given(share=st.floats(0, 1, exclude_max=True))
def test_truncated_files_lose_nothing_or_are_refused_in_one_line(tmp_path, contents, kind, share):
    content, whole = contents(kind)
    frames = read_or_refuse(tmp_path / "file", content[: int(share * len(content))])
    if frames is not None:  # only padding, a checksum or an end mark is gone
        np.testing.assert_array_equal(frames, whole[: len(frames)])
        assert len(frames) == len(whole) or kind in OPEN_ENDED


def flipped(content, bits):
    """Bytes with bits changed, by their places."""
    changed = bytearray(content)
    for where, mask in bits.items():
        changed[where % len(changed)] ^= mask
    return bytes(changed)


#: Strategies, and what they make of the bytes of a file.
DAMAGE = {
    "flipped bits": (st.dictionaries(st.integers(0, 2**20), st.integers(1, 255), min_size=1, max_size=4), flipped),
    "a bit of the header": (st.dictionaries(st.integers(0, 255), st.integers(1, 255), min_size=1, max_size=1), flipped),
    "rubbish behind a signature": (
        st.tuples(st.integers(4, 80), st.binary(max_size=200)),
        lambda content, new: content[: new[0]] + new[1],
    ),
}


@pytest.mark.parametrize("what", DAMAGE)
@pytest.mark.parametrize("kind", recordings.FILES)
@damaged
@given(data=st.data())
def test_damaged_files_are_read_or_refused_in_one_line(tmp_path, contents, kind, what, data):
    strategy, damage = DAMAGE[what]
    read_or_refuse(tmp_path / "file", damage(contents(kind)[0], data.draw(strategy)))
