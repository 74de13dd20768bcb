"""The search for the scene's weights."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from deepir.estimation.cross_validation import (
    MAX_LOG2_WEIGHT,
    N_TRIALS,
    WeightSearch,
    best_log2_weight,
    next_log2_weight,
)
from deepir.estimation.prior_weight import unknown_noise
from deepir.optim.objective import hold_out
from deepir.optim.solve import solve
from deepir.priors.penalties.tv import TV
from deepir.storage.stored import FileCheckpoint


def search(misfit):
    tried = {}
    for _ in range(N_TRIALS):
        power = next_log2_weight(tried)
        tried[power] = misfit(power)
    return best_log2_weight(tried)


@given(st.floats(-6, MAX_LOG2_WEIGHT - 0.6), st.floats(0.1, 100))
def test_the_least_of_a_parabola_is_found(least, bend):
    assert search(lambda power: bend * (power - least) ** 2) == pytest.approx(least, abs=1e-6)


def test_the_search_ends_at_its_bounds_and_where_all_neighbours_are_worse():
    assert search(lambda power: -power) == MAX_LOG2_WEIGHT
    tried = {-1.0: 2.0, 0.0: 1.0, 1.0: 3.0, 2.0: 4.0, -2.0: 5.0}
    assert next_log2_weight(tried) == 0
    assert -0.5 < best_log2_weight(tried) < 0
    tried = {0.0: 5.0, -2.0: 4.0, -4.0: 3.0, -6.0: 2.0}
    assert next_log2_weight(tried) == -8
    assert next_log2_weight(tried, least=-6.0) == -5
    assert next_log2_weight({0.0: 5.0, -2.0: 4.0}, least=-3.0) == -3


def test_a_weight_that_is_given_is_not_searched_for(small_nuc):
    problem = small_nuc()  # TV of weight 2
    search = WeightSearch()
    search.start(problem)
    assert search.stages(problem) == []
    search.weigh(problem)
    assert problem.penalties["scene"]["prior"].weight == 2


def test_a_search_that_was_interrupted_goes_on_as_if_it_had_not_been(small_nuc, tmp_path):
    def searched(**how):
        torch.manual_seed(0)
        problem = small_nuc(n_frames=4, size=(20, 24))
        problem.penalties["scene"]["prior"] = TV().double()
        hold_out(problem, 0)
        search = WeightSearch()
        search.start(problem)
        solve(problem, search.stages(problem), **how)
        return problem.get_buffer("trials_scene")

    def stop(progress):
        if progress.stage == "weight 3":
            raise KeyboardInterrupt

    state = tmp_path / "state.safetensors"
    with pytest.raises(KeyboardInterrupt):
        searched(callbacks=[stop], checkpoint=FileCheckpoint(state))
    resumed, whole = searched(checkpoint=FileCheckpoint(state)), searched()
    assert whole[:-1].isfinite().all()
    assert torch.equal(resumed.nan_to_num(), whole.nan_to_num())


def test_the_noise_of_an_unknown_is_that_of_its_estimate_from_the_data_alone(small_nuc):
    problem = small_nuc(n_frames=4)
    with torch.no_grad():
        problem.precision.fill_(25.0)
    # The mean of four frames, of noise 0.2 each.
    assert unknown_noise(problem, "offset") == pytest.approx(0.2 / 4**0.5, rel=1e-3)
