"""Freed memory is kept until the last context ends."""

from deepir.kernels import memory


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
