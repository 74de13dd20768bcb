"""Recordings that are started meanwhile: what is kept, and a disk that is full or slow."""

import errno
import threading
import time
from collections import namedtuple
from contextlib import contextmanager

import numpy as np
import pytest
import tifffile

from deepir.live import recorder
from deepir.live.recorder import PENDING, Recorder

RAW = np.arange(12, dtype=np.uint16).reshape(3, 4)


@pytest.fixture
def made(tmp_path):
    found = Recorder(tmp_path / "new", {"unit": "counts"})
    yield found
    found.close()


@pytest.fixture
def free(monkeypatch):
    """Sets how much of the disk is free."""
    usage = namedtuple("usage", "free")
    return lambda size: monkeypatch.setattr(recorder.shutil, "disk_usage", lambda folder: usage(size))


def until(condition):
    end = time.monotonic() + 5
    while not condition() and time.monotonic() < end:
        time.sleep(0.005)
    assert condition()


def test_frames_are_kept_raw_and_corrected(made, tmp_path):
    made.add(RAW, RAW + 0.4)  # there is no recording yet
    made.start()
    for number in range(3):
        made.add(RAW + number, RAW + number + 0.4)
    made.close()
    assert made.message.startswith("3 frame(s) are in ")
    raw, corrected = (tifffile.imread(list(tmp_path.glob(f"new/live-*-{what}.tif"))) for what in ("raw", "corrected"))
    assert np.array_equal(raw, RAW + np.arange(3, dtype=np.uint16)[:, None, None])
    assert np.array_equal(corrected, raw)


def test_nothing_is_kept_of_a_recording_without_frames(made, tmp_path):
    made.start()
    made.close()
    assert made.message == "nothing was recorded"
    assert list(tmp_path.glob("new/*")) == []


def test_a_recording_ends_before_the_disk_is_full_and_is_kept(made, free, tmp_path):
    free(1e12)
    made.start()
    made.add(RAW, RAW)
    until(lambda: made.frames == 1)
    free(1e6)
    made.add(RAW, RAW)
    until(lambda: not made.recording)
    made.add(RAW, RAW)
    assert made.message.startswith("the disk is full, less than 200 MB are free: 1 frame(s) are in ")
    assert len(list(tmp_path.glob("new/live-*.tif"))) == 2


def test_a_disk_that_is_full_all_the_same_ends_the_recording_in_words(made, monkeypatch, tmp_path):
    @contextmanager
    def full(path, dtype, metadata):
        with tiff(path, dtype, metadata) as write:

            def fail(frame):
                write(frame)
                raise OSError(errno.ENOSPC, "No space left on device")

            yield fail

    tiff = recorder.tiff
    monkeypatch.setattr(recorder, "tiff", full)
    made.start()
    made.add(RAW, RAW)
    until(lambda: not made.recording)
    assert made.message.startswith("the recording has failed, and is not kept: ")
    assert "No space left on device" in made.message
    assert list(tmp_path.glob("new/*")) == []
    until(lambda: made.start() or made.recording)


def test_frames_that_the_disk_is_too_slow_for_are_left_out_and_counted(made, monkeypatch):
    waiting = threading.Event()
    cast = np.ma.filled
    monkeypatch.setattr(recorder.np.ma, "filled", lambda *each: waiting.wait(5) and cast(*each))
    made.start()
    begun = time.perf_counter()
    for _ in range(PENDING + 10):
        made.add(RAW, RAW)
    assert time.perf_counter() - begun < 1
    waiting.set()
    made.close()
    assert made.left_out in (9, 10)
    assert made.frames + made.left_out == PENDING + 10
    assert f"too slow for {made.left_out} more" in made.message


def test_a_recording_replaces_none(made, monkeypatch):
    monkeypatch.setattr(recorder.time, "strftime", lambda form: "live-same")
    for _ in range(2):
        made.start()
        made.add(RAW, RAW)
        made.close()
    assert "live-same-raw.tif exists" in made.message
