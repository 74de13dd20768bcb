"""The folder of a run: who may write it, how a new run replaces a former one; checkpoints are whole, or refused."""

import json
import os
import random
import re
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest
import torch

import deepir.result
from deepir.errors import ConfigError, DataError
from deepir.storage.folder import RUN_FILES, Record, RunFolder, locked_files, locked_folder
from deepir.storage.stored import FileCheckpoint


@pytest.fixture
def replaced(tmp_path):
    """A folder with a finished run, another that is to replace it, finished too, and a file of the user."""
    folder = RunFolder(tmp_path)
    folder.begin("seed: 1", Record())
    for name in ("result.npz", "flow.png", "metrics.json"):
        (tmp_path / name).write_text("old")
    new = folder.begin("seed: 2", Record())
    for name in ("result.npz", "scene.tiff", "metrics.json"):
        (new.path / name).write_text("new")
    (tmp_path / "notes.txt").write_text("mine")
    return folder


def is_replaced(folder):
    found = {path.name: path.read_text() for path in folder.path.iterdir()}
    assert found.pop("config.yaml").endswith("seed: 2")
    found.pop("run.json")
    return found == {"result.npz": "new", "scene.tiff": "new", "metrics.json": "new", "notes.txt": "mine"}


def test_a_finished_run_takes_the_place_of_the_former_one(replaced):
    replaced.replace_former()
    assert is_replaced(replaced)
    assert replaced.state() == "finished"


@pytest.mark.parametrize("moved", range(6))
@pytest.mark.parametrize("method", ["replace", "unlink"])
def test_a_move_that_was_interrupted_is_finished_by_the_next_command(replaced, monkeypatch, method, moved):
    whole, left = getattr(Path, method), iter(range(moved))

    def interrupted(path, *arguments, **options):
        if next(left, None) is None:
            raise KeyboardInterrupt
        return whole(path, *arguments, **options)

    with monkeypatch.context() as patch:
        patch.setattr(Path, method, interrupted)
        try:
            replaced.replace_former()
        except KeyboardInterrupt:
            assert replaced.state() == ("interrupted" if replaced.unfinished._held() else "finished")
    with replaced.lock():
        pass
    assert is_replaced(replaced)


def test_all_files_of_a_result_are_known():
    written = re.findall(r'"([\w]+\.[a-z]+)"', Path(deepir.result.__file__).read_text())
    assert len(written) > 8
    assert {*written} <= {*RUN_FILES}


def test_a_lock_ends_with_its_process_even_by_sigkill(tmp_path):
    program = (
        "import os, signal, sys; from pathlib import Path; from deepir.storage.folder import locked_folder\n"
        "with locked_folder(Path(sys.argv[1])): os.kill(os.getpid(), signal.SIGKILL)"
    )
    done = subprocess.run([sys.executable, "-c", program, tmp_path / "run"], check=False)
    assert done.returncode == -signal.SIGKILL
    assert (tmp_path / "run/.lock").exists()
    with locked_folder(tmp_path / "run"):
        pass
    assert list((tmp_path / "run").iterdir()) == []


def test_what_is_held_names_its_holder(tmp_path):
    held = (locked_folder(tmp_path / "new/run"), locked_files(tmp_path / "a.tif"))
    others = (locked_folder(tmp_path / "new/run"), locked_files(tmp_path / "a.tif", tmp_path / "a.png"))
    for first, second in zip(held, others, strict=True):
        with first, pytest.raises(ConfigError, match=rf"process {os.getpid()} on .* since 20\d\d-"), second:
            pass
    assert list(tmp_path.iterdir()) == []


def test_what_a_killed_process_left_is_removed_and_nothing_else(tmp_path):
    names = (".a.tif.0123abcd.tif", ".a.0123abcd.tif", ".a.notes.tif", ".b.0123abcd.tif")
    for name in names:
        (tmp_path / name).touch()
    with locked_files(tmp_path / "a.tif"):
        pass
    assert {path.name for path in tmp_path.iterdir()} == {*names} - {".a.0123abcd.tif"}


@pytest.mark.parametrize(
    "content",
    ["[]", "3", "{", "", '{"plugins": 5}', '{"inputs": []}', '{"seconds": "x"}', '{"started": NaN}', "[" * 9999,
     '{"versions": {"torch": 2}}'],
)  # fmt: skip
def test_a_damaged_record_is_one_line(tmp_path, content):
    folder = RunFolder(tmp_path)
    folder.begin("seed: 1", Record())
    (tmp_path / "run.json").write_text(content)
    with pytest.raises(ConfigError, match=r"run\.json: not what a run wrote \(.*\); delete it") as error:
        folder.record()
    assert "\n" not in str(error.value)


def test_a_record_is_read_as_it_was_written(tmp_path):
    record = Record(versions={"torch": "2"}, plugins=["mine"], inputs={"a.npz": "0f"}, started=3.5)
    RunFolder(tmp_path).write_record(record)
    assert RunFolder(tmp_path).record() == record
    assert json.loads((tmp_path / "run.json").read_text())["seconds"] == 0


TENSORS = {"scene": torch.arange(12.0).reshape(3, 4), "count": torch.tensor(3), "none": torch.zeros(0, 2)}
POSITION = {"stage": 1, "history": [{"stage": "scene", "iteration": 1, "loss": 0.1}]}


@pytest.fixture
def saved(tmp_path):
    checkpoint = FileCheckpoint(tmp_path / "checkpoint.safetensors", "this run")
    checkpoint.save(TENSORS, POSITION)
    return checkpoint


def is_whole(found):
    tensors, position = found
    same = tensors.keys() == TENSORS.keys() and all(torch.equal(tensors[k], TENSORS[k]) for k in TENSORS)
    return same and position == POSITION


def test_it_comes_back_exactly(saved):
    assert is_whole(saved.load())


def test_no_flipped_bit_is_taken_for_another_state(saved):
    whole, rng = saved.path.read_bytes(), random.Random(0)
    for bit in rng.sample(range(8 * len(whole)), 200):
        damaged = bytearray(whole)
        damaged[bit // 8] ^= 1 << bit % 8
        saved.path.write_bytes(damaged)
        with suppress(DataError):
            assert is_whole(saved.load())  # a bit of the header's padding


def test_a_state_that_is_cut_off_is_refused(saved):
    whole = saved.path.read_bytes()
    for length in (0, 8, len(whole) // 2, len(whole) - 1):
        saved.path.write_bytes(whole[:length])
        with pytest.raises(DataError):
            saved.load()


def test_a_state_of_another_run_is_refused(saved):
    with pytest.raises(DataError, match="of other frames, another configuration or another version"):
        FileCheckpoint(saved.path, "another").load()
