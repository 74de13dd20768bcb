"""Messages have a name, a severity and an explanation, and all that the code reports is on the page of messages."""

import pickle
import re

import pytest
from documentation import script

from deepir.messages import MAX_SHOWN, NOTES, WARNINGS, Message, labelled, shown

page = script("generated")
#: Words of the method, in place of which a message says what is meant.
OF_THE_AUTHOR = re.compile(
    r"\b(nats?|blobs?|keyframes?|low-order|high-order|posteriors?|likelihoods?|evidence|homograph\w+|"
    r"variance components?|elimination|preconditioner|dense displacements?|leverage|Gauss-Newton|L-BFGS)\b",
    re.IGNORECASE,
)
ABOUT_SETTINGS = {"network-without-fit"}  # messages on settings that have these names

EVERY_WAY = """
raise DataError(f"{path}: holds {n:d} frames; take 3")
raise type(error)(f"{error}; go on with: resume") from error
refusal = SolverError("the solve " f"diverged at {k}" + " of all")
log.warning("%s; again", error)
guards.warn_once(f"{path}: cut off")
notify(f"warning: stood still for {s} s")
notify("frame 1 of 3")
found.append(Message("motion-small", f"moves by {d}"))
raise ConfigError(f"{where}: {reason}") from None
raise wrong
"""


@pytest.fixture(scope="module")
def found():
    return list(page.messages())


@pytest.fixture(scope="module")
def text():
    """All warnings and notes with what they mean, and the texts of errors, as the reference lists them."""
    return page.messages_page()


def test_every_way_of_reporting_is_found(tmp_path, monkeypatch):
    (tmp_path / "some.py").write_text(EVERY_WAY)
    monkeypatch.setattr(page, "PACKAGE", tmp_path)
    assert [found[1:] for found in page.messages()] == [
        ("DataError", "…: holds … frames; take 3", ""),
        ("error", "…; go on with: resume", ""),
        ("SolverError", "the solve diverged at … of all", ""),
        ("warning", "…; again", ""),
        ("warning", "…: cut off", ""),
        ("warning", "stood still for … s", ""),
        ("", "moves by …", "motion-small"),
    ]


def test_every_message_of_the_code_is_on_the_page(found, text):
    assert len(found) > 300
    assert not [each for each in found if not each.name and f"| {page._escaped(each.text)} |" not in text]
    assert not [each for each in found if each.name and f"[{each.name}]: " not in text]


def test_a_message_needs_no_author(text):
    sections = [each.partition("\n") for each in re.split(r"^### ", text, flags=re.MULTILINE)[1:]]
    assert len(sections) >= len(WARNINGS | NOTES)
    assert {name for name, _, said in sections if OF_THE_AUTHOR.search(said.split("\n## ")[0])} <= ABOUT_SETTINGS


def test_every_name_is_explained_and_every_explanation_used(found):
    used = {each.name for each in found if each.name}
    assert used == WARNINGS.keys() | NOTES.keys()
    assert not WARNINGS.keys() & NOTES.keys()


@pytest.mark.parametrize("name", [*WARNINGS, *NOTES])
def test_an_explanation_says_what_it_means_and_what_to_do(name):
    assert re.fullmatch(r"[a-z]+(-[a-z]+)*", name)
    for text in (WARNINGS | NOTES)[name]:
        assert re.fullmatch(r"[A-Z].*\.", text)


def test_the_most_important_messages_come_first():
    found = labelled([Message("line-noise", "c"), "b", Message("level-drift", "a"), Message("motion-small", "d")])
    assert found == ["warning[motion-small]: d", "warning[level-drift]: a", "warning: b", "note[line-noise]: c"]


def test_a_command_prints_five_and_says_where_the_others_are():
    lines = list("abcdefg")
    assert shown(lines, "report.html") == [*"abcde", "and 2 more: see report.html"]
    assert shown(lines[:MAX_SHOWN], "report.html") == lines[:MAX_SHOWN]


def test_a_message_is_text_that_keeps_its_name():
    message = pickle.loads(pickle.dumps(Message("line-noise", "rows jump")))
    assert message == "rows jump"
    assert message.name == "line-noise"
