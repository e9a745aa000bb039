"""Put the tables of benchmarks into the pages: `python docs/build_benchmarks.py out/bench [FOLDER ...]`.

A page names a table and what it shows of it, and the table follows, up to its end:

    <!-- table search: By what is told; columns: families=role | sense | start; rows: sense=vision | hand=no -->
    ...
    <!-- end -->

`search` is a benchmark, whose `search.md` lies in one of the folders (`palpate bench search --out FOLDER`); the title
is the table's own or its beginning; columns are those shown, with another name before their own, all by default; rows
those in which a column is this. `search@NAME` is of the folder NAME alone. Of what is not in the folders the page keeps
what it has. Reads text, imports nothing of palpate.
"""

from __future__ import annotations

import re
import sys
from dataclasses import dataclass
from pathlib import Path

PAGES = Path(__file__).resolve().parent / "benchmarks"
MARKED = re.compile(r"<!-- table (?P<what>[^\n]*?) -->\n(?P<old>.*?)<!-- end -->", re.DOTALL)


@dataclass(frozen=True)
class Asked:
    """What a page asks for. columns: (shown as, its own name), none for all; rows: (column, its cell)."""

    benchmark: str
    folder: str
    title: str
    columns: tuple[tuple[str, str], ...]
    rows: tuple[tuple[str, str], ...]


def asked_of(text: str) -> Asked:
    """From the words of a mark. Raises ValueError for a part that is neither columns nor rows."""
    name, _, rest = text.partition(":")
    benchmark, _, folder = name.strip().partition("@")
    title, *parts = [part.strip() for part in rest.split(";")]
    columns: list[tuple[str, str]] = []
    rows: list[tuple[str, str]] = []
    for part in parts:
        kind, _, listed = part.partition(":")
        for one in re.split(r"\s*\|\s*", listed.strip()):
            left, equals, right = one.partition("=")
            if kind == "columns":
                columns.append((left, right if equals else left))
            elif kind == "rows" and equals:
                rows.append((left, right))
            else:
                raise ValueError(f"table {text!r}: expected columns: or rows: NAME=CELL, got {part!r}")
    return Asked(benchmark, folder, title, tuple(columns), tuple(rows))


def cells_of(line: str) -> list[str]:
    """The cells of a line of a table."""
    return [cell.strip() for cell in re.split(r"(?<!\\)\|", line.strip())[1:-1]]


def tables_of(text: str) -> dict[str, list[list[str]]]:
    """Every table of a report in Markdown by its title: names of columns first, then rows."""
    out = {}
    for part in re.split(r"^## ", text, flags=re.MULTILINE)[1:]:
        title, _, body = part.partition("\n")
        lines = [cells_of(line) for line in body.splitlines() if line.startswith("|")]
        out[title.strip()] = [lines[0], *lines[2:]]
    return out


def stamp_of(text: str) -> str:
    """Command, trials, seed, code and machine of a report in Markdown, without what is of that machine alone: folders,
    and versions of libraries.
    """
    command, told = [line for line in text.splitlines() if line.strip()][1:3]
    return f"{re.sub(r' --(out|json|data|bop) [^` ]+', '', command)}; {told.split('; Python')[0]}"


def shown(asked: Asked, table: list[list[str]]) -> list[str]:
    """Lines of the page. Raises ValueError for a column that the table has not, or when no row is left."""
    names = table[0]
    columns = asked.columns or tuple((name, name) for name in names)
    for name in [own for _, own in columns] + [name for name, _ in asked.rows]:
        if name not in names:
            raise ValueError(f"{asked.benchmark}, {asked.title!r}: expected a column of {names}, got {name!r}")
    kept = [row for row in table[1:] if all(row[names.index(name)] == cell for name, cell in asked.rows)]
    if not kept:
        raise ValueError(f"{asked.benchmark}, {asked.title!r}: expected rows with {asked.rows}, got none")
    lines = [[name for name, _ in columns], ["---"] * len(columns)]
    lines += [[row[names.index(own)] for _, own in columns] for row in kept]
    return ["| " + " | ".join(line) + " |" for line in lines]


def rebuilt(page: str, folders: list[Path]) -> str:
    """The page with the tables that the folders have."""

    def replace(match: re.Match[str]) -> str:
        asked = asked_of(match["what"])
        for folder in folders:
            path = folder / f"{asked.benchmark}.md"
            if (asked.folder and folder.name != asked.folder) or not path.is_file():
                continue
            text = path.read_text(encoding="utf-8")
            for title, table in tables_of(text).items():
                if title.startswith(asked.title):
                    lines = [*shown(asked, table), "", f"*{stamp_of(text)}*", ""]
                    return "\n".join([f"<!-- table {match['what']} -->", "", *lines, "<!-- end -->"])
        return match[0]

    return MARKED.sub(replace, page)


def main() -> int:
    """Every page anew. Exit code 2 without folders, for one that is none, or a mark that asks for what is not there."""
    folders = [Path(name) for name in sys.argv[1:]]
    if not folders:
        sys.stderr.write("build_benchmarks: expected folders of `palpate bench … --out FOLDER`, got none\n")
        return 2
    for folder in folders:
        if not folder.is_dir():
            sys.stderr.write(f"build_benchmarks: {folder}: expected a folder of reports, found none\n")
            return 2
    for path in sorted(PAGES.glob("*.md")):
        page = path.read_text(encoding="utf-8")
        try:
            made = rebuilt(page, folders)
        except ValueError as error:
            sys.stderr.write(f"{path.name}: {error}\n")
            return 2
        if made != page:
            path.write_text(made, encoding="utf-8")
            sys.stdout.write(f"{path.name}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
