"""A small burst has one thread, a large one those that there are, or that are given; afterwards all is as before."""

import pytest
import torch

from deepir.kernels import memory, threads


@pytest.mark.parametrize("most", [None, 3])
def test_the_loops_have_the_threads_of_a_large_burst_and_layers_of_networks_too(most):
    before = torch.get_num_threads()
    assert threads.count() == threads.available() == min(before, threads.MAX_THREADS)
    for samples, expected in (
        (threads.MIN_PARALLEL_SAMPLES - 1, 1),
        (threads.MIN_PARALLEL_SAMPLES, most or threads.available()),
    ):
        with threads.for_samples(samples, most):
            assert (threads.count(), torch.get_num_threads()) == (expected, 1)
            with threads.for_layers():
                assert torch.get_num_threads() == expected
            assert torch.get_num_threads() == 1
        assert torch.get_num_threads() == before


def test_they_come_back_after_an_error_and_so_does_the_memory():
    before = torch.get_num_threads()
    with pytest.raises(KeyError), threads.for_samples(threads.MIN_PARALLEL_SAMPLES, 2), memory.kept():
        raise KeyError
    assert torch.get_num_threads() == before
