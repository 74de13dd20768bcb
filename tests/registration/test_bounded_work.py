"""Frames that share nothing cost a bounded number of alignments."""

import torch

from deepir.registration import frame_selection, register


def test_a_burst_of_noise_ends_after_few_alignments(monkeypatch):
    calls, align = [], frame_selection.align
    monkeypatch.setattr(frame_selection, "align", lambda *given: calls.append(1) or align(*given))
    noise = torch.rand(16, 48, 64, generator=torch.Generator().manual_seed(0))
    found = register(noise)
    assert found.used.sum() == 1
    assert "frame 1 does not register" in found.messages[0]
    assert len(calls) < 50


def test_of_many_frames_that_disagree_several_are_rejected_at_a_time(monkeypatch):
    calls, align = [], frame_selection.align
    monkeypatch.setattr(frame_selection, "align", lambda *given: calls.append(len(given[1])) or align(*given))
    noise = torch.rand(160, 32, 40, generator=torch.Generator().manual_seed(0))
    level = frame_selection.Level(1, noise - 0.5, torch.ones(32, 40), True, (32, 40))
    used, _ = frame_selection.reject_frames(
        level, noise.new_ones(160).bool(), torch.eye(3).double().repeat(160, 1, 1), "shift"
    )
    assert used.sum() < 4
    assert calls[1] == 155
    assert len(calls) < 110
