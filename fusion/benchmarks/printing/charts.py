"""Curves of a benchmark as plain SVG: axes, grid, one colour a series; logarithmic axes when asked."""

from __future__ import annotations

import html
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise, zip_longest
from typing import Any

COLOURS = (
    *("#2c9c5a", "#3b7dd8", "#e08a2e", "#b0413e", "#7a5ea8", "#5f6b7a", "#c2a83e", "#3aa6a6", "#d06aa0"),
    *("#8c6d46", "#6fae2f", "#1f4e79"),
)
# Pixels of one chart, and of its margins.
WIDTH, HEIGHT, LEFT, RIGHT, TOP, BOTTOM = 750, 340, 70, 220, 34, 46
STYLE = (
    "text{font:12px system-ui,sans-serif;fill:currentColor}.h{font-weight:600}.g{stroke:currentColor;opacity:.15}"
    ".d{stroke:currentColor;stroke-dasharray:2 3;opacity:.6;fill:none}.b{stroke:currentColor;stroke-dasharray:7 4}"
)


@dataclass(frozen=True)
class Chart:
    """series: name -> points (x, y); those that are not finite (or not positive on a logarithmic axis) are left out.
    front: points that a dashed staircase joins; level: y of a dashed line, the Cramér-Rao bound.
    """

    title: str
    x: str
    y: str
    series: Mapping[str, Sequence[tuple[float, float]]]
    log_x: bool = False
    log_y: bool = False
    front: Sequence[tuple[float, float]] = ()
    level: float | None = None

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        series = {name: [list(point) for point in points] for name, points in self.series.items()}
        named: dict[str, Any] = {"title": self.title, "x": self.x, "y": self.y, "series": series}
        if self.front:
            named["front"] = [list(point) for point in self.front]
        return named if self.level is None else {**named, "cramer_rao": self.level}


@dataclass(frozen=True)
class _Axis:
    low: float
    high: float
    log: bool
    start: float
    end: float

    @staticmethod
    def over(values: Sequence[float], log: bool, start: float, end: float) -> _Axis:
        if not values:
            return _Axis(1.0 if log else 0.0, 10.0 if log else 1.0, log, start, end)
        low, high = min(values), max(values)
        if log:
            low, high = 10.0 ** math.floor(math.log10(low)), 10.0 ** math.ceil(math.log10(high))
            return _Axis(low, high if high > low else 10 * low, log, start, end)
        low, high = min(low, 0.0), max(high, 0.0)
        step = _step(high - low)
        low, high = step * math.floor(low / step), step * math.ceil(high / step)
        return _Axis(low, high if high > low else low + 1.0, log, start, end)

    def at(self, value: float) -> float:
        if self.log:
            share = math.log(value / self.low) / math.log(self.high / self.low)
        else:
            share = (value - self.low) / (self.high - self.low)
        return self.start + share * (self.end - self.start)

    def ticks(self) -> list[float]:
        if self.log:
            first, last = round(math.log10(self.low)), round(math.log10(self.high))
            return [10.0**power for power in range(first, last + 1)]
        step = _step(self.high - self.low)
        return [self.low + step * i for i in range(round((self.high - self.low) / step) + 1)]


def _step(span: float) -> float:
    """A round step that cuts the span into five or so."""
    if span <= 0:
        return 1.0
    power = 10.0 ** math.floor(math.log10(span / 5))
    return next(power * factor for factor in (1, 2, 5, 10) if power * factor >= span / 5 * 0.999)


def draw(charts: Sequence[Chart]) -> str:
    """All charts below one another, as SVG text."""
    parts = [f'<g transform="translate(0 {HEIGHT * i})">{_chart(chart)}</g>' for i, chart in enumerate(charts)]
    height = HEIGHT * len(charts)
    box = f'viewBox="0 0 {WIDTH} {height}" width="{WIDTH}" height="{height}"'
    return f'<svg xmlns="http://www.w3.org/2000/svg" {box} role="img">\n<style>{STYLE}</style>\n' + "\n".join(
        [*parts, "</svg>\n"]
    )


def _chart(chart: Chart) -> str:
    kept = {name: [p for p in points if _shown(p, chart)] for name, points in chart.series.items()}
    every = [p for points in kept.values() for p in points]
    x = _Axis.over([p[0] for p in every], chart.log_x, LEFT, WIDTH - RIGHT)
    level = [] if chart.level is None or not _shown((1.0, chart.level), chart) else [chart.level]
    y = _Axis.over([p[1] for p in every] + level, chart.log_y, HEIGHT - BOTTOM, TOP)
    parts = [f'<text class="h" x="{LEFT}" y="18">{html.escape(chart.title)}</text>']
    for tick in x.ticks():
        at = x.at(tick)
        parts.append(f'<line class="g" x1="{at:.1f}" x2="{at:.1f}" y1="{TOP}" y2="{HEIGHT - BOTTOM}"/>')
        parts.append(f'<text x="{at:.1f}" y="{HEIGHT - BOTTOM + 16}" text-anchor="middle">{tick:g}</text>')
    for tick in y.ticks():
        at = y.at(tick)
        parts.append(f'<line class="g" x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{at:.1f}" y2="{at:.1f}"/>')
        parts.append(f'<text x="{LEFT - 6}" y="{at + 4:.1f}" text-anchor="end">{tick:.4g}</text>')
    steps = [(b[0], a[1]) for a, b in pairwise([p for p in chart.front if _shown(p, chart)])]
    corners = [c for p, s in zip_longest([p for p in chart.front if _shown(p, chart)], steps) for c in (p, s) if c]
    if corners:
        line = " ".join(f"{x.at(a):.1f},{y.at(b):.1f}" for a, b in corners)
        parts.append(f'<polyline class="d" points="{line}"/>')
    legend = TOP + 8 + 18 * len(kept)
    for value in level:
        place = f'y1="{y.at(value):.1f}" y2="{y.at(value):.1f}"'
        parts.append(f'<line class="b" x1="{LEFT}" x2="{WIDTH - RIGHT}" {place}/>')
        parts.append(
            f'<line class="b" x1="{WIDTH - RIGHT + 14}" x2="{WIDTH - RIGHT + 26}" y1="{legend}" y2="{legend}"/>'
        )
        parts.append(f'<text x="{WIDTH - RIGHT + 32}" y="{legend + 4}">Cramér-Rao bound</text>')
    for i, (name, points) in enumerate(kept.items()):
        colour = COLOURS[i % len(COLOURS)]
        places = [(x.at(a), y.at(b)) for a, b in points]
        line = " ".join(f"{a:.1f},{b:.1f}" for a, b in places)
        parts.append(f'<polyline points="{line}" fill="none" stroke="{colour}" stroke-width="2"/>')
        parts += [f'<circle cx="{a:.1f}" cy="{b:.1f}" r="3" fill="{colour}"/>' for a, b in places]
        row = TOP + 8 + 18 * i
        parts.append(f'<rect x="{WIDTH - RIGHT + 14}" y="{row - 8}" width="12" height="10" fill="{colour}"/>')
        parts.append(f'<text x="{WIDTH - RIGHT + 32}" y="{row + 1}">{html.escape(name)}</text>')
    middle = (LEFT + WIDTH - RIGHT) / 2
    parts.append(f'<text x="{middle}" y="{HEIGHT - 10}" text-anchor="middle">{html.escape(chart.x)}</text>')
    turned = f'transform="translate(14 {(TOP + HEIGHT - BOTTOM) / 2}) rotate(-90)" text-anchor="middle"'
    parts.append(f"<text {turned}>{html.escape(chart.y)}</text>")
    return "\n".join(parts)


def _shown(point: tuple[float, float], chart: Chart) -> bool:
    x, y = point
    return math.isfinite(x) and math.isfinite(y) and (x > 0 or not chart.log_x) and (y > 0 or not chart.log_y)
