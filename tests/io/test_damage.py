"""Whatever happens to a file: frames or a `DeepIRError`, never another exception, never a warning."""

import os
import time

import numpy as np
import pytest
import recordings
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from deepir.arrays.samples import as_float32
from deepir.errors import DeepIRError
from deepir.io import read_frames, readers, stream_frames
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
    """The bytes of each kind of file, written once."""
    known = {}

    def of(kind):
        if kind not in known:
            known[kind] = recordings.written(tmp_path_factory.mktemp("whole"), kind, RAMP).read_bytes()
        return known[kind]

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
    streamed = refused_in_one_line(path, lambda: list(stream_frames(path)))
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
def test_whole_files_are_read(tmp_path, contents, kind):
    (tmp_path / "file").write_bytes(contents(kind))
    reader = readers.find_reader(tmp_path / "file")
    assert reader.name == kind.partition(",")[0]
    assert read_frames(tmp_path / "file").frames.shape[1:] in ((18, 16), (120, 160))


@pytest.mark.parametrize("kind", recordings.FILES)
@damaged
@given(share=st.floats(0, 1, exclude_max=True))
def test_truncated_files_lose_nothing_or_are_refused_in_one_line(tmp_path, contents, kind, share):
    content = contents(kind)
    whole = read_or_refuse(tmp_path / "file", content)
    frames = read_or_refuse(tmp_path / "file", content[: int(share * len(content))])
    if frames is not None:  # only padding, a checksum or an end mark is gone
        np.testing.assert_array_equal(frames, whole[: len(frames)])
        assert len(frames) == len(whole) or kind in OPEN_ENDED


@pytest.mark.parametrize("kind", recordings.FILES)
@damaged
@given(places=st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.integers(1, 255)), min_size=1, max_size=4))
def test_flipped_bits_are_read_or_refused_in_one_line(tmp_path, contents, kind, places):
    content = bytearray(contents(kind))
    for where, bits in places:
        content[int(where * len(content))] ^= bits
    read_or_refuse(tmp_path / "file", bytes(content))


@pytest.mark.parametrize("kind", recordings.FILES)
@damaged
@given(where=st.integers(0, 255), bits=st.integers(1, 255))
def test_damaged_headers_are_read_or_refused_in_one_line(tmp_path, contents, kind, where, bits):
    content = bytearray(contents(kind))
    content[where % len(content)] ^= bits
    read_or_refuse(tmp_path / "file", bytes(content))


@pytest.mark.parametrize("kind", recordings.FILES)
@damaged
@given(content=st.binary(max_size=200), kept=st.integers(4, 80))
def test_rubbish_behind_a_signature_is_refused_in_one_line(tmp_path, contents, kind, content, kept):
    read_or_refuse(tmp_path / "file", contents(kind)[:kept] + content)
