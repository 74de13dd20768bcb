"""Code blocks and links of the documentation, so that what it shows is what is tested."""

import importlib.util
import re
from pathlib import Path

ROOT = Path(__file__).parent.parent
PAGES = sorted([ROOT / "README.md", *(ROOT / "docs").rglob("*.md")])
OFF_THE_SITE = sorted([ROOT / "CHANGELOG.md", ROOT / "CONTRIBUTING.md", *(ROOT / "notes").glob("*.md")])
BLOCK = re.compile(r"^(?:`(?P<name>[\w./-]+)`\n\n)?```(?P<kind>\w+)\n(?P<text>.*?)^```$", re.MULTILINE | re.DOTALL)


def blocks(page, kind=None):
    """(file name or None, text) of each block of a page, those of one language only if `kind` is given."""
    found = BLOCK.finditer(page.read_text(encoding="utf-8"))
    return [(each["name"], each["text"]) for each in found if kind in (None, each["kind"])]


def files(page):
    """The files that a page shows: name -> text."""
    return {name: text for name, text in blocks(page) if name}


def script(name):
    """A script of the documentation as a module."""
    spec = importlib.util.spec_from_file_location(name, ROOT / f"docs/{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def rows(page, heading):
    """The rows of the first table under a heading: lists of cells, the header left out."""
    section = f"\n{page.read_text(encoding='utf-8')}".split(f"\n{heading}\n", 1)[1]
    table = re.search(r"(?:^\|.*\|$\n?)+", section, re.MULTILINE)[0]
    cells = [[cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]] for line in table.splitlines()]
    return cells[2:]
