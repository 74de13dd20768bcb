"""What is said while a command works."""

import time

from deepir.report.progress import registering


def test_a_long_registration_says_so_until_the_solve_begins():
    said = []
    with registering(said.append, every=0.02) as begun:
        time.sleep(0.1)
        begun.set()
        time.sleep(0.03)
        count = len(said)
        time.sleep(0.1)
    assert count == len(said) > 1
    assert said[0].startswith("registering the frames")
