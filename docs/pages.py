"""The site's pages in order, its home and its reference: mkdocs calls this, see mkdocs.yml.

A new page of docs/ needs no line here: the section is its folder.
"""

from __future__ import annotations

import re
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parent.parent
#: Sections: pages in order, `*` for those of the folder that are not named; a page is in the first that names it.
SECTIONS = {
    "Tutorials": ["tutorials/first-recording", "tutorials/burst", "tutorials/python", "tutorials/*"],
    "How-to": [
        "how-to/wrong-result",
        "how-to/cameras",
        "how-to/jitter",
        "how-to/whole-recordings",
        "how-to/live",
        "how-to/apply-maps",
        "how-to/*",
    ],
    "Reference": [
        "reference/cli",
        "reference/configuration",
        "reference/files",
        "reference/messages",
        "reference/components",
        "reference/*",
        "CHANGELOG",
    ],
    "Python API": ["reference/api/*"],
    "Explanation": [
        "explanation/how-it-works",
        "explanation/sensor-physics",
        "explanation/estimation",
        "explanation/solve",
        "explanation/motion",
        "explanation/moving-objects",
        "explanation/noise",
        "explanation/sensor-pattern",
        "explanation/shading",
        "explanation/inputs",
        "explanation/scene",
        "explanation/priors",
        "explanation/accuracy",
        "explanation/judging",
        "explanation/recordings",
        "explanation/*",
    ],
    "Benchmarks": ["benchmarks/overview", "benchmarks/record", "benchmarks/*"],
}
#: Pages of the reference: the modules of each, in order.
REFERENCE = {
    "Running": ["api", "correct_recording", "runner", "config", "burst", "result", "storage", "errors"],
    "Solving": ["problem", "schedule", "optim", "pipeline", "closed_form", "metrics"],
    "Estimating": ["effects", "estimation", "diagnostics", "multiview", "recording", "live"],
    "Operators": ["operators"],
    "Fields": ["fields"],
    "Priors": ["priors", "denoisers", "likelihoods"],
    "Problems": ["problems", "baselines"],
    "Registration": ["registration"],
    "Simulator": ["simulate"],
    "Sweeps": ["sweep", "analysis", "training"],
    "Files": ["io", "calibration", "cameras"],
    "For plugins": ["registry", "testing"],
    "Arrays": ["arrays", "kernels"],
}


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the home page, what the README links to, and the reference; put all pages in order."""
    for name, source in {"index.md": "README.md", "CHANGELOG.md": "CHANGELOG.md"}.items():
        text = (ROOT / source).read_text(encoding="utf-8")
        files.append(File.generated(config, name, content=text.replace("](docs/", "](")))
    for name in ("CITATION.cff", "LICENSE"):
        files.append(File.generated(config, name, abs_src_path=str(ROOT / name)))
    for title, names in REFERENCE.items():
        files.append(File.generated(config, f"reference/api/{_slug(title)}.md", content=_reference(title, names)))
    config.nav = _nav([file.src_uri.removesuffix(".md") for file in files.documentation_pages()])
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Leave out the comment that says which script wrote a page: it would hide the title."""
    return re.sub(r"\A<!--.*?-->\n", "", markdown)


def _reference(title: str, names: list[str]) -> str:
    """A page of modules; of a package, all its modules."""
    parts = [f"# {title}\n"]
    for name in names:
        path = ROOT / "deepir" / name
        inside = sorted(each.relative_to(ROOT).with_suffix("") for each in path.rglob("[!_]*.py"))
        modules = [".".join(each.parts) for each in inside] or [f"deepir.{name}"]
        parts += [f"::: {module}\n" for module in modules]
    return "\n".join(parts)


def _nav(pages: list[str]) -> list[dict[str, object]]:
    """Sections of pages; each page is in the section of its folder, where the order of `SECTIONS` puts it."""
    left = [page for page in pages if page != "index"]
    nav: list[dict[str, object]] = [{"Home": "index.md"}]
    for section, patterns in SECTIONS.items():
        chosen: list[str] = []
        for pattern in patterns:
            folder = pattern.rpartition("/")[0]
            found = [page for page in left if fnmatchcase(page, pattern) and page.rpartition("/")[0] == folder]
            chosen += found
            left = [page for page in left if page not in found]
        nav.append({section: [f"{page}.md" for page in chosen]})
    return nav


def _slug(title: str) -> str:
    return title.lower().replace(" ", "-")
