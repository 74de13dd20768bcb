"""The benchmark's bursts are what they are said to be, and its oracle knows what it is given."""

import dataclasses

import numpy as np
import pytest

from deepir.simulate import Settings, simulate
from deepir.simulate.optics import picture_scale, random_motion, visible_reach
from deepir.simulate.scenes.procedural import procedural

SCENE = procedural(2, (140, 160))
SMALL = Settings(shape=(48, 56), n_frames=5, max_shift=4.0, shading=0.0, dead_pixels=0.0)


@pytest.fixture(autouse=True)
def folder(benchmarks, monkeypatch, tmp_path):
    monkeypatch.setattr("nuc_store.FOLDER", tmp_path)


def test_the_halves_share_no_picture_and_no_seed_and_every_regime_fits_its_pictures():
    from nuc_regimes import REGIMES, SEEDS, picture

    a, b = ({regime.picture(half) for regime in REGIMES.values()} for half in "AB")
    assert not a & b
    assert not set(SEEDS["A"]) & set(SEEDS["B"])
    shapes = {}
    for name in {regime.picture(half) for regime in REGIMES.values() for half in "AB"}:
        grey = picture(name)
        assert grey.ndim == 2
        assert 0 <= grey.min() < 0.5 < grey.max() <= 1, name
        shapes[name] = grey.shape
    for regime in REGIMES.values():
        for half, seeds in SEEDS.items():
            for n, seed in ((n, seed) for n in regime.frames for seed in seeds):
                settings = regime.settings(n)
                motion = random_motion(settings, np.random.default_rng(seed).spawn(1)[0])
                assert picture_scale(shapes[regime.picture(half)], visible_reach(motion, settings), settings) >= 1.2


def test_known_effects_do_not_lower_the_oracle(monkeypatch):
    from nuc_oracle import oracle

    monkeypatch.setattr("nuc_oracle.ITERATIONS", 30)
    effects = ({}, {"walker": 0.5}, {"failed_frame": 2}, {"dead_pixels": 0.01}, {"level_drift": 0.05})
    clean, *disturbed = (oracle(simulate(SCENE, dataclasses.replace(SMALL, **each), seed=1), SCENE) for each in effects)
    # Noise alone costs 1.8 dB where one frame of three is left out.
    assert min(disturbed) > clean - 2.2


def test_the_oracles_noise_is_that_of_the_frames():
    from nuc_oracle import noise_variance

    camera = dataclasses.replace(SMALL, photons=300.0, max_shift=0.0, counts=True, n_frames=60)
    sim = simulate(SCENE, camera, seed=1)
    expected = noise_variance(sim, SCENE)[0]
    np.testing.assert_allclose(sim.frames.var(0).mean(), expected.mean(), rtol=0.02)
    assert np.corrcoef(sim.frames.var(0).ravel(), expected.ravel())[0, 1] > 0.2


@pytest.mark.parametrize("peak", [-3.0, 0.0, 0.4, 2.5])
def test_the_best_weight_is_found(peak):
    from nuc_oracle import climb

    assert climb(lambda power: -((power - peak) ** 2)) >= -(0.25**2)


def test_stored_bursts_are_simulated_once():
    from nuc_store import burst, kept

    made = []

    def make():
        made.append(1)
        return {"value": np.arange(3)}

    for fresh in (False, False, True):
        np.testing.assert_array_equal(kept("things", ["key", 1], make, fresh=fresh)["value"], np.arange(3))
    assert len(made) == 2
    (first, digest), (again, same) = (burst("sky 0", SMALL, 3) for _ in range(2))
    assert digest == same
    np.testing.assert_array_equal(first.frames, again.frames)
    assert first.truth.read_noise == again.truth.read_noise
    assert burst("sky 0", SMALL, 4)[1] != digest


def test_the_report_says_what_it_found():
    from nuc_table import Case, Row, summary

    good, refused = (
        Case(20, 25, 26, 35, 35.5, 36, 0.5, 1.0),
        Case(20, 25, 26, 20, 32, 36, np.nan, np.nan, ["REFUSED: no"]),
    )
    rows = [
        Row("counts", 3, "", {"A": [good], "B": [refused]}),
        Row("sky", 3, "nothing to see", {"A": [good], "B": [good]}),
    ]
    assert rows[0].line().startswith("| counts | 3 | 20.0 / 20.0 |")
    assert rows[1].line().startswith("| sky | 3 * |")
    text = "\n".join(summary(rows, "AB"))
    for words in ("| **1.00** | **16.00** |", "16.0 (counts, n = 3)", "nothing to see", "1 of 2 bursts: REFUSED: no"):
        assert words in text


def test_finished_cells_are_not_computed_again_until_the_code_changes():
    from cells import done, worked

    asked = []

    def measure(name, seed):
        asked.append((name, seed))
        return {"psnr": np.array(10.0 * seed)}

    cells = [("tv", 1), ("tv", 2), ("red", 2)]
    for code, more in (("a", 3), ("a", 0), ("b", 3)):
        asked.clear()
        found = worked("test", cells, measure, code=code)
        assert [float(found[cell]["psnr"]) for cell in cells] == [10.0, 20.0, 20.0]
        assert len(asked) == more
        assert done("test", [*cells, ("tv", 3)], code=code) == found


def test_the_papers_bursts_are_as_noisy_as_it_says(monkeypatch):
    import paper

    monkeypatch.setattr(paper, "picture", lambda: np.full((400, 400), 0.5))
    frames, truth = paper.burst(40, 0.5, 6.0, 0)
    assert frames.shape == (40, *truth.shape) == (40, 160, 192)
    gain = frames.mean((0, 1)) / 0.5
    assert 0.49 < gain.min() < 0.55 < 0.95 < gain.max() < 1.01
    np.testing.assert_allclose(frames.var(0).mean(0), gain * 0.5 / 1000, rtol=0.2)


def test_frame_0_of_the_papers_bursts_is_not_moved(monkeypatch):
    import paper

    rng = np.random.default_rng(0)
    grey = 0.5 + 0.02 * rng.standard_normal((400, 400))
    monkeypatch.setattr(paper, "picture", lambda: grey)
    monkeypatch.setattr(paper, "PHOTONS", 1e7)
    frames, truth = paper.burst(2, 1.0, 6.0, 0)
    np.testing.assert_allclose(frames[0], truth, atol=2e-3)
    assert abs(frames[1] - truth).max() > 0.02


def test_every_problem_that_is_shipped_is_in_the_table_of_problems_with_total_variation_and_two_others():
    from problems import CASES, PRIORS

    from deepir.registry import components

    of_films = {"recording"}  # `nuc` over several bursts: bench-recordings has it
    assert set(CASES) == components("problem").keys() - {"generic"} - of_films
    assert PRIORS[0] == "tv"
    assert len(set(PRIORS)) >= 3


def test_damaged_inputs_are_the_same_each_time_and_are_read_or_refused():
    pytest.importorskip("av")
    pytest.importorskip("h5py")
    from reliability_fuzz import ERROR, count_inputs
    from reliability_inputs import make_input

    assert make_input(7) == make_input(7)
    counts = count_inputs(1, 41)["counts"]
    assert counts.sum() == 40
    assert not counts[:, ERROR:].any()
