"""The page of a batch: one row a capture with its picture, sorted and filtered as asked, each linked to its report. No
network, no library.
"""

from __future__ import annotations

import html
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

from fusion.results.batch import THUMBNAIL, Outcome
from fusion.results.report.files import asset, page
from fusion.results.summary import median
from scenes.files.whole import replace_file
from scenes.words import counted

VERDICTS = ("ok", "ambiguous", "lost", "failed")

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
    """Write the page; reports and pictures are linked relative to it where they were written."""
    heads = "".join(
        f'<th data-kind="{kind}"{_class(rare, kind)}><button type="button">{html.escape(name)}</button></th>'
        for name, kind, rare in HEADS
    )
    orders = "".join(
        f'<option value="{column} {down}">{html.escape(name)} {"↓" if down else "↑"}</option>'
        for column, (name, _, _) in enumerate(HEADS)
        for down in (0, 1)
    )
    parts = {
        "NAME": html.escape(title),
        "FACTS": "".join(f"<li>{html.escape(fact)}</li>" for fact in facts(summary)),
        "FILTERS": _filters(outcomes),
        "ORDERS": orders,
        "HEAD": f'<th aria-label="picture"></th>{heads}',
        "ROWS": "".join(_row(path.parent, outcome) for outcome in outcomes),
        "SCRIPT": asset("index.js"),
        "IMAGES": "data: file: 'self'",
    }
    replace_file(path, page("index.html", title, asset("report.css") + asset("index.css"), parts).encode())


def _verdicts(outcome: Outcome) -> list[str]:
    """What its frames are said to be, each once; "failed" without frames."""
    if outcome.status == "error":
        return ["failed"]
    return [word for word in VERDICTS[:-1] if any(row["verdict"] == word for row in outcome.answers)]


def _filters(outcomes: Sequence[Outcome]) -> str:
    """A button for all captures and one for each verdict, with how many captures have such a frame."""
    counts = {word: sum(word in _verdicts(outcome) for outcome in outcomes) for word in VERDICTS}
    out = [f'<button type="button" data-verdict="" aria-pressed="true">all {len(outcomes)}</button>']
    for word, count in counts.items():
        off = "" if count else " disabled"
        out.append(f'<button type="button" data-verdict="{word}" aria-pressed="false"{off}>{word} {count}</button>')
    return "".join(out)


def facts(summary: Mapping[str, Any]) -> list[str]:
    """The summary in words."""
    out = [counted(summary["captures"], "capture"), counted(summary["frames"], "frame")]
    out += [f"{count} {word}" for word, count in summary["verdicts"].items() if count]
    if summary["failed"]:
        out.append(f"{summary['failed']} failed")
    if summary["left_out"]:
        out.append(f"{counted(summary['left_out'], 'frame')} left out")
    if summary["median_add_s_mm"] is not None:
        out.append(f"median ADD-S {summary['median_add_s_mm']:.2f} mm")
        out.append(f"{100 * summary['success_add_s_below_5mm']:.0f} % below 5 mm")
    return out


def _class(rare: bool, kind: str) -> str:
    names = [name for name, wanted in (("rare", rare), ("n", kind == "number")) if wanted]
    return f' class="{" ".join(names)}"' if names else ""


def _row(folder: Path, outcome: Outcome) -> str:
    failed = outcome.status == "error"
    rows = outcome.rows if failed else outcome.answers
    found = [row["verdict"] == "ok" for row in rows if not failed]
    counts = {word: sum(row["verdict"] == word for row in rows) for word in _verdicts(outcome)}
    said = rows[0]["error"] if failed else ", ".join(f"{count} {word}" for word, count in counts.items())
    missing = len(outcome.left_out)
    if missing:
        said = f"{said}, {missing} left out"
    values: list[Any] = [
        outcome.job.name,
        None if failed else rows[0]["object"] if rows else None,
        None if failed else len(rows),
        None if failed or not found else round(100 * sum(found) / len(found)),
        *(median([row[name] for row in rows]) for name in ("add_s_mm", "rotation_deg", "time_ms")),
        said,
    ]
    if failed:
        pills = f'<span class="pill lost">failed</span> {html.escape(str(said))}'
    else:
        pills = "".join(f'<span class="pill {word}">{count} {word}</span>' for word, count in counts.items())
        if missing:
            first = html.escape(str(outcome.left_out[0]["error"]))
            pills += f'<span class="pill lost" title="{first}">{missing} left out</span>'
    cells = [_picture(folder, outcome)]
    for (name, kind, rare), value in zip(HEADS, values):
        sort = html.escape("" if value is None else str(value))
        if name == "capture":
            link = _linked(folder, outcome, html.escape(_text(value)))
            cells.append(f'<td class="long name" data-value="{sort}">{link}</td>')
        elif name == "said":
            cells.append(f'<td class="long said" data-value="{sort}">{pills}</td>')
        else:
            label = f' data-label="{html.escape(name)}"'
            cells.append(f'<td{_class(rare, kind)}{label} data-value="{sort}">{html.escape(_text(value))}</td>')
    kind = ' class="failed"' if failed else ""
    return f'<tr{kind} data-verdicts="{" ".join(_verdicts(outcome))}">{"".join(cells)}</tr>'


def _beside(folder: Path, outcome: Outcome, name: str) -> str | None:
    """The address of a file of a capture's results, from the page; None when it is not there."""
    path = Path(outcome.job.out) / name
    if outcome.status == "error" or not path.is_file():
        return None
    # results may be elsewhere: a link in their place is followed
    return quote(Path(os.path.relpath(path.resolve(), folder.resolve())).as_posix())


def _picture(folder: Path, outcome: Outcome) -> str:
    address = _beside(folder, outcome, THUMBNAIL)
    picture = "<span></span>" if address is None else f'<img src="{address}" alt="" loading="lazy">'
    return f'<td class="look">{picture}</td>'


def _linked(folder: Path, outcome: Outcome, text: str) -> str:
    address = _beside(folder, outcome, "report.html")
    return text if address is None else f'<a href="{address}">{text}</a>'


def _text(value: Any) -> str:
    if value is None:
        return "–"
    if isinstance(value, float):
        return f"{value:.0f}" if abs(value) >= 20 else f"{value:.2f}"
    return str(value)
