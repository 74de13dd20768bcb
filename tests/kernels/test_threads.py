"""A small burst has one thread, a large one those that there are, or that are given; afterwards all is as before."""

import pytest
import torch

from deepir.kernels import memory, threads


@pytest.mark.parametrize("most", [None, 3])
def test_loops_and_layers_have_several_threads_for_large_bursts_only(most):
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


def test_threads_and_memory_are_restored_after_an_error():
    before = torch.get_num_threads()
    with pytest.raises(KeyError), threads.for_samples(threads.MIN_PARALLEL_SAMPLES, 2), memory.kept():
        raise KeyError
    assert torch.get_num_threads() == before


def test_nested_contexts_return_memory_once_at_the_end_of_the_outermost(monkeypatch):
    calls = []

    class Library:
        def mallopt(self, option, value):
            calls.append(option)

        def malloc_trim(self, pad):
            calls.append("trim")

    monkeypatch.setattr(memory, "_glibc", Library)
    with memory.kept():
        begun = len(calls)
        with memory.kept():
            pass
        assert len(calls) == begun
        assert "trim" not in calls
    assert calls.count("trim") == 1


def test_another_c_library_is_left_alone(monkeypatch):
    monkeypatch.setattr(memory, "_glibc", lambda: None)
    with memory.kept():
        pass
