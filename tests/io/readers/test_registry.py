import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import recordings
from documentation import ROOT, rows

from deepir.errors import DataError
from deepir.io import read_frames, readers


@pytest.mark.parametrize(("name", "write"), recordings.MANY)
def test_every_format_gives_the_same_frames_exactly(tmp_path, burst, name, write):
    write(tmp_path / name, burst)
    read = read_frames(tmp_path / name)
    assert read.frames.dtype == np.float32
    assert read.dtype == "uint16"
    assert read.source == str(tmp_path / name)
    np.testing.assert_array_equal(read.frames, burst)


@pytest.mark.parametrize(("name", "write"), recordings.ONE)
def test_every_picture_gives_its_frame_exactly(tmp_path, burst, name, write):
    write(tmp_path / name, burst)
    read = read_frames(tmp_path / name)
    assert read.dtype == "uint16"
    np.testing.assert_array_equal(read.frames, burst[:1])


@pytest.mark.parametrize(("name", "write"), [*recordings.MANY, *recordings.ONE])
def test_contents_decide_the_format_and_not_the_name(tmp_path, burst, name, write):
    write(tmp_path / name, burst)
    if (tmp_path / name).is_file():
        (tmp_path / name).rename(tmp_path / "burst.xyz")
        np.testing.assert_array_equal(read_frames(tmp_path / "burst.xyz").frames[0], burst[0])


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


def test_a_missing_file_is_answered_with_the_nearest_names(tmp_path, burst):
    np.save(tmp_path / "flight_07.npy", burst)
    with pytest.raises(DataError, match=r"no such file or folder; did you mean 'flight_07\.npy'\?"):
        read_frames(tmp_path / "flight_7.npy")
    with pytest.raises(DataError, match="there is no folder"):
        read_frames(tmp_path / "nowhere" / "a.npy")


def test_an_empty_file_says_so(tmp_path):
    (tmp_path / "a.npy").touch()
    with pytest.raises(DataError, match="the file is empty"):
        read_frames(tmp_path / "a.npy")


def test_an_unknown_format_lists_those_there_are(tmp_path):
    (tmp_path / "a.npz").write_text("frames")
    with pytest.raises(
        DataError, match=r"not a format that deepir reads .*\.npy, \.npz, \.pgm, \.png, .*\.tif"
    ):
        read_frames(tmp_path / "a.npz")


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


def test_the_table_of_formats_is_that_of_the_readers():
    shown = {
        name.strip("`"): tuple(re.findall(r"`(\.\w+)`", suffixes))
        for name, suffixes, _ in rows(ROOT / "docs/reference/files.md", "# Files")
    }
    there = {reader.name: reader.suffixes for reader in readers.all_readers()}
    assert shown == there
    assert list(shown) == sorted(shown)
