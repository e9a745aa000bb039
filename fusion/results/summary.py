"""The numbers of a whole batch: counts of captures, frames and verdicts, and medians over the frames."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from typing import Any

from fusion.results.batch import Outcome

NUMBERS = ("confidence", "add_s_mm", "rotation_deg", "translation_mm", "time_ms")


def summary_of(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Counts of captures, frames and verdicts, and medians over the frames; None where nothing is known."""
    rows = [row for outcome in outcomes for row in outcome.answers]
    known = [row["add_s_mm"] for row in rows if row["add_s_mm"] is not None]
    return {
        "captures": len(outcomes),
        "kept": sum(outcome.status == "kept" for outcome in outcomes),
        "failed": sum(outcome.status == "error" for outcome in outcomes),
        "frames": len(rows),
        "left_out": sum(len(outcome.left_out) for outcome in outcomes),
        "verdicts": {word: sum(row["verdict"] == word for row in rows) for word in ("ok", "ambiguous", "lost")},
        **{f"median_{name}": median([row[name] for row in rows]) for name in NUMBERS},
        "success_add_s_below_5mm": sum(value < 5.0 for value in known) / len(known) if known else None,
    }


def median(values: Sequence[float | None]) -> float | None:
    """Of those that are known; None for none."""
    known = [value for value in values if value is not None]
    return float(statistics.median(known)) if known else None
