"""What a sweep varies, which runs there are, and what is wrong with them before anything runs."""

import shlex

import numpy as np
import pytest
from documentation import ROOT, blocks
from hypothesis import given
from hypothesis import strategies as st

from deepir.errors import ConfigError, DataError
from deepir.storage.stored import run_into
from deepir.sweep.cells import (
    SWEEP_FILES,
    burst_axis,
    check_cells,
    check_inputs,
    folder_name,
    make_cells,
    parse_axes,
    split_at_commas,
)
from deepir.sweep.sweep import prepare

SMALL = "data.simulate={counts: true, shape: [40, 48], max_shift: 4}"


@pytest.fixture
def made(tmp_path):
    """Cells of settings."""

    def make(*settings):
        fixed, axes = parse_axes([SMALL, *settings])
        return make_cells("nuc", fixed, axes, tmp_path, 1)

    return make


def test_there_is_a_cell_for_each_combination_in_order(made, tmp_path):
    found = made("method=joint,average", "seed=0,1")
    assert [cell.name for cell in found] == [
        f"method={method},seed={seed}" for method in ("joint", "average") for seed in (0, 1)
    ]
    assert [(cell.config.method, cell.config.seed) for cell in found][1] == ("joint", 1)
    assert found[1].folder.path == tmp_path / found[1].name


def test_numbers_of_frames_are_the_first_of_one_burst(made):
    three, seven = made("data.frames=3,7")
    assert {cell.config.data.simulate["n_frames"] for cell in (three, seven)} == {7}
    check_cells([three, seven])


def test_a_number_of_frames_that_is_simulated_stays(made):
    (cell, _) = made("data.frames=3,4", "data.simulate.n_frames=6")
    assert cell.config.data.simulate["n_frames"] == 6


@pytest.mark.parametrize(
    ("setting", "says"),
    [
        ("prior=tv,tvv", "did you mean 'tv'"),
        ("seed=0,x", "'seed=x'"),
        ("sede=0,1", "did you mean 'seed'"),
        ("method=joint,avrage", r"method=avrage: .*did you mean 'average'"),
        ("data.simulate.motion=rigid,rigit", r"motion=rigit: .*did you mean 'rigid'"),
        ("data.simulate.scene=camera,camra", "did you mean 'camera'"),
        ("data.simulate.noise=1,2", "no option 'noise'"),
        ("physics.sensor.gain=column,colum", "did you mean 'column'"),
        ("data.frames=3,2:3", "frame 0"),
        ("data.path=a.npz,b.npz", "path or simulate, not both"),
        ("data.crop=[0,20,0,20],[0,99,0,9]", "not inside"),
        ("data.simulate.scene=sky:1,sky-1,sky.1", "sky-1"),
    ],
)
def test_a_wrong_value_is_found_before_anything_runs(made, tmp_path, setting, says):
    with pytest.raises((ConfigError, DataError), match=says):
        check_cells(made("seed=0,1", setting))
    assert list(tmp_path.iterdir()) == []


def test_values_that_would_share_a_folder_are_refused(made):
    with pytest.raises(ConfigError, match="two cells would have this folder"):
        made("data.simulate.shape=[40,48],[40 48]")


def test_a_finished_cell_of_other_data_is_refused(tmp_path, burst):
    np.savez(tmp_path / "burst.npz", frames=burst.frames)
    settings = [f"data.path={tmp_path}/burst.npz", "method=average,joint"]
    fixed, axes = parse_axes(settings)
    found = make_cells("nuc", fixed, axes, tmp_path, 1)
    run_into(found[0].config, found[0].folder.path)
    check_inputs(found)
    np.savez(tmp_path / "burst.npz", frames=burst.frames[::-1])
    with pytest.raises(ConfigError, match=r"burst.npz has changed"):
        check_inputs(found)


def test_a_burst_that_cannot_be_read_is_left_to_its_run_once_another_is_finished(tmp_path, burst):
    np.savez(tmp_path / "good.npz", frames=burst.frames)
    (tmp_path / "bad.npz").write_text("hello")
    found = make_cells("nuc", ["method=average"], [burst_axis([f"{tmp_path}/*.npz"])], tmp_path, 1)
    check_cells(found)
    bad, good = found
    with pytest.raises(DataError, match="does not begin"):
        check_cells([bad])
    run_into(good.config, good.folder.path)
    check_cells([bad], finished=[good])


@pytest.mark.parametrize(
    ("given", "count", "cores", "workers", "threads"),
    [((), 3, 4, 3, 1), ((), 2, 8, 2, 4), (("threads=2",), 6, 4, 2, 2), ((), 9, 4, 4, 1)],
)
def test_runs_share_out_the_cores(tmp_path, monkeypatch, given, count, cores, workers, threads):
    pytest.importorskip("distributed")
    monkeypatch.setattr("deepir.sweep.cluster.CORES", cores)
    fixed, axes = parse_axes([SMALL, "method=average", *given, f"seed={','.join(map(str, range(count)))}"])
    with prepare("nuc", fixed, axes, folder=tmp_path) as sweep:
        assert sweep.workers == workers
        assert {cell.config.threads for cell in sweep.cells} == {threads}


def test_without_dask_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(ConfigError, match=r"pip install 'deepir\[compare\]'"):
        prepare("nuc", [], [], folder=tmp_path).__enter__()


def test_the_comparison_that_is_documented_is_one(tmp_path):
    text = next(text for _, text in blocks(ROOT / "docs/how-to/ablations.md", "sh") if "compare" in text)
    _, _, name, *settings = shlex.split(text)
    fixed, axes = parse_axes(settings)
    assert len(make_cells(name, fixed, axes, tmp_path, 1)) == 36


def test_a_run_that_takes_its_worker_down_each_time_is_given_up():
    distributed = pytest.importorskip("distributed")
    from deepir.sweep.cluster import _failure

    assert "its workers died" in _failure(distributed.KilledWorker("a", None, 3))
    assert _failure(ValueError("not\nthis")) == "ValueError: not this"


def test_the_scheduler_is_asked_to_listen_on_this_machine_only(monkeypatch):
    pytest.importorskip("distributed")
    from deepir.sweep import cluster

    given = {}

    def asked(**how):
        given.update(how)
        raise InterruptedError

    monkeypatch.setattr(cluster, "LocalCluster", asked)
    with pytest.raises(InterruptedError), cluster._client(1, None):
        pass
    assert (given["host"], given["dashboard_address"]) == ("127.0.0.1", "127.0.0.1:0")


@pytest.mark.slow
def test_nobody_else_reaches_the_scheduler_and_its_workers():
    pytest.importorskip("distributed")
    from deepir.sweep.cluster import _client

    with _client(1, None) as client:
        scheduler = client.cluster.scheduler
        addresses = [each.listen_address for each in scheduler.listeners]
        addresses += [*client.scheduler_info()["workers"]]
        addresses += [worker.nanny for worker in scheduler.workers.values()]
        addresses.append(client.dashboard_link)
    assert len(addresses) >= 4
    assert all("://127.0.0.1:" in each for each in addresses)


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
