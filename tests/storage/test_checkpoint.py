"""Checkpoints: whole and of this run, or refused."""

import random
from contextlib import suppress

import pytest
import torch

from deepir.errors import DataError
from deepir.storage.stored import FileCheckpoint

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
