"""The CSV files of a capture: their columns, read with every problem named by file and line. SI units.

An optional cell may be empty (or `nan`): it reads as NaN, "unknown". A required cell must hold a finite number.
"""

from __future__ import annotations

import csv
import re
from array import array
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenes.files.problems import Problem, Report
from scenes.files.whole import named

Array = NDArray[np.float64]

# What a spreadsheet runs when a cell begins with it (apostrophes before it are part of the name).
_FORMULA = re.compile(r"'*[=+\-@\t\r]")
# Numbers are read as float64: above this a whole number is no longer itself.
LARGEST_INDEX = 2**53


@dataclass(frozen=True)
class CsvColumn:
    """One column: its header, what its cells hold ("index", "number" or "text"), and whether they may be empty."""

    name: str
    kind: str = "number"
    optional: bool = False


def _numbers(*names: str, optional: bool = False) -> tuple[CsvColumn, ...]:
    return tuple(CsvColumn(name, "number", optional) for name in names)


FRAME = CsvColumn("frame", "index")
SENSOR = CsvColumn("sensor", "text")
POSE_NAMES = tuple(f"m{row}{column}" for row in range(4) for column in range(4))

JOINTS = (FRAME, CsvColumn("joint", "text"), CsvColumn("position"))
HAND_POSES = (FRAME, *_numbers(*POSE_NAMES))
CONTACTS = (
    FRAME,
    SENSOR,
    *_numbers("x", "y", "z"),
    *_numbers("nx", "ny", "nz", "fx", "fy", "fz", "sigma_point", "sigma_normal", optional=True),
)
# A list of contacts by itself: one frame, sensors that need no name.
LOOSE_CONTACTS = (CsvColumn("frame", "index", optional=True), CsvColumn("sensor", "text", optional=True), *CONTACTS[2:])
NO_CONTACT = (FRAME, SENSOR, *_numbers("x", "y", "z", "radius"))
WRENCHES = (FRAME, SENSOR, *_numbers("fx", "fy", "fz", "mx", "my", "mz"))
NO_FACES: NDArray[np.int64] = np.zeros((0, 3), dtype=np.int64)
TACTILE = (CsvColumn("taxel", "index"), CsvColumn("pressure"))


@dataclass(frozen=True)
class CsvTable:
    """Rows of a CSV: numbers (and indices) and texts by column name, each n long; `lines`, where each row was."""

    file: str
    numbers: dict[str, Array] = field(default_factory=dict)
    texts: dict[str, list[str]] = field(default_factory=dict)
    lines: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))

    def __len__(self) -> int:
        return len(self.lines)

    def stack(self, *names: str) -> Array:
        """(n, k) of the named number columns."""
        return np.stack([self.numbers[name] for name in names], axis=1) if len(self) else np.zeros((0, len(names)))

    def frames(self) -> NDArray[np.int64]:
        """(n,) the frame of each row, 0 where it is not said; empty for a table without that column."""
        return (
            np.nan_to_num(self.numbers["frame"]).astype(np.int64) if "frame" in self.numbers else np.zeros(0, np.int64)
        )

    def of_frame(self, frame: int) -> CsvTable:
        """The rows of one frame, in the file's order."""
        rows = np.flatnonzero(self.frames() == frame)
        return CsvTable(
            self.file,
            {name: values[rows] for name, values in self.numbers.items()},
            {name: [values[i] for i in rows] for name, values in self.texts.items()},
            self.lines[rows],
        )


def read_table(path: str | Path, columns: Sequence[CsvColumn], report: Report) -> CsvTable:
    """Read the known columns of a CSV with a header (others are ignored).

    Reports an unreadable file, a missing column, a row of the wrong length, a cell that is not what its column holds;
    rows with a problem are left out of the table when `report` returns.
    """
    file = str(path)
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        report(Problem(file, None, "expected UTF-8 text, got other bytes"))
        return CsvTable(file)
    except OSError as error:
        report(Problem(file, None, f"cannot be read: {error.strerror}"))
        return CsvTable(file)
    rows = csv.reader(text.splitlines())
    try:
        header = csv_header(file, rows, columns, report)
        return (
            CsvTable(file) if header is None else as_table(file, csv_rows(file, rows, header, columns, report), columns)
        )
    except csv.Error as error:
        report(Problem(file, None, f"line {rows.line_num}: {error}"))
        return CsvTable(file)


def csv_header(file: str, rows: Any, columns: Sequence[CsvColumn], report: Report) -> list[str] | None:
    """The header of a csv.reader that has given nothing; None after a report when it lacks a needed column."""
    header = [name.strip() for name in next(rows, [])]
    if not header:
        needed = ",".join(c.name for c in columns if not c.optional)
        report(Problem(file, None, f"expected the header {needed}, got an empty file"))
        return None
    missing = [c.name for c in columns if not c.optional and c.name not in header]
    if missing:
        got = ",".join(header)[:80]
        report(Problem(file, None, f"expected the column{'s'[: len(missing) > 1]} {', '.join(missing)}, got {got}"))
        return None
    for column in columns:
        if header.count(column.name) > 1:
            report(
                Problem(file, None, f"expected each column once, got {column.name} {header.count(column.name)} times")
            )
    return header


@dataclass(frozen=True)
class CsvRow:
    """One row without a problem: the line where it ends, its numbers and texts by column name."""

    line: int
    numbers: dict[str, float]
    texts: dict[str, str]


def csv_rows(
    file: str, rows: Any, header: list[str], columns: Sequence[CsvColumn], report: Report, before: int = 0
) -> Iterator[CsvRow]:
    """The rows of a csv.reader that has given its header, problems reported; before: lines of the file before its."""
    at = {c.name: header.index(c.name) for c in columns if c.name in header}
    for row in rows:
        line = before + rows.line_num
        if not any(cell.strip() for cell in row):
            continue
        if len(row) != len(header):
            report(Problem(file, None, f"line {line}: expected {len(header)} cells, got {len(row)}"))
            continue
        values = {c.name: row[at[c.name]].strip() if c.name in at else "" for c in columns}
        frame = int(values["frame"]) if values.get("frame", "").isdecimal() else None
        parsed: dict[str, float] = {}
        wrong = []
        for column in columns:
            if column.kind == "text":
                if not values[column.name] and not column.optional:
                    wrong.append(f"column {column.name}: expected a name, got nothing")
                continue
            number, complaint = _number(values[column.name], column)
            parsed[column.name] = number
            if complaint:
                wrong.append(f"column {column.name}: {complaint}")
        for complaint in wrong:
            report(Problem(file, frame, f"line {line}, {complaint}"))
        if wrong:
            continue
        yield CsvRow(line, parsed, {c.name: _as_meant(values[c.name]) for c in columns if c.kind == "text"})


def as_table(file: str, rows: Iterable[CsvRow], columns: Sequence[CsvColumn]) -> CsvTable:
    """The rows side by side."""
    numbers = {c.name: array("d") for c in columns if c.kind != "text"}
    texts: dict[str, list[str]] = {c.name: [] for c in columns if c.kind == "text"}
    lines = array("q")
    for row in rows:
        for name, value in row.numbers.items():
            numbers[name].append(value)
        for name, text in row.texts.items():
            texts[name].append(text)
        lines.append(row.line)
    columns_of = {name: np.array(values, dtype=np.float64) for name, values in numbers.items()}
    return CsvTable(file, columns_of, texts, np.array(lines, dtype=np.int64))


def _number(text: str, column: CsvColumn) -> tuple[float, str]:
    """The value, and what is wrong with it ("" when nothing)."""
    if column.optional and (not text or text.lower() == "nan"):
        return float("nan"), ""
    try:
        value = float(text)
    except ValueError:
        return float("nan"), f"expected a number, got {text[:40]!r}" if text else "expected a number, got nothing"
    if not np.isfinite(value):
        return value, f"expected a finite number, got {text}"
    if column.kind == "index" and not (0 <= value <= LARGEST_INDEX and value == int(value)):
        return value, f"expected a whole number from 0 to {LARGEST_INDEX}, got {text[:40]}"
    return value, ""


def write_table(path: str | Path, columns: Sequence[CsvColumn], rows: Iterable[Sequence[object]]) -> None:
    """Write rows in the columns' order; floats so that they read back the same, NaN as an empty cell."""
    with named(Path(path)), Path(path).open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([column.name for column in columns])
        for row in rows:
            writer.writerow([_cell(value) for value in row])


def _cell(value: object) -> str:
    if isinstance(value, float | np.floating):
        return "" if np.isnan(value) else repr(float(value))
    return harmless(str(value))


def harmless(name: str) -> str:
    """A name as a cell that no spreadsheet takes for a formula: an apostrophe goes before =, +, - and @."""
    return f"'{name}" if _FORMULA.match(name) else name


def _as_meant(cell: str) -> str:
    """The name of a cell that `harmless` wrote."""
    return cell[1:] if cell.startswith("'") and _FORMULA.match(cell) else cell
