"""What a user reads has no word that only its author knows."""

import re

import pytest
from documentation import script

#: Words of the method, in place of which a message says what is meant.
OF_THE_AUTHOR = re.compile(
    r"\b(nats?|blobs?|keyframes?|low-order|high-order|posteriors?|likelihoods?|evidence|homograph\w+|"
    r"variance components?|elimination|preconditioner|dense displacements?|leverage|Gauss-Newton|L-BFGS)\b",
    re.IGNORECASE,
)
#: Messages on settings that have these names.
ABOUT_SETTINGS = ("network-without-fit",)


def messages():
    """All warnings and notes with what they mean, and the texts of errors, as the reference lists them."""
    page = script("generated").messages_page()
    for section in re.split(r"^### ", page, flags=re.MULTILINE)[1:]:
        name, _, text = section.partition("\n")
        yield name, text.split("\n## ")[0]


@pytest.mark.parametrize(("name", "text"), [each for each in messages() if each[0] not in ABOUT_SETTINGS])
def test_a_message_needs_no_author(name, text):
    assert not OF_THE_AUTHOR.findall(text)
