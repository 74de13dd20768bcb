"""Many recordings by one command."""

import json

import numpy as np
import pytest

from deepir.cli import correction
from deepir.simulate import Settings, simulate


@pytest.fixture
def recordings(folder):
    """A folder with three recordings, one of them deeper, and a file that is none."""
    (folder / "in/deeper").mkdir(parents=True)
    for seed, name in enumerate(("a.npz", "b.npz", "deeper/a.npz")):
        burst = simulate(settings=Settings(shape=(40, 48), n_frames=12, counts=True), seed=seed)
        np.savez(folder / "in" / name, frames=burst.frames)
    (folder / "in/notes.md").write_text("none")
    return folder / "in"


@pytest.fixture
def quick(monkeypatch):
    """What stands in for a correction writes its files; the names of those it corrected."""
    corrected = []

    class Found:
        estimate, messages = type("", (), {"kept": "offset", "bad_pixels": np.zeros(3)}), ()

        def __len__(self):
            return 12

    def stand_in(config, *outputs, rounded, quiet):
        corrected.append(config.data.path)
        for path in outputs:
            path.write_text(config.data.path)
        return Found()

    monkeypatch.setattr(correction, "correct_file", stand_in)
    return corrected


def lines(out):
    return [json.loads(line) for line in out.splitlines()]


@pytest.mark.usefixtures("recordings")
def test_what_an_archive_gives_is_what_a_recording_gives_and_what_is_done_is_skipped(deepir, folder):
    status, out, _ = deepir("correct", "in/deeper", "--output-dir", "whole")
    assert status == 0
    assert [(each["file"], each["status"]) for each in lines(out)] == [("in/deeper/a.npz", "corrected")]
    assert json.loads((folder / "whole/a.npz.json").read_text())["frames"] == 12
    assert deepir("correct", "in/deeper/a.npz")[0] == 0
    for end in ("_corrected.tif", "_maps.npz"):
        alone = folder / f"a_corrected{end.removeprefix('_corrected')}"
        assert (folder / f"whole/a.npz{end}").read_bytes() == alone.read_bytes()
    status, out, err = deepir("correct", "in/deeper", "--output-dir", "whole")
    assert (status, out) == (0, "")
    assert "1 recording(s), 1 of them done already" in err


@pytest.mark.usefixtures("recordings")
def test_shards_share_out_the_recordings(deepir, quick):
    for part in ("1/2", "2/2"):
        assert deepir("correct", "in", "--output-dir", "out", "--shard", part)[0] == 0
    assert quick == ["in/a.npz", "in/deeper/a.npz", "in/b.npz"]
    assert "3 recording(s), 3 of them done already" in deepir("correct", "in", "--output-dir", "out")[2]


@pytest.mark.usefixtures("recordings")
def test_what_changed_is_done_again_and_what_was_cut_short_for_the_first_time(deepir, folder, quick):
    command = ("correct", "in", "--output-dir", "out")
    deepir(*command)
    (folder / "out/b.npz_maps.npz").unlink()
    (folder / "out/deeper/a.npz.json").write_text('{"status"')  # killed while it wrote
    quick.clear()
    deepir(*command)
    assert quick == ["in/b.npz", "in/deeper/a.npz"]
    (folder / "in/a.npz").write_bytes((folder / "in/b.npz").read_bytes())
    deepir(*command)
    assert quick[2:] == ["in/a.npz"]
    deepir(*command, "data.crop=[0,32,0,32]")
    assert len(quick) == 6


def test_one_that_is_refused_or_fails_leaves_the_others_alone(deepir, recordings, folder, quick, monkeypatch):
    (recordings / "b.npz").write_bytes(b"damaged")
    stand_in = correction.correct_file

    def reading(config, *outputs, **how):
        from deepir.io import stream_data

        next(stream_data(config.data))
        return stand_in(config, *outputs, **how)

    monkeypatch.setattr(correction, "correct_file", reading)
    status, out, _ = deepir("correct", "in", "--output-dir", "out")
    assert status == 2
    assert [each["status"] for each in lines(out)] == ["corrected", "refused", "corrected"]
    assert "in/b.npz" in lines(out)[1]["messages"][0]

    def broken(config, *outputs, **how):
        raise ZeroDivisionError("of nothing")

    monkeypatch.setattr(correction, "correct_file", broken)
    assert deepir("correct", "in", "--output-dir", "out")[:2] == (2, "")  # refused again without another try
    status, out, _ = deepir("correct", "in", "--output-dir", "other")
    assert status == 1
    assert lines(out)[0]["messages"][0].startswith("ZeroDivisionError: of nothing (test_archive.py:")


@pytest.mark.usefixtures("recordings")
def test_a_list_names_recordings(deepir, folder, quick):
    (folder / "some.txt").write_text("# of today\nin/b.npz\n\nin/deeper/a.npz\n")
    assert deepir("correct", "some.txt", "--output-dir", "out")[0] == 0
    assert quick == ["in/b.npz", "in/deeper/a.npz"]
    assert (folder / "out/in/deeper/a.npz.json").exists()


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("in", "--shard", "3/2"), "--shard 3/2: give I/N"),
        (("in", "--output", "x.tif"), "--output is of one recording"),
        (("in", "solver.threads=2"), "only settings of data.key"),
        (("empty",), "empty: no recordings in it"),
        (("nowhere",), "give a folder of recordings, or a file"),
        (("twice.txt",), "in/a.npz is listed twice"),
    ],
)
@pytest.mark.usefixtures("recordings", "quick")
def test_what_is_wrong_is_said_before_anything_is_written(refused, folder, arguments, says):
    (folder / "empty").mkdir()
    (folder / "twice.txt").write_text("in/a.npz\nin/a.npz\n")
    refused(("correct", *arguments, "--output-dir", "out"), says)
