"""`report.html` of a sweep in a browser: sorted, drawn, linked, and nothing in it can act."""

import pytest

from deepir.sweep.table import Row, write_report

HOSTILE = "<img src=x onerror=alert(1)>"


def row(prior, frames, seed, psnr, error=""):
    values = {"prior": prior, "data.frames": str(frames), "seed": str(seed)}
    metrics = {"psnr_aligned": psnr, "seconds": frames + seed, "frames": frames}
    return Row(f"{prior} {frames} {seed}", values, {} if error else metrics, error)


@pytest.fixture
def found():
    made = [row("tv", n, s, 40 + n + s) for n in (3, 20, 10) for s in (0, 1)]
    return [*made, row("dip", 3, 0, 38), row(HOSTILE, 3, 0, 0, error=HOSTILE)]


@pytest.fixture
def page(tmp_path, visit, found):
    (tmp_path / "tv 3 0").mkdir()
    (tmp_path / "tv 3 0/report.html").write_text("the run")
    write_report(tmp_path / "report.html", found, f"deepir compare {HOSTILE}")
    return visit(tmp_path / "report.html")


def column(page, number):
    return page.locator(f"tbody td:nth-child({number})").all_inner_texts()


def sort(page, heading):
    page.locator("th button", has_text=heading).click()


def test_a_heading_sorts_numbers_by_size_and_once_more_the_other_way(page):
    sort(page, "data.frames")
    assert column(page, 2) == ["3", "3", "3", "10", "20"]
    sort(page, "data.frames")
    assert column(page, 2) == ["20", "10", "3", "3", "3"]
    assert page.locator("th[aria-sort=descending]").inner_text().startswith("data.frames")


def test_what_has_no_figure_comes_last_either_way(page):
    for first in ("38.00", "60.50 60.00 to 61.00"):
        sort(page, "PSNR")
        assert column(page, 3)[0] == first
        assert column(page, 3)[-1] == "–"


def test_the_best_figure_is_marked(page):
    assert page.locator("td.best").all_inner_texts() == ["60.50 60.00 to 61.00", "3"]


def test_a_heading_is_reached_by_tab_and_pressed_by_enter(page):
    page.keyboard.press("Tab")  # dark or light
    page.keyboard.press("Tab")
    page.keyboard.press("Enter")
    assert column(page, 1)[0] == HOSTILE


def test_a_run_with_a_report_is_linked(page):
    assert page.locator("tbody a").get_attribute("href") == "tv%203%200/report.html"


def test_what_failed_is_said_as_it_is(page):
    assert HOSTILE in page.inner_text("#failed li")
    assert HOSTILE in page.inner_text("h1")
    assert page.locator("img").count() == 0


def test_curves_are_drawn_against_frames_and_seconds(page):
    assert page.locator("figcaption").all_inner_texts() == ["PSNR (dB) against frames", "PSNR (dB) against seconds"]
    page.locator("circle.dot").first.hover()
    assert page.inner_text(".card .reading") == "tv · 3 frames: 43.5"


def test_a_phone_scrolls_the_table_and_not_the_page(page):
    page.set_viewport_size({"width": 360, "height": 740})
    assert page.evaluate("document.documentElement.scrollWidth") == 360


def test_a_sweep_of_which_nothing_has_finished_has_a_page_too(tmp_path, visit):
    write_report(tmp_path / "report.html", [row("tv", 3, 0, 0, error="failed")], "deepir compare")
    page = visit(tmp_path / "report.html")
    assert column(page, 3) == ["–"]
    assert page.locator("#curves").is_hidden()
