"""The page of a batch: one row a capture, sortable, each linked to its report. No network, no library."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

from fusion.results.batch import Outcome
from fusion.results.report.files import asset, page
from fusion.results.summary import median
from scenes.files.whole import replace_file

# Name, kind for sorting, whether a small screen goes without.
HEADS = (
    ("capture", "text", False),
    ("object", "text", True),
    ("frames", "number", True),
    ("found %", "number", False),
    ("ADD-S mm", "number", False),
    ("rotation °", "number", True),
    ("time ms", "number", True),
    ("said", "text", False),
)


def write_index(path: Path, title: str, outcomes: Sequence[Outcome], summary: Mapping[str, Any]) -> None:
    """Write the page; reports are linked relative to it where they were written."""
    heads = "".join(
        f'<th data-kind="{kind}"{_class(rare, kind)}><button type="button">{html.escape(name)}</button></th>'
        for name, kind, rare in HEADS
    )
    parts = {
        "NAME": html.escape(title),
        "FACTS": "".join(f"<li>{html.escape(fact)}</li>" for fact in facts(summary)),
        "HEAD": heads,
        "ROWS": "".join(_row(path.parent, outcome) for outcome in outcomes),
    }
    replace_file(path, page("index.html", title, asset("report.css") + asset("index.css"), parts).encode())


def facts(summary: Mapping[str, Any]) -> list[str]:
    """The summary in words."""
    out = [f"{summary['captures']} captures", f"{summary['frames']} frames"]
    out += [f"{count} {word}" for word, count in summary["verdicts"].items() if count]
    if summary["failed"]:
        out.append(f"{summary['failed']} failed")
    if summary["median_add_s_mm"] is not None:
        out.append(f"median ADD-S {summary['median_add_s_mm']:.2f} mm")
        out.append(f"{100 * summary['success_add_s_below_5mm']:.0f} % below 5 mm")
    return out


def _class(rare: bool, kind: str) -> str:
    names = [name for name, wanted in (("rare", rare), ("n", kind == "number")) if wanted]
    return f' class="{" ".join(names)}"' if names else ""


def _row(folder: Path, outcome: Outcome) -> str:
    rows, failed = outcome.rows, outcome.status == "error"
    found = [row["verdict"] == "ok" for row in rows if not failed]
    words = {word: sum(row["verdict"] == word for row in rows) for word in ("ok", "ambiguous", "lost")}
    worst = "lost" if failed or words["lost"] else "ambiguous" if words["ambiguous"] else "ok"
    said = rows[0]["error"] if failed else ", ".join(f"{count} {word}" for word, count in words.items() if count)
    values: list[Any] = [
        outcome.job.name,
        None if failed else rows[0]["object"] if rows else None,
        None if failed else len(rows),
        None if failed or not found else 100.0 * sum(found) / len(found),
        *(median([row[name] for row in rows]) for name in ("add_s_mm", "rotation_deg", "time_ms")),
        said,
    ]
    cells: list[str] = []
    for (_, kind, rare), value in zip(HEADS, values):
        text = html.escape(_text(value))
        sort = "" if value is None else value
        if kind == "text" and len(cells) in (0, len(HEADS) - 1):
            text = _linked(folder, outcome, text) if not cells else f'<span class="pill {worst}">{text}</span>'
            if failed and cells:
                text = f'<span class="pill lost">failed</span> {html.escape(str(said))}'
            cells.append(f'<td class="long" data-value="{html.escape(str(sort))}">{text}</td>')
        else:
            cells.append(f'<td{_class(rare, kind)} data-value="{html.escape(str(sort))}">{text}</td>')
    return f"<tr>{''.join(cells)}</tr>"


def _linked(folder: Path, outcome: Outcome, text: str) -> str:
    report = Path(outcome.job.out) / "report.html"
    if outcome.status == "error" or not report.is_file():
        return text
    return f'<a href="{quote(report.resolve().relative_to(folder.resolve()).as_posix())}">{text}</a>'


def _text(value: Any) -> str:
    if value is None:
        return "–"
    if isinstance(value, float):
        return f"{value:.0f}" if abs(value) >= 20 else f"{value:.2f}"
    return str(value)
