"""The documentation as a site: it builds without a warning, every page is in it, and its links hold."""

import json
import os
import re
import subprocess
import sys
from urllib.parse import unquote

import pytest
from documentation import PAGES, ROOT

pytest.importorskip("mkdocs", reason="no mkdocs: pip install 'deepir[docs]'")
pytest.importorskip("mkdocstrings", reason="no mkdocstrings: pip install 'deepir[docs]'")


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", folder]
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    ended = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    return folder


def test_every_page_is_in_the_navigation_once(site):
    home = (site / "index.html").read_text()
    linked = re.findall(r'href="([\w./-]+)" class="md-nav__link"', home)
    for page in PAGES:
        if page.is_relative_to(ROOT / "docs"):
            name = page.relative_to(ROOT / "docs").with_suffix("").as_posix()
            assert linked.count(f"{name}/") == 1, page


def test_links_lead_to_pages_and_headings_that_are_there(site):
    pages = {path: path.read_text() for path in site.rglob("index.html")}
    for path, text in pages.items():
        for link in re.findall(r'(?:href|src)="([^"]+)"', text):
            if re.match(r"(https?|data|mailto):", link):
                continue
            name, _, anchor = link.partition("#")
            target = (path.parent / unquote(name)).resolve() if name else path
            target = target / "index.html" if target.is_dir() else target
            assert target.exists(), (path, link)
            if anchor and target in pages:
                assert f'id="{unquote(anchor)}"' in pages[target], (path, link)


def test_the_reference_says_what_a_docstring_says(site):
    text = (site / "reference/api/running/index.html").read_text()
    assert "Correct a burst" in text
    assert 'id="deepir.api.run"' in text


def test_formulas_are_drawn_and_a_page_that_a_script_wrote_has_its_title(site):
    text = (site / "explanation/noise/index.html").read_text()
    assert 'aria-label="\\sigma^2(s) = ' in text
    assert not re.search(r"\$[^$<]*\\[a-z]+[^$<]*\$|FORMULA\d", text)
    title = r'href="benchmarks/record/"[^>]*>\s*<span class="md-ellipsis">\s*Against other methods'
    assert re.search(title, (site / "index.html").read_text())


def test_the_site_loads_nothing_from_another_server(site):
    for page in site.rglob("*.html"):
        text = page.read_text()
        assert not re.findall(r'<(?:script|img|iframe|source|link)\b[^>]*(?:src|href)="(?:https?:)?//[^"]*"', text), (
            page
        )
        assert 'class="mermaid"' not in text, page  # drawn by a script of another server
    for sheet in site.rglob("*.css"):
        assert not re.findall(r"(?:url\(|@import)\s*[\"']?(?:https?:)?//", sheet.read_text()), sheet


def test_the_search_is_part_of_the_site(site):
    index = json.loads((site / "search/search_index.json").read_text())
    assert any("dead pixels" in each["text"] for each in index["docs"])
    settings = json.loads(re.search(r'id="__config"[^>]*>(.*?)</script>', (site / "index.html").read_text())[1])
    assert (site / settings["search"]).is_file()
