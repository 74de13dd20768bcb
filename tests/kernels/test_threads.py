"""A small burst has one thread, a large one those that torch had, or that are given; afterwards all is as before."""

import pytest
import torch

from deepir.kernels import memory, threads


@pytest.mark.parametrize("most", [None, 3])
def test_loops_and_torch_share_the_threads_of_a_large_burst_and_a_small_one_has_one(most):
    before = torch.get_num_threads()
    assert threads.count() == before
    for samples, expected in (
        (threads.MIN_PARALLEL_SAMPLES - 1, 1),
        (threads.MIN_PARALLEL_SAMPLES, most or before),
    ):
        with threads.for_burst(samples, most):
            assert threads.count() == torch.get_num_threads() == expected
        assert torch.get_num_threads() == threads.count() == before


def test_they_come_back_after_an_error_and_so_does_the_memory():
    before = torch.get_num_threads()
    with pytest.raises(KeyError), threads.for_burst(threads.MIN_PARALLEL_SAMPLES, 2), memory.kept():
        raise KeyError
    assert torch.get_num_threads() == threads.count() == before
