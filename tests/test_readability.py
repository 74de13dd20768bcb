"""The site reads as plain technical English: few words a sentence, a page and in all, and none that puzzle."""

import re

import pytest
from documentation import PAGES, ROOT

SITE = [*PAGES, ROOT / "CHANGELOG.md"]
#: Written by scripts from the code, and looked up, not read: they do not count as words of the site.
GENERATED = [ROOT / "docs/reference/components.md", ROOT / "docs/reference/messages.md"]
WORDS_ON_THE_SITE = 35_000
WORDS_OF_AN_EXPLANATION = 800
LONGEST_SENTENCE = 30  # words
LONG_SENTENCE = 25  # words
LONG_SENTENCES = 0.05  # of a page's, at most
#: Riddles, diaries, and words with a plainer one: "reports", "separates", "needs", "unreliable", "a person".
BANNED = [
    r"told",
    r"tells",
    r"whoever",
    r"of which",
    r"of whom",
    r"doubted",
    r"somebody",
    r"nobody",
    r"midst",
    r"wants",
    r"to be had",
    r"otherwise than",
    r"foretells?",
    r"by turns",
    r"all-knowing",
    r"hither",
    r"tried and dropped",
    r"no longer said",
    r"commit [0-9a-f]{7}",
    r"before / now",
]


def names(page):
    return str(page.relative_to(ROOT))


def words(text):
    """Words that hold a letter or a digit: a table's bars are none."""
    return re.findall(r"\S*\w\S*", text)


def prose(page):
    """Paragraphs and list items of a page, without code, tables, formulas, headings and sources."""
    text = re.sub(r"<!--.*?-->|^```.*?^```$|\$\$.*?\$\$", "", page.read_text(encoding="utf-8"), flags=re.M | re.S)
    text = re.sub(r"^## Sources$.*?(?=^## |\Z)", "", text, flags=re.M | re.S)
    text = re.sub(r"^(#|\|).*$", "", text, flags=re.M)
    text = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", text)
    text = re.sub(r"`[^`]*`|\$[^$]*\$", "Code", text)
    return [
        " ".join(each.split()) for each in re.split(r"\n\s*\n|^\s*(?:[-*]|\d+\.) ", text, flags=re.M) if each.strip()
    ]


def sentences(page):
    return [each for paragraph in prose(page) for each in re.split(r"(?<=[.!?])[*\")]* +(?=[^a-z])", paragraph)]


@pytest.mark.parametrize("page", SITE, ids=names)
def test_sentences_are_short(page):
    lengths = {each: len(words(each)) for each in sentences(page)}
    too_long = [each for each, length in lengths.items() if length > LONGEST_SENTENCE]
    assert not too_long
    long = [each for each, length in lengths.items() if length > LONG_SENTENCE]
    assert len(long) <= max(1, LONG_SENTENCES * len(lengths)), long


@pytest.mark.parametrize("page", SITE, ids=names)
def test_words_are_plain(page):
    text = " ".join(re.sub(r"^```.*?^```$|`[^`]*`", "", page.read_text(encoding="utf-8"), flags=re.M | re.S).split())
    assert not re.findall(rf"\b(?:{'|'.join(BANNED)})\b", text, re.IGNORECASE)


@pytest.mark.parametrize("page", [page for page in PAGES if page.parent.name == "explanation"], ids=names)
def test_an_explanation_is_read_in_a_few_minutes(page):
    assert len(words(page.read_text(encoding="utf-8"))) <= WORDS_OF_AN_EXPLANATION


def test_the_site_is_read_in_a_day():
    read = [page for page in SITE if page not in GENERATED]
    assert sum(len(words(page.read_text(encoding="utf-8"))) for page in read) <= WORDS_ON_THE_SITE
