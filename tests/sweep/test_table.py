"""What came out, in numbers and pictures."""

import csv
import io
import itertools

import pytest
from PIL import Image

from deepir.errors import ConfigError
from deepir.io.output import write_text
from deepir.storage.folder import Record, RunFolder
from deepir.sweep.cells import Cell
from deepir.sweep.table import (
    Row,
    check_free,
    csv_table,
    group_rows,
    make_rows,
    markdown,
    table_lines,
    write_plots,
    write_report,
)


def row(prior, frames, seed, psnr=None, error=""):
    values = {"prior": prior, "data.frames": str(frames), "seed": str(seed)}
    metrics = {"psnr_aligned": psnr, "seconds": 1.0 + seed, "frames": frames, "prior": prior}
    return Row(f"{prior}{frames}{seed}", values, metrics if psnr else {}, error)


@pytest.fixture
def rows():
    cells = itertools.product(("tv", "dip"), (3, 5), (0, 1, 2))
    return [row(prior, frames, seed, 30 + frames + seed**2) for prior, frames, seed in cells]


def test_cells_that_differ_in_seeds_are_one_line_with_median_and_range(rows):
    heads, body = table_lines(rows)
    assert heads == ["prior", "data.frames", "finished", "PSNR (dB)", "radiometric error", "seconds"]
    assert body[0] == ["tv", "3", "3/3", "34.00 (33.00 to 37.00)", "–", "2 (1 to 3)"]
    assert [line[:2] for line in body] == [["tv", "3"], ["tv", "5"], ["dip", "3"], ["dip", "5"]]


def test_what_failed_is_counted_and_explained(rows):
    rows[0] = row("tv", 3, 0, error="it | did not work")
    assert table_lines(rows)[1][0][2:4] == ["2/3", "35.50 (34.00 to 37.00)"]
    assert "Failed:\n\n- `tv30`: it | did not work\n" in markdown(rows, "deepir compare")


def test_the_machines_are_named_once():
    rows = [Row(name, {"prior": name}, {"seconds": 2.0, "machine": "a fast one, 4 cores"}) for name in "ab"]
    assert markdown(rows, "deepir compare").endswith("\nOn a fast one, 4 cores.\n")


def test_without_truth_the_held_out_error_is_shown():
    rows = [Row("a", {"prior": "tv"}, {"held_out_rmse": 4.0, "seconds": 2.0})]
    assert table_lines(rows) == (["prior", "finished", "held-out error", "seconds"], [["tv", "1/1", "4", "2"]])


def test_the_csv_has_a_line_for_each_cell_and_each_column_once(rows):
    found = list(csv.DictReader(io.StringIO(csv_table([*rows, row("tv", 5, 3, error="no, not this")]))))
    assert found[0].keys() == {"prior", "data.frames", "seed", "psnr_aligned", "seconds", "frames", "error"}
    assert len(found) == len(rows) + 1
    assert found[-1]["error"] == "no, not this"
    assert found[1]["psnr_aligned"] == "34"


def test_groups_leave_out_the_axes_that_are_averaged(rows):
    assert len(group_rows(rows)) == 4
    assert [len(group.rows) for group in group_rows(rows, ("seed", "data.frames"))] == [6, 6]


def test_plots_are_drawn_and_those_of_one_point_are_not(rows, tmp_path):
    path = tmp_path / "quality.png"
    write_plots(path, rows)
    with Image.open(path) as picture:
        assert picture.width > 1000
    write_plots(path, rows[:3])
    assert not path.exists()


def test_a_table_that_no_sweep_wrote_is_safe(rows, tmp_path):
    (tmp_path / "table.csv").write_text("mine")
    with pytest.raises(ConfigError, match=r"table.csv, which no comparison wrote"):
        check_free(tmp_path)
    write_text(tmp_path / "table.md", markdown(rows, "deepir compare"))
    check_free(tmp_path)


def test_a_damaged_file_of_metrics_is_no_result(tmp_path):
    folder = RunFolder(tmp_path)
    folder.begin("seed: 1", Record())
    cell = Cell({"seed": "1"}, None, folder)
    for content in ("3", "{", "{}", '{"frames": "3"}', "[" * 9999):
        (tmp_path / "metrics.json").write_text(content)
        assert make_rows([cell], {})[0].metrics == {}
    (tmp_path / "metrics.json").write_text('{"frames": 3, "seconds": "x", "psnr_aligned": 31.5}')
    assert table_lines(make_rows([cell], {}))[1] == [["1/1", "31.50", "–", "–"]]


NAME = "=cmd|'/c calc'!A1\n\x1b[31m$\\frac$"


@pytest.fixture
def odd(tmp_path):
    return [Row(f"a{i}", {"scene": f"{NAME}{i}"}, row("tv", 3, 0, 30 + i).metrics, NAME) for i in range(2)]


def test_no_name_begins_a_line_or_moves_the_cursor(odd, tmp_path):
    write_plots(tmp_path / "quality.png", odd)
    write_report(tmp_path / "report.html", odd, f"deepir batch {NAME}")
    assert (tmp_path / "quality.png").exists()
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    for text in (csv_table(odd), markdown(odd, f"deepir batch {NAME}"), page):
        assert all(line.isprintable() for line in text.replace("\t", "").split("\n"))
        assert "\\u001b" not in text
        assert "\n\\x1b" not in text


def test_no_cell_of_the_csv_is_a_formula(odd):
    more = [Row("c", {"scene": text}, {}) for text in ("-1.5", "+A1", "@a", "-a", "1e3")]
    found = [line["scene"] for line in csv.DictReader(io.StringIO(csv_table([*odd, *more])))]
    assert found[0].startswith("'=cmd")
    assert found[2:] == ["-1.5", "'+A1", "'@a", "'-a", "1e3"]
