"""Simulated recordings: a camera that drives, walks, pans, stands or flies, with truth for each frame."""

from deepir.simulate.recording.judging import residual_map, residual_pattern
from deepir.simulate.recording.recording import Recording, RecordingTruth, simulate_recording
from deepir.simulate.recording.settings import RecordingSettings

__all__ = [
    "Recording",
    "RecordingSettings",
    "RecordingTruth",
    "residual_map",
    "residual_pattern",
    "simulate_recording",
]
