"""The benchmark of record: its bursts are files with their truth, its cells those of `compare`, its page is theirs."""

import json
import re

import numpy as np
import pytest

from deepir.errors import ConfigError
from deepir.registry import components
from deepir.sweep.table import Row

pytestmark = pytest.mark.usefixtures("benchmarks")
CAMERA = {"shape": (40, 48), "n_frames": 4, "max_shift": 4.0, "counts": True, "dead_pixels": 0.01, "stray": 0.5}


@pytest.fixture
def stem(tmp_path):
    from record_bursts import Simulated

    stem = tmp_path / "bursts" / "a-procedural-7"
    Simulated("procedural 3", 7, CAMERA).written(stem)
    return stem


def test_every_group_names_bursts_and_methods_that_are_there():
    from record_protocols import protocols

    keys = [each.key for each in protocols()]
    assert keys[:2] == ["a", "b"]
    assert len(set(keys)) == len(keys)
    known = components("method")
    for protocol in protocols():
        folders = [
            (method, n, burst)
            for group in protocol.groups
            for method in group.methods
            for n in group.frames
            for burst in group.bursts
        ]
        assert len(set(folders)) == len(folders), protocol.key
        assert {burst for *_, burst in folders} <= set(protocol.bursts)
        for group in protocol.groups:
            for settings in group.methods.values():
                named = re.findall(r"method=(?:\{type: )?(\w+)", " ".join(settings))
                assert set(named) <= set(known), named
    assert any(not group.full for protocol in protocols() for group in protocol.groups)


def test_a_burst_is_simulated_once_and_what_was_simulated_is_found_again(stem):
    from record_bursts import Simulated
    from record_methods import stored

    path = stem.with_name(f"{stem.name}.npz")
    before = path.stat().st_mtime_ns
    settings = Simulated("procedural 3", 7, CAMERA, ("method={type: flat_field, hot: STEM_hot.npy}",)).written(stem)
    assert path.stat().st_mtime_ns == before
    assert f"data.path={path}" in settings
    assert f"method={{type: flat_field, hot: {stem}_hot.npy}}" in settings
    sim, variance = stored(path, 3)
    assert sim.frames.shape == variance[:3].shape == (3, 40, 48)
    assert len(sim.truth.motion) == 3
    seen = sim.truth.gain * sim.truth.scene + sim.truth.offset  # frame 0, with the stray flux in the offset
    good = ~sim.truth.bad_pixels
    assert np.std((sim.frames[0] - seen)[good]) < 1.1 * float(np.sqrt(variance[0][good].mean()))
    cold, hot = (np.load(f"{stem}_{body}.npy").mean(0) for body in ("cold", "hot"))
    gain = (hot - cold) / (hot - cold)[good].mean()
    assert np.corrcoef(gain[good], sim.truth.gain[good])[0, 1] > 0.9


def test_an_oracle_is_refused_for_a_recorded_burst(tmp_path):
    from record_methods import stored

    with pytest.raises(ConfigError, match="only a simulated burst"):
        stored(tmp_path / "mine.npz", 3)


def test_missing_bursts_are_left_out_with_a_reason(monkeypatch, tmp_path):
    from record_bursts import Recorded, Simulated

    burst = Recorded("a65/a65.npz")
    monkeypatch.setattr("record_bursts.DATA", "")
    assert "DEEPIR_DATA" in burst.missing()
    monkeypatch.setattr("record_bursts.DATA", str(tmp_path))
    assert "has no a65/a65.npz" in burst.missing()
    assert Simulated("H30T 1", 1, {}).missing()
    assert not Simulated("coffee", 1, {}).missing()


def found(*rows, protocol="a"):
    from record_protocols import protocols
    from record_tables import Found, with_gaps

    whole = next(each for each in protocols() if each.key == protocol)
    made = [
        Row("", {"method": method, "data.frames": n, "burst": burst}, {"psnr_aligned": p, "seconds": 1.0} if p else {})
        for method, n, burst, p in rows
    ]
    return Found(whole, with_gaps(made))


RUNS = [
    ("joint", "3", "x", 40.0), ("joint", "3", "y", 30.0), ("mire", "3", "x", 33.0), ("mire", "3", "y", 31.0),
    ("irlms", "3", "x", 20.0), ("flat_field", "3", "x", 50.0), ("oracle", "3", "x", 41.0), ("oracle", "3", "y", 32.0),
    ("galms", "3", "x", None), ("joint red", "3", "x", 36.0),
]  # fmt: skip


def test_the_margin_is_over_the_best_rival_that_knows_no_more():
    from record_tables import margins

    *_, line = margins({"a": found(*RUNS)})
    assert line == "| (a) | 3 | 35.0 | mire | 32.0 | **+3.0** | joint red | 36.0 | 1.5 |"


def test_a_table_has_medians_quartiles_and_gaps_the_best_first():
    from record_tables import table

    lines = list(table(found(*RUNS), "3"))
    assert [line.split(" | ")[0].strip("| *") for line in lines[2:]] == [
        "flat_field", "oracle", "joint red", "joint", "mire", "irlms",
    ]  # fmt: skip
    assert "35.0 (32.5 to 37.5)" in lines[5]
    assert "| 1.5 |" in lines[5]  # of the gaps 1 and 2


def test_the_page_says_what_it_lacks_and_draws_the_same_picture_twice(tmp_path):
    from record_page import _missing, _what
    from record_plots import against_frames

    lacking = found(*RUNS, ("joint", "5", "x", 42.0))
    assert "10 of 11 runs" in _what({"a": lacking}, full=False)
    assert "- galms: 1 run is missing: not run yet." in list(_missing(lacking))
    for name in ("one.png", "two.png"):
        assert against_frames(tmp_path / name, {"a": lacking})
    assert (tmp_path / "one.png").read_bytes() == (tmp_path / "two.png").read_bytes()


def test_errors_are_kept_until_a_run_succeeds(monkeypatch, tmp_path):
    import record

    monkeypatch.setattr(record, "FOLDER", tmp_path)
    record.note("a/method=mire", "too dark")
    record.note("a/method=joint", None)
    assert json.loads((tmp_path / "errors.json").read_text()) == {"a/method=mire": "too dark"}
    record.note("a/method=mire", None)
    assert record.errors() == {}
