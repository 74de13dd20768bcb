"""The page of a corrected recording."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from deepir.messages import Message
from deepir.recording.estimate import SensorEstimate
from deepir.report.recording import _wider, verdict, write_recording_report

SHAPE = (24, 32)


class Recording:
    """A corrected recording of three frames, with one bad pixel."""

    def __init__(self, **changes):
        rng = np.random.default_rng(0)
        self.frames = 100 + rng.standard_normal((3, *SHAPE))
        bad = np.zeros(SHAPE, bool)
        bad[5, 7] = True
        offset = 4 * rng.standard_normal(SHAPE)
        known = SensorEstimate(np.ones(SHAPE), offset, bad, 100.0, np.full(SHAPE, 0.5), "offset", 0.05)
        self.estimate = replace(known, **changes)
        self.segments, self.messages = [SimpleNamespace(estimate=self.estimate)], self.estimate.messages
        self.keyframes = SimpleNamespace(frames=self.frames, numbers=np.arange(3))

    def __len__(self):
        return 3

    def correct(self, frame, number):
        return frame - self.estimate.offset


def test_the_verdict_says_how_much_pattern_there_was_and_is():
    found = verdict(Recording(), "counts")
    assert found.severity == "good"
    assert re.fullmatch(
        r"A fixed pattern of [34]\.\d+ counts \(standard deviation\) was removed; about 0\.5 counts may be left\.",
        found.sentence,
    )
    assert found.more == "1 bad pixel is filled in."


NOT_SEPARATED = "the shading of the fixed pattern was not separated from the scenes"
LEFT = {"messages": (Message("shading-stays", "it could not be separated"),), "offset_deviation": None}


@pytest.mark.parametrize(
    ("changes", "severity", "first", "then"),
    [
        ({"noise": 8.0}, "good", "There was little to correct", ()),
        ({"noise": 2.0}, "good", "A fixed pattern of", ()),
        ({"noise": np.nan}, "good", "A fixed pattern of", ()),
        (
            LEFT,
            "care",
            f"Use this result with care: {NOT_SEPARATED}",
            ("A fixed pattern of", "Turn the camera both ways"),
        ),
        (LEFT | {"noise": 8.0}, "care", "There was little to correct", (NOT_SEPARATED,)),
        ({"messages": (Message("moving-object", "it moves"),)}, "good", "A fixed pattern of", ("It moves.",)),
        ({"motion_error": np.inf}, "good", "A fixed pattern of", ("shading is less sure",)),
    ],
)
def test_the_verdict_begins_with_what_matters_most(changes, severity, first, then):
    found = verdict(Recording(**changes), "counts")
    assert found.severity == severity
    assert found.sentence.startswith(first)
    assert all(each in found.more for each in then)


def test_the_page_holds_frames_difference_and_maps(tmp_path, data):
    write_recording_report(tmp_path / "page.html", Recording(), "films/drive.avi", "counts", ["motion: none"])
    shown = data(tmp_path / "page.html")
    assert (shown["title"], shown["source"]) == ("correction", "drive.avi")
    names = [each["name"] for each in shown["maps"]]
    assert names == ["raw", "scene", "difference", "offset", "offset_sd", "gain", "bad_pixels"]
    assert ["bad pixels", "1"] in shown["figures"]
    assert shown["messages"][-1] == "motion: none"


@pytest.mark.parametrize("width", [32, 640])
def test_bad_pixels_are_seen_on_the_page_whatever_the_size(width):
    bad = np.zeros((40, width), bool)
    bad[20, 16] = True
    assert np.sqrt(_wider(bad).sum()) >= width / 200
