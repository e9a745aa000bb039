"""The frames of a track that matter: its start, slips, losses and what follows them, the worst, the end."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from fusion.results.track.summary import Columns, spans

# Thumbnails on a page, and of each kind at most.
MOST = 24
MOST_OF_A_KIND = 6


def moments(columns: Columns, rows: NDArray[np.int64], pictured: Collection[int]) -> list[tuple[int, str]]:
    """(row of the columns, why), in the order of the track, each row once. rows: those that may be chosen; pictured:
    numbers of the frames that have a picture, which are chosen first where one of several will do.
    """
    if not len(rows):
        return []
    may = [int(i) for i in rows if not pictured or int(columns.frame[i]) in pictured]
    found: dict[int, list[str]] = {}

    def add(i: int, why: str) -> None:
        if i in found or len(found) < MOST:
            found.setdefault(i, []).append(why)

    add(int(rows[0]), "start" if columns.verdict[rows[0]] != "lost" else "start: lost")
    for name, i in _worst(columns, may):
        add(i, name)
    add(int(rows[-1]), "end")
    verdict, how = np.array(columns.verdict, dtype=str), np.array(columns.how, dtype=str)
    kinds = (
        ("lost", verdict == "lost"),
        ("found again", how == "re-initialised"),
        ("slips", columns.slip),
        ("carried: nothing sensed", how == "carried"),
        ("ambiguous", verdict == "ambiguous"),
        ("moves in the hand", columns.moved),
    )
    for name, flags in kinds:
        starts = spans(flags)
        # of many, the longest: a flicker is not what a person looks for
        longest = sorted(sorted(starts, key=lambda span: span[0] - span[1])[:MOST_OF_A_KIND])
        for first, last in longest:
            length = f", {last - first + 1} frames" if last > first else ""
            add(first, f"{name}{length}")
    return [(i, "; ".join(dict.fromkeys(why))) for i, why in sorted(found.items())]


def _worst(columns: Columns, may: list[int]) -> list[tuple[str, int]]:
    """The row with the largest of each measure, of those that may be chosen."""
    measures = (
        ("largest error, {:.1f} mm", columns.errors["add_s_mm"]),
        ("least sure, σ {:.1f} mm", 1e3 * columns.sigma[:, 1]),
        ("least likely right, {:.0%}", -columns.confidence),
    )
    out = []
    for name, values in measures:
        known = [i for i in may if np.isfinite(values[i])]
        if len(known) > 1:
            worst = max(known, key=lambda i: float(values[i]))
            out.append((name.format(abs(float(values[worst]))), worst))
    return out
