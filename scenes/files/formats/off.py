"""OFF files as they are found: point lists without faces, COFF and NOFF, and the many ways to break the header.

Accepted where strict readers stop: counts written as floats, counts on the header's line or joined to it, no header at
all, a missing edge count, blank lines, comments, tabs, trailing blanks, CR LF, a byte-order mark, numbers not broken
into lines. Numbers stay in the file's unit and frame. Format: Geomview's OFF(5).
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scenes.errors import MeshError
from scenes.files.whole import replace_file

Array = NDArray[np.float64]

# Letters that may stand before OFF, and how many numbers each adds to a vertex: colour (with or without alpha), normal,
# texture coordinates.
_HEADER = re.compile(r"^(ST)?(C)?(N)?(4)?(n)?OFF(?![A-Za-z])\s*", re.IGNORECASE)


@dataclass(frozen=True)
class OffData:
    """points (n, 3); faces (m, 3) triangles, m = 0 for a point list; colours (n, 3) 0..255 or None; normals (n, 3) or
    None, as in the file (not normalised).
    """

    points: Array
    faces: NDArray[np.int64]
    colours: NDArray[np.uint8] | None = None
    normals: Array | None = None


def read_off(path: str | Path) -> OffData:
    """Read an OFF, COFF, NOFF or CNOFF text file; polygons become fans of triangles.

    Raises MeshError, with the file and line, for a file that is none of these: binary or 4-dimensional OFF, counts that
    are not whole numbers, fewer rows than announced, a value that is not a finite number, a corner that does not exist.
    """
    path = Path(path)
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise MeshError(f"{path}: expected an OFF file, it cannot be opened: {error.strerror}") from error
    text = raw.removeprefix(b"\xef\xbb\xbf").decode("latin-1")
    # (line number, content) of every line that says something
    lines = [(i, line.split("#", 1)[0].strip()) for i, line in enumerate(text.splitlines(), start=1)]
    lines = [(i, line) for i, line in lines if line]
    if not lines:
        raise MeshError(f"{path}: expected an OFF file, got an empty one")
    kind, lines = _take_header(path, lines)
    counts, lines = _take_counts(path, lines)
    if len(lines) < sum(counts):
        lines = _rebroken(path, lines, counts, kind)
    points, normals, colours = _vertices(path, lines[: counts[0]], kind)
    faces = _faces(path, lines[counts[0] : sum(counts)], counts[0])
    return OffData(points, faces, colours, normals)


def write_off(
    path: str | Path,
    points: ArrayLike,
    faces: ArrayLike | None = None,
    colours: ArrayLike | None = None,
    normals: ArrayLike | None = None,
) -> None:
    """Write points (n, 3), triangles (m, 3), colours (n, 3) 0..255, normals (n, 3); numbers read back the same."""
    points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    triangles = np.zeros((0, 3), dtype=np.int64) if faces is None else np.asarray(faces, dtype=np.int64).reshape(-1, 3)
    columns: list[list[str]] = [[" ".join(map(repr, row)) for row in points.tolist()]]
    if normals is not None:
        columns.append([" ".join(map(repr, row)) for row in np.asarray(normals, dtype=np.float64).tolist()])
    if colours is not None:
        columns.append([" ".join(map(str, row)) + " 255" for row in np.asarray(colours, dtype=np.uint8).tolist()])
    if any(len(column) != len(points) for column in columns):
        raise MeshError(f"{path}: expected {len(points)} colours and normals, one a point")
    header = ("C" if colours is not None else "") + ("N" if normals is not None else "") + "OFF"
    rows = [" ".join(cells) for cells in zip(*columns, strict=True)]
    rows += [f"3 {a} {b} {c}" for a, b, c in triangles.tolist()]
    replace_file(Path(path), "\n".join([header, f"{len(points)} {len(triangles)} 0", *rows, ""]).encode("ascii"))


Lines = list[tuple[int, str]]


def _take_header(path: Path, lines: Lines) -> tuple[str, Lines]:
    """The letters before OFF ("", "C", "N", "CN") and the lines after the keyword."""
    number, first = lines[0]
    match = _HEADER.match(first)
    if match is None:
        if re.match(r"^[\d.+\s]+$", first) and len(first.split()) in (2, 3):
            return "", lines  # the keyword is optional in the format
        raise MeshError(f"{path}, line {number}: expected an OFF header, got {first[:40]!r}")
    if match.group(4) or match.group(5):
        raise MeshError(f"{path}, line {number}: expected points of 3 coordinates, got a {match.group(0).strip()} file")
    rest = first[match.end() :].strip()
    if rest.upper().startswith("BINARY"):
        raise MeshError(f"{path}, line {number}: expected a text OFF file, got a binary one")
    kind = (match.group(2) or "") + (match.group(3) or "")
    return kind.upper(), ([(number, rest)] if rest else []) + lines[1:]


def _take_counts(path: Path, lines: Lines) -> tuple[tuple[int, int], Lines]:
    if not lines:
        raise MeshError(f"{path}: expected the counts of points and faces after the header, got the end of the file")
    number, line = lines[0]
    words = line.split()
    values = [_whole(word) for word in words[:2]]
    if len(values) < 2 or None in values:
        raise MeshError(f"{path}, line {number}: expected the counts of points and faces, got {line[:40]!r}")
    rest = words[3:]
    return (values[0] or 0, values[1] or 0), ([(number, " ".join(rest))] if rest else []) + lines[1:]


def _whole(word: str) -> int | None:
    try:
        value = float(word)
    except ValueError:
        return None
    return int(value) if value >= 0 and value == int(min(value, 2**53)) else None


def _rebroken(path: Path, lines: Lines, counts: tuple[int, int], kind: str) -> Lines:
    """One vertex or face a line again, of a file whose numbers run on; the header tells the width of its vertices."""
    last = lines[-1][0] if lines else 1
    words = [word for _, line in lines for word in line.split()]
    width = 3 + 3 * ("N" in kind) + 4 * ("C" in kind)
    missing = MeshError(
        f"{path}, line {last}: expected {counts[0]} points and {counts[1]} faces, the file ends after {len(lines)} rows"
    )
    # rows of the expected length that are simply too few are a truncated file, not one that runs on
    if all(len(line.split()) <= width for _, line in lines[: counts[0]]) or len(words) < width * counts[0]:
        raise missing
    out = [(last, " ".join(words[i * width : (i + 1) * width])) for i in range(counts[0])]
    at = width * counts[0]
    for _ in range(counts[1]):
        size = _whole(words[at]) if at < len(words) else None
        if size is None or at + size >= len(words):
            raise missing
        out.append((last, " ".join(words[at : at + size + 1])))
        at += size + 1
    return out


def _vertices(path: Path, lines: Lines, kind: str) -> tuple[Array, Array | None, NDArray[np.uint8] | None]:
    rows = [line.split() for _, line in lines]
    least = 6 if "N" in kind else 3
    widths = {len(row) for row in rows}
    if any(width < least for width in widths):
        number, row = next((n, r) for (n, _), r in zip(lines, rows) if len(r) < least)
        raise MeshError(f"{path}, line {number}: expected {least} numbers of a point, got {len(row)}")
    values = _numbers(path, lines, [row[:least] for row in rows], least)
    points, normals = values[:, :3], values[:, 3:6] if least == 6 else None
    # a plain OFF whose points carry three or four more numbers has colours, whatever its header says
    if not rows or min(widths) < least + 3:
        return points, normals, None
    if "C" not in kind and widths - {least + 3, least + 4}:
        return points, normals, None
    words = [row[least : least + 3] for row in rows]
    shades = _numbers(path, lines, words, 3)
    if any("." in word for row in words for word in row) and shades.max() <= 1.0:
        shades = shades * 255.0
    return points, normals, np.clip(np.rint(shades), 0, 255).astype(np.uint8)


def _numbers(path: Path, lines: Lines, rows: list[list[str]], width: int) -> Array:
    try:
        values = np.array(rows, dtype=np.float64).reshape(-1, width)
    except ValueError:
        values = np.full((len(rows), width), np.nan)
    if np.isfinite(values).all():
        return values
    for (number, line), row in zip(lines, rows):
        if any(not _is_finite(word) for word in row):
            raise MeshError(f"{path}, line {number}: expected finite numbers, got {line[:60]!r}")
    raise MeshError(f"{path}: expected finite numbers")


def _is_finite(word: str) -> bool:
    try:
        return math.isfinite(float(word))
    except ValueError:
        return False


def _faces(path: Path, lines: Lines, points: int) -> NDArray[np.int64]:
    triangles: list[list[int]] = []
    for number, line in lines:
        words = line.split()
        size = _whole(words[0])
        if size is None or size < 1 or len(words) < size + 1:
            raise MeshError(f"{path}, line {number}: expected a face (its size, then its corners), got {line[:60]!r}")
        corners = [_whole(word) for word in words[1 : size + 1]]
        for corner in corners:
            if corner is None or corner >= points:
                raise MeshError(f"{path}, line {number}: expected corners from 0 to {points - 1}, got {line[:60]!r}")
        known = [corner for corner in corners if corner is not None]
        # one or two corners are a dot or an edge: legal, and nothing for a surface
        triangles += [[known[0], known[i], known[i + 1]] for i in range(1, size - 1)]
    return np.array(triangles, dtype=np.int64).reshape(-1, 3)
