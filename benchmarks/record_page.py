"""The pages of the benchmark of record, written from the cells that are finished: all of it, and a summary."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import record_plots
import record_real
from record_panels import write_methods
from record_protocol import Protocol
from record_tables import FRAMES, Found, margins, table, with_gaps

from deepir.storage.folder import Record
from deepir.sweep.cells import BURST_AXIS, Cell
from deepir.sweep.table import make_rows

HERE = f"{Path(__file__).parent.parent}/"

HEADER = "<!-- written by benchmarks/record.py: `make bench`, `make bench-full` -->"
INTRODUCTION = """\
# Benchmark of record

All methods on the same bursts, each run a cell of `deepir compare`. {what}

PSNR and SSIM are taken after one gain and level (the [gauge](../docs/reference/conventions.md#gauge)), never after
warping a result onto the truth. Gap: to `oracle`, total variation that is given the true sensor, motion and noise,
and the weight that is best on the truth. Radiometric: root mean square error after one level, the gain as it is, in
mK or in % of the scene's range. Columns and pixels: what is left of a fixed pattern, from what neighbours differ by.
Roughness: what neighbours differ by, to the level. Motion: how far the corners of a frame are off. Gain, offset and
stray flux: root mean squares over good pixels. Seconds are of one thread, and MB the most that the process held.
Figures are medians over bursts; PSNR has its quartiles.

`joint` is deepir's default, `joint NAME` deepir with that prior; the others are
[rivals](../docs/reference/methods.md), and every one has deepir's registration and the mask of bad pixels. Told more
than the burst, and so no rival's figure, are `oracle` and `flat_field` (sixteen frames each of a cold and a hot black
body). In deconvolution the rivals have the setting that is best on the truth.

Each picture is seen with a seed of its own, both in the burst's name, and nobody tunes on them. Results and bursts lie
in `runs/bench`, beside each its configuration, versions, machine and the digests of its input."""
SUMMARY = """\
# Against other methods

All methods on the same bursts, each run a cell of `deepir compare`. {what}

- PSNR in dB, after one gain and level: the median over bursts.
- Best rival: the best method that knows only the burst. [Methods](../reference/methods.md) lists them.
- Gap: to an oracle that knows the true sensor, motion and noise, and the best weight of total variation.
- Nothing was tuned on these pictures and seeds.

| protocol | bursts |
|---|---|
{key}

{margins}

![Quality against the number of frames](../images/benchmarks_frames.png)

![Quality against seconds](../images/benchmarks_seconds.png)

`make bench` runs a part in a quarter of an hour, `make bench-full` all of it in hours. Every method, with quartiles,
is in `notes/benchmark-of-record.md` of the source."""
REASON = "Why the margin is what it is, and where it is less than 3 dB: [rivals](rivals.md#how-far-ahead)."
PICTURES = (
    ("Quality against frames", "benchmarks_frames.png", record_plots.against_frames),
    ("Quality against seconds", "benchmarks_seconds.png", record_plots.against_seconds),
    ("Gap to the oracle", "benchmarks_gap.png", record_plots.gaps),
)

#: Pictures of docs/reference/methods.md and notes/rivals.md: protocol, burst and number of frames.
PANELS = (("rivals.png", "a", "procedural60-404", "5"), ("rivals_sr.png", "sr4", "coffee-441", "16"))


def write_pages(
    path: Path,
    summary: Path,
    images: Path,
    protocols: Sequence[Protocol],
    cells: Mapping[str, Sequence[Cell]],
    errors: Mapping[str, str],
    *,
    full: bool,
) -> None:
    """Write the page of all methods, the summary for the site, and the pictures of both."""
    everything = {each.key: found(each, cells[each.key], errors) for each in protocols}
    lines = [HEADER, INTRODUCTION.format(what=_what(everything, full=full))]
    lines += ["", "## Margin over the rivals", "", *margins(everything), "", REASON]
    for title, name, draw in PICTURES:
        if draw(images / name, everything):
            lines += ["", f"## {title}", "", f"![{title}](../docs/images/{name})"]
    for name, key, burst, n in PANELS:
        write_methods(images / name, cells[key], burst, n)
    for each in everything.values():
        lines += ["", f"## ({each.protocol.key}) {each.protocol.title}"]
        for n in each.numbers():
            lines += ["", f"### {_title(each, n)}", "", *table(each, n)]
        lines += _missing(each)
    lines += ["", "## What was run, and on what", "", *_record(everything, cells)]
    path.write_text("\n".join(lines) + "\n")
    summary.write_text(f"{HEADER}\n{_summary(everything, full=full)}\n")


def _summary(everything: Mapping[str, Found], *, full: bool) -> str:
    key = "\n".join(f"| ({each.protocol.key}) | {each.protocol.title} |" for each in everything.values())
    return SUMMARY.format(what=_what(everything, full=full), key=key, margins="\n".join(margins(everything)))


def found(protocol: Protocol, cells: Sequence[Cell], errors: Mapping[str, str]) -> Found:
    """A protocol's cells as rows, with their gaps to the oracle."""
    of_cells = {cell.name: errors.get(f"{protocol.key}/{cell.name}", "") for cell in cells}
    every = make_rows(cells, of_cells)
    for cell, row in zip(cells, every, strict=True):
        if cell.values[BURST_AXIS] == "a65" and isinstance(row.metrics, dict) and row.metrics:
            row.metrics.update(record_real.measured(cell.folder.path))
    return Found(protocol, with_gaps(every))


def _title(each: Found, n: str) -> str:
    """The burst, where there is only one, and the number of frames."""
    bursts = list(dict.fromkeys(row.values[BURST_AXIS] for row in each.rows if row.values[FRAMES] == n))
    count = n if n.isdecimal() else str(n.count(",") + 1)
    alone = f"{bursts[0]}, " if len(bursts) == 1 else ""
    return f"({each.protocol.key}) {alone}{count} frame{'s' * (count != '1')}"


def _what(everything: Mapping[str, Found], *, full: bool) -> str:
    every = [row for each in everything.values() for row in each.rows]
    done = sum(bool(row.metrics) for row in every)
    kind = "the full run (`make bench-full`)" if full else "a part of it (`make bench`); `make bench-full` runs all"
    return f"This is {kind}: {done} of {len(every)} runs are finished."


def _missing(each: Found) -> Iterator[str]:
    """Lines on what a protocol lacks, with the reasons."""
    reasons = Counter(burst.missing() for burst in each.protocol.bursts.values())
    reasons.pop("", None)
    lost = Counter((row.values["method"], row.error or "not run yet") for row in each.rows if not row.metrics)
    if reasons or lost or each.protocol.missing:
        yield ""
    for left_out in each.protocol.missing:
        yield f"- Left out: {left_out}."
    for reason, count in reasons.items():
        yield f"- {count} of {len(each.protocol.bursts)} bursts are left out: {reason}."
    for (method, reason), count in sorted(lost.items()):
        yield f"- {method}: {count} {'run is' if count == 1 else 'runs are'} missing: {reason.replace(HERE, '')}."


def _record(everything: Mapping[str, Found], cells: Mapping[str, Sequence[Cell]]) -> Iterator[str]:
    """Machines, versions, and each burst's seed and digest."""
    records = [(key, cell.values[BURST_AXIS], cell.folder.record()) for key, each in cells.items() for cell in each]
    for name in ("machine", "versions"):
        for what, count in Counter(_said(found) for *_, record in records if (found := getattr(record, name))).items():
            yield f"- {name}: {what} ({count} runs)"
    yield ""
    yield "| burst | seed | SHA-256 of the frames |"
    yield "|---|---|---|"
    for key, each in everything.items():
        for name, burst in each.protocol.bursts.items():
            digest = next((digest_of(record) for k, b, record in records if (k, b) == (key, name)), "")
            if digest:
                yield f"| ({key}) {name} | {getattr(burst, 'seed', '')} | `{digest[:16]}` |"


def _said(what: str | Mapping[str, str]) -> str:
    return what if isinstance(what, str) else ", ".join(f"{key} {value}" for key, value in what.items())


def digest_of(record: Record) -> str:
    """Of the frames that a run has read."""
    return next(iter(record.inputs.values()), "")
