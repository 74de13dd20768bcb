"""The documentation as a site: it builds without a warning, every page is in it, and its links hold."""

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
        if page.parent.name == "docs":
            assert linked.count(f"{page.stem}/") == 1, page


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
    text = (site / "reference/running/index.html").read_text()
    assert "Correct a burst" in text
    assert 'id="deepir.api.run"' in text


def test_a_page_asks_other_servers_for_nothing(site):
    home = (site / "index.html").read_text()
    assert not re.findall(r'(?:src|<link[^>]*href)="https?://', home)
