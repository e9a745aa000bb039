"""A comparison as a picture: every frame's ADD-S by method on a logarithmic scale, medians marked; plain SVG."""

from __future__ import annotations

import html
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fusion.truth.compare import Row
from scenes.errors import InputError
from scenes.files.whole import replace_file

COLOURS = {
    "icp": "#9a9a9a",
    "icp_segmented": "#5f6b7a",
    "icp_touch": "#7a5ea8",
    "vision": "#3b7dd8",
    "touch": "#e08a2e",
    "fused": "#2c9c5a",
}
SUFFIXES = (".html", ".svg")

# Pixels: height of a strip, of the gap between groups, and the drawing's left, right and top margins.
STRIP, GAP, LEFT, RIGHT, TOP, WIDTH = 26, 34, 130, 90, 30, 900
STYLE = (
    "text{font:13px system-ui,sans-serif;fill:currentColor}.g{font-weight:600}"
    ".t{stroke:currentColor;opacity:.15}.s{stroke:#c33;stroke-dasharray:4 3;opacity:.7}"
)


def check_suffix(path: Path) -> None:
    """Raise InputError for a file that `write_plot` cannot write."""
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"plot: expected a file ending in {' or '.join(SUFFIXES)}, got {path.name}")


def write_plot(path: Path, rows: Sequence[Row], success: float = 0.005) -> None:
    """Draw the rows as .svg or .html; without ground truth, the cloud's mean distance to the surface instead of ADD-S.

    success: threshold line, m.
    """
    check_suffix(path)
    picture = draw(rows, success)
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix.lower() == ".html":
        head = "<!doctype html><meta charset=utf-8><meta name=viewport content='width=device-width'>"
        page = ":root{color-scheme:light dark}body{margin:2rem auto;max-width:920px}svg{width:100%;height:auto}"
        picture = f"{head}<title>palpate compare</title><style>{page}</style>{picture}\n"
    replace_file(path, picture.encode())


def draw(rows: Sequence[Row], success: float = 0.005) -> str:
    """The SVG as text."""
    with_truth = any(row.errors is not None for row in rows)
    label = "ADD-S, mm" if with_truth else "mean distance of the cloud's inliers to the surface, mm"
    values = [
        1e3 * (row.errors.add_s if row.errors else math.nan) if with_truth else 1e3 * row.agreement.cloud
        for row in rows
    ]
    known = [value for value in values if math.isfinite(value) and value > 0]
    low = 10.0 ** math.floor(math.log10(max(min(known, default=0.1), 1e-2)))
    high = 10.0 ** math.ceil(math.log10(max(max(known, default=10.0), 10.0 * low)))

    def x(value: float) -> float:
        share = math.log(min(max(value, low), high) / low) / math.log(high / low)
        return LEFT + share * (WIDTH - LEFT - RIGHT)

    groups = list(dict.fromkeys(row.group for row, value in zip(rows, values) if math.isfinite(value)))
    parts: list[str] = []
    y = float(TOP)
    for group in groups:
        parts.append(f'<text class="g" x="8" y="{y + 4:.0f}">{html.escape(group)}</text>')
        y += 14
        for method in dict.fromkeys(row.method for row in rows if row.group == group):
            mine = [
                v for v, row in zip(values, rows) if row.group == group and row.method == method and math.isfinite(v)
            ]
            parts += _strip(method, mine, y, x)
            y += STRIP
        y += GAP
    bottom = y - GAP + 8
    return _frame(parts, low, high, x, bottom, label, 1e3 * success if with_truth else None)


def _strip(method: str, values: list[float], y: float, x) -> list[str]:  # type: ignore[no-untyped-def]
    colour = COLOURS.get(method, "#888")
    middle = y + STRIP / 2
    parts = [f'<text x="24" y="{middle + 4:.1f}">{html.escape(method)}</text>']
    # a golden-ratio jitter spreads equal values without chance
    for i, value in enumerate(values):
        at = middle + (STRIP - 10) * ((i * 0.618034) % 1.0 - 0.5)
        parts.append(f'<circle cx="{x(value):.1f}" cy="{at:.1f}" r="2.6" fill="{colour}" fill-opacity=".55"/>')
    if values:
        median = float(np.median(values))
        line = f'x1="{x(median):.1f}" x2="{x(median):.1f}" y1="{y + 2:.1f}" y2="{y + STRIP - 2:.1f}"'
        parts.append(f'<line {line} stroke="{colour}" stroke-width="3"/>')
        parts.append(f'<text x="{WIDTH - RIGHT + 10}" y="{middle + 4:.1f}">{median:.2f} mm</text>')
    return parts


def _frame(parts: list[str], low: float, high: float, x, bottom: float, label: str, success: float | None) -> str:  # type: ignore[no-untyped-def]
    grid = []
    for power in range(round(math.log10(low)), round(math.log10(high)) + 1):
        at = x(10.0**power)
        grid.append(f'<line class="t" x1="{at:.1f}" x2="{at:.1f}" y1="{TOP}" y2="{bottom:.0f}"/>')
        grid.append(f'<text x="{at:.1f}" y="{bottom + 16:.0f}" text-anchor="middle">{10.0**power:g}</text>')
    if success is not None and low < success < high:
        grid.append(f'<line class="s" x1="{x(success):.1f}" x2="{x(success):.1f}" y1="{TOP}" y2="{bottom:.0f}"/>')
    caption = f'<text x="{LEFT}" y="{bottom + 36:.0f}">{html.escape(label)}; bars are medians</text>'
    box = f'viewBox="0 0 {WIDTH} {bottom + 46:.0f}" width="{WIDTH}" height="{bottom + 46:.0f}"'
    body = "\n".join([f"<style>{STYLE}</style>", *grid, *parts, caption])
    return f'<svg xmlns="http://www.w3.org/2000/svg" {box} role="img">\n{body}\n</svg>'
