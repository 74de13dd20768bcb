"""What represents gain, offset and scene is swapped from YAML, and the result is of that kind."""

import functools

import numpy as np
import pytest

import deepir
from deepir.config import load

CONFIG = """
problem: nuc
prior: {prior}
physics:
  warp:
    motion: {{type: shift, init: register}}
  sensor:
    gain: {gain}
    offset: {offset}
threads: 1
solver: {{max_iterations: 15}}
"""
PARTS = "{type: column+row+pixel}"


@pytest.fixture(scope="module")
def solve(tmp_path_factory, burst):
    """Run the burst with these fields, written into a YAML file; each is solved once."""
    path = tmp_path_factory.mktemp("swap") / "mine.yaml"

    @functools.cache
    def run(gain=PARTS, offset=PARTS, prior="tv", more=""):
        path.write_text(CONFIG.format(gain=gain, offset=offset, prior=prior) + more)
        return deepir.run(path, frames=burst.frames)

    return run


def varies(value):
    """Along which axes a map varies: (down the rows, across the columns)."""
    return tuple(float(np.ptp(value, axis=axis).max()) > 1e-5 * np.ptp(value) for axis in (0, 1))


def additive(value):
    """Whether it is a sum of a function of the row and one of the column."""
    rest = value - value.mean(0) - value.mean(1, keepdims=True) + value.mean()
    return float(np.abs(rest).max()) < 1e-4 * np.ptp(value)


# In the gauge, the mean offset goes into the scene as `shift * gain`, so that an offset takes on some of the gain's
# kind: one of the two is known (neutral) while the other is looked at.
@pytest.mark.parametrize("slot", ["gain", "offset"])
@pytest.mark.parametrize(
    ("kind", "axes"),
    [("column", (False, True)), ("row", (True, False)), ("column+row", (True, True)), ("pixel", (True, True)),
     ("column+row+pixel", (True, True)), ("pixels", (True, True))],
)  # fmt: skip
def test_a_map_is_what_its_field_can_be(solve, slot, kind, axes):
    other = {"gain": "offset", "offset": "gain"}[slot]
    result = solve(**{slot: kind, other: "{type: constant}"})
    found = getattr(result, slot)
    assert varies(found) == axes
    assert additive(found) == ("pixel" not in kind)
    assert np.ptp(getattr(result, other)) == 0


def test_a_known_gain_stays_and_the_offset_adapts(solve, burst, tmp_path):
    np.save(tmp_path / "gain.npy", burst.truth.gain)
    known = solve(gain=f"{{type: constant, path: {tmp_path / 'gain.npy'}}}")
    assert np.allclose(known.gain, burst.truth.gain, rtol=1e-5)
    assert np.all(solve(gain="1").gain == 1)  # a number is known, too
    free = solve()
    assert np.abs(known.offset - free.offset).max() > 1
    assert np.abs(known.offset - burst.truth.offset).std() < np.abs(free.offset - burst.truth.offset).std()


def test_a_part_may_be_given_its_strength(solve):
    result = solve(gain="{type: column+pixel, column: {sigma: 0.02}}")
    assert result.metrics["strengths"]["gain.column.sigma"] == pytest.approx(0.02)
    assert "gain.row.sigma" not in result.metrics["strengths"]
    assert 0 < result.metrics["strengths"]["gain.pixel.sigma"] < 0.2


def test_gain_and_offset_are_found_without_a_closed_form_too(solve):
    result = solve(more="fidelity: huber\n")
    assert result.gain.std() > 1e-3
    assert result.offset.std() > 1


def test_the_prior_is_one_line(solve, tmp_path):
    smooth = tmp_path / "smooth.yaml"
    smooth.write_text("# Smooth.\nscene: {type: pixels, init: average, penalties: {smooth: {weight: 1}}}\n")
    results = {prior: solve(prior=prior) for prior in ("tv", "pixels", smooth)}
    rough = {prior: np.abs(np.diff(result.scene)).sum() for prior, result in results.items()}
    assert rough[smooth] < rough["tv"] < rough["pixels"]
    assert [kind for kind in results[smooth].metrics["strengths"] if kind.startswith("scene")] == [
        "scene.smooth.weight"
    ]
    assert results["pixels"].metrics["prior"] == "pixels"


def test_a_preset_of_ones_own_is_read_from_a_file_and_overridden(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("scene: {type: pixels, penalties: {tv: {weight: 3}, l1: {weight: 2}}}\n")
    config = load("nuc", [f"prior={path}", "scene.penalties.l1.weight=5"])
    assert config.scene["penalties"] == {"tv": {"weight": 3}, "l1": {"weight": 5}}
