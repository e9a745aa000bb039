"""What every benchmark returns and how it is shown: numbers with their spread, tables, claims, machine and versions.

A benchmark module has `run(settings: BenchSettings) -> Report`; the command line prints the report's tables and writes
`NAME.json`, `NAME.txt`, `NAME.md` and `NAME.svg`. Cells are numbers, text, `Spread` (mean and standard deviation over
trials), `Quantile` (median or another) or `Rate` (share of trials); JSON has the 95 % interval of the last three.
"""

from __future__ import annotations

import json
import math
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fusion.benchmarks.printing.provenance import command_line, machine, machine_line, source_version
from scenes.errors import unknown

if TYPE_CHECKING:
    from fusion.benchmarks.printing.charts import Chart

T = TypeVar("T")
# Resamplings of an interval, and values drawn for one at most.
RESAMPLED, MOST_DRAWS = 1000, 2_000_000


def _no_bar(items: Iterable[T], total: int, what: str) -> Iterator[T]:
    yield from items


def _no_show(table: Table) -> None:
    """Nobody waits for single tables."""


@dataclass(frozen=True)
class BenchSettings:
    """trials: of every cell, None = the benchmark's own number; quick: a tenth of the work or less, but all of it;
    progress(items, total, what) yields the items and may draw a bar; show(table) is told of a table that is complete
    while others are still to come; family: of frames, "all", "tuning" or "report", None = the benchmark's own choice;
    motions, frames: of sequences, methods: of sequences and of `occlusion`, None = all, the benchmark's own number;
    data, bop: folders of recordings of `real` (data: of `gel`, too), None = where they usually are, none; told: of
    frames by family, the estimator is told how large their errors are.
    """

    # As the docstring says; objects: only these; folder: where recordings are kept.
    trials: int | None = None
    seed: int = 0
    quick: bool = False
    progress: Callable[..., Iterator[Any]] = _no_bar
    objects: tuple[str, ...] | None = None
    folder: Path | None = None
    show: Callable[[Table], None] = _no_show
    family: str | None = None
    motions: tuple[str, ...] | None = None
    frames: int | None = None
    methods: tuple[str, ...] | None = None
    data: Path | None = None
    bop: Path | None = None
    told: bool = False

    def count(self, usual: int, quick: int | None = None) -> int:
        """Trials of a cell that usually has `usual` of them (`quick` of them, default a tenth, when in a hurry)."""
        if self.trials is not None:
            return self.trials
        return (quick or max(3, usual // 10)) if self.quick else usual

    def some(self, items: Sequence[T], quick: int) -> Sequence[T]:
        """All of the items; when in a hurry the first `quick`."""
        return items[:quick] if self.quick else items

    def of_methods(self, known: tuple[str, ...], always: str = "") -> tuple[str, ...]:
        """Those of the known methods that are asked for, all by default, and the one that is always among them. Raises
        InputError for an unknown one.
        """
        for name in self.methods or ():
            if name not in known:
                raise unknown("method", name, known)
        return known if self.methods is None else tuple(m for m in known if m in (*self.methods, always))


def own_seed(seed: int, *what: str | float) -> int:
    """A seed for one frame or trial of a cell, from the benchmark's seed and what tells the frame from all others.

    Cells that share seeds share draws of a camera's lasting errors, and are wrong together: five draws would then be
    all that a table of hundreds of frames rests on.
    """
    label = "/".join(str(part) for part in what)
    return int(np.random.default_rng([seed, zlib.crc32(label.encode())]).integers(2**31))


@dataclass(frozen=True)
class Spread:
    """Mean, standard deviation, median and largest of n finite values; low to high: 95 % interval of the mean by
    resampling (Efron 1979). All NaN when there is none.
    """

    mean: float
    sd: float
    median: float
    largest: float
    n: int
    low: float = math.nan
    high: float = math.nan

    @staticmethod
    def of(values: ArrayLike, scale: float = 1.0) -> Spread:
        """From the values (k,), each times `scale` (1e3 turns metres into millimetres)."""
        array = scale * np.asarray(values, dtype=np.float64).ravel()
        array = array[np.isfinite(array)]
        if not len(array):
            return Spread(math.nan, math.nan, math.nan, math.nan, 0)
        sd = float(array.std(ddof=1)) if len(array) > 1 else 0.0
        if len(array) * RESAMPLED <= MOST_DRAWS:
            draws = np.random.default_rng(0).integers(len(array), size=(RESAMPLED, len(array)))
            low, high = np.quantile(array[draws].mean(axis=1), [0.025, 0.975])
        else:  # the mean of so many is a Gaussian's
            half = 1.96 * sd / math.sqrt(len(array))
            low, high = array.mean() - half, array.mean() + half
        centre, largest = float(np.median(array)), float(array.max())
        return Spread(float(array.mean()), sd, centre, largest, len(array), float(low), float(high))


@dataclass(frozen=True)
class Quantile:
    """Median, or the quantile of another share, of n finite values; low to high: its 95 % interval by resampling (Efron
    1979). All NaN when there is none.
    """

    value: float
    low: float
    high: float
    n: int
    share: float = 0.5

    @staticmethod
    def of(values: ArrayLike, scale: float = 1.0, share: float = 0.5) -> Quantile:
        """From the values (k,), each times `scale`."""
        array = scale * np.asarray(values, dtype=np.float64).ravel()
        array = array[np.isfinite(array)]
        if not len(array):
            return Quantile(math.nan, math.nan, math.nan, 0, share)
        rows = max(100, min(RESAMPLED, MOST_DRAWS // len(array)))
        draws = array[np.random.default_rng(0).integers(len(array), size=(rows, len(array)))]
        low, high = np.quantile(np.quantile(draws, share, axis=1), [0.025, 0.975])
        return Quantile(float(np.quantile(array, share)), float(low), float(high), len(array), share)


@dataclass(frozen=True)
class Rate:
    """How many of n trials succeeded."""

    hits: int
    n: int

    @staticmethod
    def of(flags: ArrayLike) -> Rate:
        """From booleans (k,)."""
        array = np.asarray(flags, dtype=bool).ravel()
        return Rate(int(array.sum()), len(array))

    @property
    def share(self) -> float:
        """Hits over trials, NaN without trials."""
        return self.hits / self.n if self.n else math.nan

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of the share (Wilson, JASA 1927): honest for few trials and for 0 or 100 %."""
        if not self.n:
            return math.nan, math.nan
        z = 1.96
        middle = (self.share + z * z / (2 * self.n)) / (1 + z * z / self.n)
        half = z / (1 + z * z / self.n) * math.sqrt(self.share * (1 - self.share) / self.n + (z / (2 * self.n)) ** 2)
        return max(0.0, middle - half), min(1.0, middle + half)


@dataclass(frozen=True)
class Column:
    """Name (with its unit) and digits after the point."""

    name: str
    digits: int = 2


@dataclass
class Table:
    """title; columns; rows of cells as raw values; note: how to read it, published numbers, what was measured."""

    title: str
    columns: Sequence[Column]
    rows: list[list[Any]] = field(default_factory=list)
    note: str = ""

    def add(self, *cells: Any) -> None:
        """One more row; as many cells as columns."""
        if len(cells) != len(self.columns):
            raise ValueError(f"table {self.title!r}: expected {len(self.columns)} cells, got {len(cells)}")
        self.rows.append(list(cells))

    def texts(self) -> list[list[str]]:
        """The cells as they are printed."""
        return [[text_of(cell, column.digits) for cell, column in zip(row, self.columns)] for row in self.rows]

    def markdown(self) -> str:
        """Heading, rows and note in Markdown, as the pages of docs/benchmarks have them."""
        lines = [[column.name for column in self.columns], ["---"] * len(self.columns), *self.texts()]
        rows = ["| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines]
        return "\n".join([f"## {self.title}", "", *rows, *(["", self.note] if self.note else []), ""])

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        rows = [{column.name: plain(cell) for column, cell in zip(self.columns, row)} for row in self.rows]
        return {"title": self.title, "rows": rows, "note": self.note}


@dataclass(frozen=True)
class Claim:
    """A demand on a measured number: `value` at least (or at most) `target`."""

    what: str
    value: float
    target: float
    at_least: bool
    digits: int = 2

    @property
    def met(self) -> bool:
        """False, too, for a value that could not be measured."""
        return self.value >= self.target if self.at_least else self.value <= self.target

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        bound = "at least" if self.at_least else "at most"
        return {"what": self.what, "value": self.value, bound: self.target, "met": self.met}


@dataclass
class Report:
    """name of the benchmark; title: what was asked; trials: in words; tables, charts, claims; version: of the code."""

    name: str
    title: str
    trials: str
    seed: int
    tables: list[Table] = field(default_factory=list)
    charts: list[Chart] = field(default_factory=list)
    claims: list[Claim] = field(default_factory=list)
    # name -> (h, w, 3) uint8, written as NAME_name.png beside the report
    pictures: dict[str, NDArray[np.uint8]] = field(default_factory=dict)
    version: str = field(default_factory=source_version)

    def to_json(self) -> dict[str, Any]:
        """Plain data, with command, code, machine and versions."""
        return {
            "benchmark": self.name,
            "title": self.title,
            "trials": self.trials,
            "seed": self.seed,
            "command": command_line(),
            "version": self.version,
            "machine": machine(),
            "tables": [table.to_json() for table in self.tables],
            "claims": [claim.to_json() for claim in self.claims],
            "charts": [chart.to_json() for chart in self.charts],
        }

    def claims_table(self) -> Table:
        """The claims as a table."""
        table = Table("Demands", [Column("demand"), Column("measured"), Column("target"), Column("")])
        for claim in self.claims:
            bound = ">=" if claim.at_least else "<="
            value, target = (text_of(x, claim.digits) for x in (claim.value, claim.target))
            table.add(claim.what, value, f"{bound} {target}", "met" if claim.met else "MISSED")
        return table


def text_of(cell: Any, digits: int = 2) -> str:
    """A cell as it is printed."""
    if cell is None:
        return "–"
    if isinstance(cell, Spread):
        return "–" if not cell.n else f"{cell.mean:.{digits}f} ± {cell.sd:.{digits}f}"
    if isinstance(cell, Quantile):
        return text_of(cell.value, digits)
    if isinstance(cell, Rate):
        return "–" if not cell.n else f"{100 * cell.share:.0f} %"
    if isinstance(cell, bool):
        return "yes" if cell else "no"
    if isinstance(cell, (float, np.floating)):
        value = float(cell)
        return "–" if math.isnan(value) else f"{value:.{digits}f}" if math.isfinite(value) else "∞"
    return str(cell)


def plain(cell: Any) -> Any:
    """A cell as JSON data."""
    if isinstance(cell, Spread):
        numbers = {"mean": cell.mean, "sd": cell.sd, "median": cell.median, "largest": cell.largest, "n": cell.n}
        return {**numbers, "interval_95": [cell.low, cell.high]}
    if isinstance(cell, Quantile):
        name = "median" if cell.share == 0.5 else f"quantile_{100 * cell.share:g}"
        return {name: cell.value, "n": cell.n, "interval_95": [cell.low, cell.high]}
    if isinstance(cell, Rate):
        return {"share": cell.share, "hits": cell.hits, "n": cell.n, "interval_95": list(cell.interval)}
    return cell.item() if isinstance(cell, np.generic) else cell


def write_report(report: Report, folder: Path) -> list[Path]:
    """NAME.json, NAME.txt, NAME.md and, when there are charts, NAME.svg in the folder; returns what was written."""
    from fusion.benchmarks.printing.charts import draw
    from fusion.truth.errors import json_number

    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"{report.name}.{kind}" for kind in ("json", "txt", "md")]
    text = json.dumps(json_number(report.to_json()), indent=1, allow_nan=False)
    paths[0].write_text(text + "\n", encoding="utf-8")
    paths[1].write_text(as_text(report), encoding="utf-8")
    paths[2].write_text(as_markdown(report), encoding="utf-8")
    if report.charts:
        paths.append(folder / f"{report.name}.svg")
        paths[-1].write_text(draw(report.charts), encoding="utf-8")
    for name, picture in report.pictures.items():
        from scenes.files.formats.images import write_rgb

        paths.append(folder / f"{report.name}_{name}.png")
        write_rgb(paths[-1], picture)
    return paths


def as_markdown(report: Report) -> str:
    """The whole report as Markdown: what ran where, then every table under its own heading."""
    tables = [*report.tables, report.claims_table()] if report.claims else report.tables
    head = [f"# {report.name}: {report.title}", "", f"`{command_line()}`", ""]
    told = f"{report.trials}; seed {report.seed}; code {report.version}; {machine_line()}"
    return "\n".join([*head, told, "", *(table.markdown() for table in tables)])


def as_text(report: Report) -> str:
    """The whole report as plain text."""
    from io import StringIO

    from rich.console import Console

    console = Console(file=StringIO(), width=240, highlight=False, soft_wrap=True)
    show_report(report, console)
    return console.file.getvalue()  # type: ignore[attr-defined]


def show_report(report: Report, console: Any, shown: Sequence[Table] = ()) -> None:
    """Print title, machine, tables and claims on a rich console; tables already `shown` are left out."""
    from rich.markup import escape

    console.print(escape(f"{report.name}: {report.title}"))
    console.print(escape(f"{report.trials}; seed {report.seed}; {machine_line()}"))
    tables = [*report.tables, report.claims_table()] if report.claims else report.tables
    for table in tables:
        if not any(table is other for other in shown):
            show_table(table, console)


def show_table(table: Table, console: Any) -> None:
    """Print one table and its note on a rich console."""
    from rich import box
    from rich.markup import escape
    from rich.table import Table as RichTable

    shown = RichTable(title=escape(table.title), box=box.SIMPLE_HEAD, title_justify="left", pad_edge=False)
    for index, column in enumerate(table.columns):
        shown.add_column(escape(column.name), justify="left" if index == 0 else "right", no_wrap=True)
    for row in table.texts():
        shown.add_row(*map(escape, row))
    console.print(shown)
    if table.note:
        console.print(escape(table.note))
