"""What a batch leaves beside the captures' own results: results.csv, results.parquet, summary.json, index.html."""

from __future__ import annotations

import csv
import io
import statistics
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from fusion.results.batch import COLUMNS, Outcome, Row
from scenes.files.tables import harmless
from scenes.files.whole import replace_file

NUMBERS = ("add_s_mm", "rotation_deg", "translation_mm", "time_ms")


def summary_of(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Counts of captures, frames and verdicts, and medians over the frames; None where nothing is known."""
    rows = [row for outcome in outcomes for row in outcome.rows if row["status"] != "error"]
    known = [row["add_s_mm"] for row in rows if row["add_s_mm"] is not None]
    return {
        "captures": len(outcomes),
        "kept": sum(outcome.status == "kept" for outcome in outcomes),
        "failed": sum(outcome.status == "error" for outcome in outcomes),
        "frames": len(rows),
        "verdicts": {word: sum(row["verdict"] == word for row in rows) for word in ("ok", "ambiguous", "lost")},
        **{f"median_{name}": median([row[name] for row in rows]) for name in NUMBERS},
        "success_add_s_below_5mm": sum(value < 5.0 for value in known) / len(known) if known else None,
    }


def median(values: Sequence[float | None]) -> float | None:
    """Of those that are known; None for none."""
    known = [value for value in values if value is not None]
    return float(statistics.median(known)) if known else None


def write_all(out: Path, title: str, outcomes: Sequence[Outcome]) -> list[Path]:
    """Write the tables and the index; returns the files. Parquet only where pyarrow is installed."""
    from fusion.results.report.index import write_index

    rows = [row for outcome in outcomes for row in outcome.rows]
    written = [out / "results.csv"]
    text = io.StringIO()
    table = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    table.writeheader()
    table.writerows({k: harmless(v) if isinstance(v, str) else v for k, v in row.items()} for row in rows)
    replace_file(written[0], text.getvalue().encode())
    if find_spec("pyarrow") is not None:
        written.append(out / "results.parquet")
        replace_file(written[-1], _parquet(rows))
    summary = summary_of(outcomes)
    write_index(out / "index.html", title, outcomes, summary)
    return [*written, out / "index.html"]


def _parquet(rows: Sequence[Row]) -> bytes:
    import pyarrow
    from pyarrow import parquet

    whole = ("frame", "contacts", "modes")
    real = (*NUMBERS, "visible_fraction")
    kinds = {name: pyarrow.int64() for name in whole} | {name: pyarrow.float64() for name in real}
    schema = pyarrow.schema([(name, kinds.get(name, pyarrow.string())) for name in COLUMNS])
    buffer = io.BytesIO()
    parquet.write_table(pyarrow.Table.from_pylist(list(rows), schema=schema), buffer)
    return buffer.getvalue()
