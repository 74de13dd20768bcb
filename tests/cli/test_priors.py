"""Every prior runs from the command line, and goes on where it was interrupted."""

import numpy as np
import pytest

from deepir.config import prior_names

#: Of each kind one: a penalty, learned filters, denoisers, networks.
KINDS = ("tv", "foe", "red", "pnp", "dip", "siren", "grid", "deep_decoder")


@pytest.mark.parametrize(
    "prior",
    [name if name in KINDS else pytest.param(name, marks=pytest.mark.matrix) for name in prior_names()],
)
def test_every_prior_corrects_a_burst(nuc, folder, prior):
    status, out, err = nuc("data.path=burst.npz", f"prior={prior}", "solver.max_iterations=2")
    assert status == 0, err
    assert "results: " in out
    scene = np.load("runs/nuc/result.npz")["scene"]
    assert scene.shape == (40, 48)
    assert np.isfinite(scene).all()


def test_a_wrong_fit_is_named_by_its_key(nuc):
    status, _, err = nuc("data.path=burst.npz", "prior=grid", "scene.fit.iteration=3")
    assert status != 0
    assert "scene.fit" in err
    assert "iterations" in err


def test_an_unknown_start_is_reported(nuc):
    status, _, err = nuc("data.path=burst.npz", "prior=grid", "scene.init=noise")
    assert status != 0
    assert "scene.init" in err
    assert "'tv'" in err
