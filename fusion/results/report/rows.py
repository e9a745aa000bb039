"""Rows of the report's tables, out of what a comparison and an evaluation say."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

METHOD_NAMES = {
    "icp": "ICP, usual crop",
    "icp_segmented": "ICP, segmented",
    "icp_touch": "ICP, with contacts",
    "vision": "Vision",
    "touch": "Touch",
    "fused": "Fused",
}


def comparison_rows(comparison: Mapping[str, Any] | Sequence[Mapping[str, Any]] | None) -> list[dict[str, Any]]:
    """Rows {frame, method, name, adds_mm, rotation_deg, translation_mm, ms, verdict} of a comparison.

    comparison: {"rows": [...]} or the list itself, one row a frame and method (or one a method, without frame). Keys
    are read by their usual names: method, frame, add_s_mm, rotation_deg, translation_mm, time_ms or ms, verdict;
    without ground truth cloud_mm and contacts_mm, mean distances to the surface, take the place of the errors.
    """
    if not comparison:
        return []
    rows = comparison.get("rows", comparison.get("methods", [])) if isinstance(comparison, Mapping) else comparison
    if isinstance(rows, Mapping):
        rows = [{"method": name, **row} for name, row in rows.items()]
    out = []
    for row in rows:
        method = str(row.get("method", "?"))
        out.append(
            {
                "frame": row.get("frame"),
                "method": method,
                "name": METHOD_NAMES.get(method, method),
                "adds_mm": _first(row, "add_s_mm", "adds_mm", "adds"),
                "rotation_deg": _first(row, "rotation_deg", "rot_deg"),
                "translation_mm": _first(row, "translation_mm", "trans_mm"),
                "cloud_mm": _first(row, "cloud_mm"),
                "contacts_mm": _first(row, "contacts_mm"),
                "ms": _first(row, "time_ms", "ms"),
                "verdict": str(row.get("verdict") or ""),
            }
        )
    return out


def summary_rows(errors: Mapping[str, Any] | None) -> list[list[str]]:
    """[name, value] pairs of every plain number or text in `errors` (or its "summary"), names made readable."""
    errors = errors or {}
    inner = errors.get("summary")
    out = []
    for key, value in (inner if isinstance(inner, Mapping) else errors).items():
        if isinstance(value, bool) or not isinstance(value, (int, float, str, np.floating, np.integer)):
            continue
        text = value if isinstance(value, str) else f"{float(value):.4g}"
        unit = next((u for u in ("_mm", "_deg", "_ms", "_px") if str(key).endswith(u)), "")
        name = str(key).removesuffix(unit).replace("_", " ")
        out.append([name, f"{text} {unit[1:].replace('deg', '°')}".strip()])
    return out


def rounded(value: float, digits: int) -> float | None:
    """A number as JSON has it: None when it is not finite."""
    return round(float(value), digits) if np.isfinite(value) else None


def _first(row: Mapping[str, Any], *names: str) -> float | None:
    return next((rounded(row[name], 4) for name in _present(row, names)), None)


def _present(row: Mapping[str, Any], names: Iterable[str]) -> Iterable[str]:
    return (name for name in names if row.get(name) is not None)
