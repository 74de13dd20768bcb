"""The first sentence of a report says whether the result can be trusted."""

import pytest

from deepir.messages import DISTRUSTED, NOTES, WARNINGS, Message
from deepir.report.html import verdict


def test_a_separated_pattern_is_said_in_figures(result):
    result.metrics["fixed_pattern_left"] = {"raw": 241.0, "corrected": 9.4}
    result.frames_used[2] = False
    assert verdict(result) == (
        "good",
        "The pattern was separated from the scene: 241 counts before, 9.4 after.",
        "2 of 3 frames are used.",
    )


def test_a_result_without_maps_of_the_sensor_claims_no_pattern(result):
    result.gain[:], result.offset[:] = 1, 0
    assert "pattern" not in verdict(result).sentence


@pytest.mark.parametrize("name", WARNINGS)
def test_every_warning_makes_one_sentence(result, name):
    result.messages = [Message(name, "the details")]
    severity, sentence, more = verdict(result)
    assert severity == ("bad" if name in DISTRUSTED else "care")
    assert sentence.count(". ") == 0
    assert sentence.endswith(".")
    assert WARNINGS[name][1] in more


def test_the_most_important_warning_speaks_and_the_others_are_counted(result):
    result.messages = [
        Message("thermal-lag", "lag"), Message("line-noise", "rows"), Message("scene-repeats", "a fence"), "dark",
    ]  # fmt: skip
    severity, sentence, more = verdict(result)
    assert severity == "bad"
    assert sentence.startswith("Do not trust this result: the scene repeats itself")
    assert more.endswith("2 more warnings are below.")


def test_notes_do_not_change_the_verdict(result):
    before = verdict(result)
    result.messages = [Message(name, "the details") for name in NOTES]
    assert verdict(result) == before


def test_a_plugins_message_without_a_name_is_said_as_it_is(result):
    result.messages = ["A flash brightens 2 frames. See the log"]
    assert verdict(result)[:2] == ("care", "Use this result with care: a flash brightens 2 frames.")
