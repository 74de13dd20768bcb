"""During a solve the loops have the threads, and torch has one."""

import pytest
import torch

from deepir import memory, threads


def test_loops_have_as_many_as_torch_had_and_torch_has_one():
    before = torch.get_num_threads()
    assert threads.count() == before
    for number in (None, 3):
        with threads.for_loops(number):
            assert threads.count() == (number or before)
            assert torch.get_num_threads() == 1
        assert torch.get_num_threads() == threads.count() == before


def test_they_come_back_after_an_error_and_so_does_the_memory():
    before = torch.get_num_threads()
    with pytest.raises(KeyError), threads.for_loops(2), memory.kept():
        raise KeyError
    assert torch.get_num_threads() == threads.count() == before
