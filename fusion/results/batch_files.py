"""What a batch leaves beside the captures' own results: results.csv, results.parquet, index.html."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

from fusion.results.batch import COLUMNS, Outcome, Row
from fusion.results.report.index import write_index
from fusion.results.summary import NUMBERS, summary_of
from scenes.files.formats.tables import harmless
from scenes.files.whole import replace_file


def write_all(out: Path, title: str, outcomes: Sequence[Outcome]) -> list[Path]:
    """Write the tables and the index; returns the files. Parquet only where pyarrow is installed."""
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
