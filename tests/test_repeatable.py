"""Two runs give the same result to the bit."""

import re

from documentation import ROOT


def test_least_squares_name_their_driver():
    # torch's default on the CPU pivots by memory that nobody has written (pytorch issue 71222).
    sources = [path.read_text(encoding="utf-8") for path in (ROOT / "deepir").rglob("*.py")]
    calls = [call for each in sources for call in re.findall(r"torch\.linalg\.lstsq\(.*", each)]
    assert calls
    assert all("driver=" in call for call in calls)
