"""What a sweep varies."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from deepir.errors import ConfigError
from deepir.sweep.cells import SWEEP_FILES, burst_axis, folder_name, parse_axes, split_at_commas

PLAIN = st.text("abc0.:- ", min_size=1)
BRACKETED = st.lists(PLAIN, min_size=1).map(lambda parts: f"[{', '.join(parts)}]")


@given(st.lists(PLAIN | BRACKETED | PLAIN.map(lambda text: f'"{text},{text}"'), min_size=1))
def test_values_are_split_at_commas_outside_of_brackets_and_quotes(values):
    assert split_at_commas(",".join(values)) == values


def test_a_key_with_several_values_is_an_axis_and_one_with_one_is_a_setting():
    fixed, axes = parse_axes(["data.crop=[0, 40, 0, 48]", "prior=tv,pixels", "threads=1", "seed=0, 1,0"])
    assert fixed == ["data.crop=[0, 40, 0, 48]", "threads=1"]
    assert [(axis.key, list(axis.choices)) for axis in axes] == [("prior", ["tv", "pixels"]), ("seed", ["0", "1"])]
    assert axes[1].choices["1"] == ["seed=1"]


def test_of_a_key_given_twice_the_last_counts():
    fixed, axes = parse_axes(["seed=0,1", "prior=tv,pixels", "seed=2"])
    assert fixed == ["seed=2"]
    assert [axis.key for axis in axes] == ["prior"]


def test_bursts_are_called_by_their_stems_and_meet_their_truth(tmp_path):
    for name in ("a.npz", "a_truth.npz", "b.tiff", "c_truth.npz"):
        (tmp_path / name).touch()
    axis = burst_axis([f"{tmp_path}/*"])
    assert axis.choices == {
        "a": [f"data.path={tmp_path}/a.npz", f"data.truth={tmp_path}/a_truth.npz"],
        "b": [f"data.path={tmp_path}/b.tiff"],
        "c_truth": [f"data.path={tmp_path}/c_truth.npz"],
    }


def test_bursts_of_one_name_are_called_by_their_paths(tmp_path):
    for folder in ("x", "y"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "a.npz").touch()
    names = list(burst_axis([f"{tmp_path}/*/a.npz"]).choices)
    assert names == [f"{tmp_path}/x/a.npz", f"{tmp_path}/y/a.npz"]


def test_a_cells_folder_says_its_values():
    assert folder_name({"prior": "tv", "data.frames": "3"}) == "prior=tv,data.frames=3"
    assert folder_name({"burst": "/data/a b.npz", "seed": "1"}) == "-data-a-b.npz,seed=1"
    with pytest.raises(ConfigError, match="too long"):
        folder_name({"solver.plan": "x" * 300})


@pytest.mark.parametrize(
    "name", ["..npz", "...npz", ".npz", "table.md.npz", "Report.html.npz", ".lock.npz", "....tiff"]
)
@pytest.mark.parametrize("more", [{}, {"seed": "1"}])
def test_a_burst_of_any_name_has_a_folder_within_the_sweep(tmp_path, name, more):
    (tmp_path / name).touch()
    (label,) = burst_axis([f"{tmp_path}/{name}"]).choices
    folder = folder_name({"burst": label} | more)
    assert (tmp_path / folder).resolve().parent == tmp_path.resolve()
    assert not folder.startswith(".")
    assert folder.lower() not in SWEEP_FILES
