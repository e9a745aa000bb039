"""A CSV whose rows belong to frames: checked whole once, its rows read again when their frame is asked for.

A recording of an hour has millions of joint positions and contacts, of which a reader wants one frame's at a time: what
is kept is where in the file each frame's rows are.
"""

from __future__ import annotations

import csv
from array import array
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from scenes.files.formats.tables import CsvColumn, CsvRow, CsvTable, as_table, csv_header, csv_rows
from scenes.files.problems import Problem, Report

Index = NDArray[np.int64]


class FramedTable:
    """Rows of a CSV with a frame column, found by their frame. Attributes: file, its path as text."""

    def __init__(self, path: str | Path, columns: Sequence[CsvColumn], report: Report) -> None:
        """Read all of it once; problems are reported as `scenes.files.formats.tables.read_table` does."""
        self.file = str(path)
        self._columns = columns
        self._header: list[str] = []
        # Of each run of rows of one frame: the frame, the lines before it, its first byte and the byte after it.
        self._frames, self._before, self._first, self._after = (np.zeros(0, dtype=np.int64) for _ in range(4))
        try:
            with Path(path).open("rb") as file:
                self._index(file, report)
        except UnicodeDecodeError:
            report(Problem(self.file, None, "expected UTF-8 text, got other bytes"))
        except OSError as error:
            report(Problem(self.file, None, f"cannot be read: {error.strerror}"))

    def _index(self, file: IO[bytes], report: Report) -> None:
        source = _Lines(file)
        reader = csv.reader(source)
        try:
            header = csv_header(self.file, reader, self._columns, report)
            if header is None:
                return
            runs = _Runs(source)
            for row in csv_rows(self.file, runs.watched(reader), header, self._columns, report):
                runs.add(int(row.numbers["frame"]))
        except csv.Error as error:
            report(Problem(self.file, None, f"line {reader.line_num}: {error}"))
            return
        self._header = header
        self._frames, self._before, self._first, self._after = runs.sorted()

    def frames(self) -> Index:
        """The frame of each run of rows, in order; a frame may have several."""
        return self._frames

    def of_frame(self, frame: int) -> CsvTable:
        """The rows of one frame, in the file's order."""
        low, high = np.searchsorted(self._frames, [frame, frame + 1])
        if low == high:
            return CsvTable(self.file)
        rows: list[CsvRow] = []
        with Path(self.file).open("rb") as file:
            for run in range(low, high):
                file.seek(self._first[run])
                part = file.read(self._after[run] - self._first[run])
                again = csv.reader(line.decode() for line in part.splitlines(keepends=True))
                # what is wrong with a row was reported when the file was opened
                rows += csv_rows(
                    self.file, again, self._header, self._columns, lambda problem: None, int(self._before[run])
                )
        return as_table(self.file, rows, self._columns)


class _Lines:
    """The lines of a file as text; `at` is the byte after the last one given."""

    def __init__(self, file: IO[bytes]) -> None:
        self.at = 0
        self._pieces = (piece for line in file for piece in line.splitlines(keepends=True))

    def __iter__(self) -> Iterator[str]:
        return self

    def __next__(self) -> str:
        piece = next(self._pieces)
        text = piece.decode("utf-8" if self.at else "utf-8-sig")
        self.at += len(piece)
        return text


class _Runs:
    """Rows that follow one another and are of one frame."""

    def __init__(self, source: _Lines) -> None:
        self._source = source
        self._row = (0, 0)
        self._columns = tuple(array("q") for _ in range(4))

    def watched(self, reader: Any) -> _Watched:
        """The reader, of whose rows it is kept where they begin."""
        return _Watched(reader, self)

    def begins(self, line: int) -> None:
        """A row begins here, after so many lines."""
        self._row = line, self._source.at

    def add(self, frame: int) -> None:
        """The row that has just been read is of this frame."""
        frames, before, first, after = self._columns
        if frames and frames[-1] == frame:
            after[-1] = self._source.at
            return
        frames.append(frame)
        before.append(self._row[0])
        first.append(self._row[1])
        after.append(self._source.at)

    def sorted(self) -> tuple[Index, Index, Index, Index]:
        """frame, lines before, first byte, byte after of each run, by frame and then by place."""
        frames, before, first, after = (np.array(column, dtype=np.int64) for column in self._columns)
        order = np.argsort(frames, kind="stable")
        return frames[order], before[order], first[order], after[order]


class _Watched:
    """A csv.reader that says where each row begins."""

    def __init__(self, reader: Any, runs: _Runs) -> None:
        self._reader, self._runs = reader, runs

    @property
    def line_num(self) -> int:
        """As a csv.reader's."""
        return self._reader.line_num

    def __iter__(self) -> Iterator[list[str]]:
        return self

    def __next__(self) -> list[str]:
        self._runs.begins(self._reader.line_num)
        return next(self._reader)
