"""The site's pages in order, its home and its reference: mkdocs calls this, see mkdocs.yml.

A new page of docs/ needs no line here: what no other section names is a problem's page.
"""

from __future__ import annotations

from fnmatch import fnmatchcase
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parent.parent
PROBLEMS = "Problems"
#: Topics of how-it-estimates.md, in its order.
ESTIMATES = [
    "noise",
    "start",
    "motion",
    "bend",
    "walkers",
    "strengths",
    "shading",
    "rows",
    "defects",
    "inputs",
    "scene",
    "solve",
    "limits",
]
SECTIONS = {
    "Use": [
        "tutorial",
        "whole-recordings",
        "live",
        "raw-cameras",
        "gallery",
        "cli",
        "configuration",
        "files",
        "which-prior",
        "priors",
        "ablations",
    ],
    PROBLEMS: ["super-resolution"],
    "Concepts": ["how-it-works", "jitter", "sensor-physics", "conventions", "extending"],
    "Estimation": ["how-it-estimates", *(f"estimates-{each}" for each in ESTIMATES), "judging"],
    "Figures": ["results", "benchmarks", "bench-*", "rivals", "performance", "reliability"],
    "Reference": ["glossary", "components", "reference/*", "CHANGELOG"],
}
#: Pages of the reference: the modules of each, in order.
REFERENCE = {
    "Running": ["api", "runner", "config", "burst", "result", "storage", "errors"],
    "Solving": ["problem", "schedule", "optim", "pipeline", "closed_form", "registered_average"],
    "Estimating": ["effects", "estimation", "diagnostics", "multiview", "recording", "live"],
    "Operators": ["operators"],
    "Fields": ["fields"],
    "Priors": ["priors", "denoisers", "likelihoods"],
    "Problems": ["problems", "baselines"],
    "Registration": ["registration"],
    "Simulator": ["simulate", "metrics", "comparison"],
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
        files.append(File.generated(config, f"reference/{_slug(title)}.md", content=_reference(title, names)))
    config.nav = _nav([file.src_uri.removesuffix(".md") for file in files.documentation_pages()])
    return files


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
    """Sections of pages; each page is in the first that names it, or else in `PROBLEMS`."""
    left = [page for page in pages if page != "index"]
    found: dict[str, list[str]] = {}
    for section, patterns in SECTIONS.items():
        chosen = [page for pattern in patterns for page in left if fnmatchcase(page, pattern)]
        found[section] = [f"{page}.md" for page in chosen]
        left = [page for page in left if page not in chosen]
    found[PROBLEMS] += [f"{page}.md" for page in left]
    return [{"Home": "index.md"}, *({name: list(each)} for name, each in found.items())]


def _slug(title: str) -> str:
    return title.lower().replace(" ", "-")
