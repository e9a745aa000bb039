"""Cameras imitated from their optics: what they read of walls and of edges, and what a frame costs."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

from fusion.benchmarks.printing.tables import BenchSettings, Claim, Column, Report, Spread, Table
from scenes.geometry.appearance.rendering import Renderer
from scenes.geometry.cameras import Camera
from scenes.synthesis.optics import KNOWN_CAMERAS, Material, OpticalCamera, TimeOfFlightCamera, draw_unit, take

Array = NDArray[np.float64]

VGA = Camera(570.0, 570.0, 319.5, 239.5, 640, 480)
DEPTHS = (0.5, 0.8, 1.2)  # m
# A plate before a wall (m): its depth, the wall's, half its width and height.
NEAR, FAR, HALF = 0.6, 1.0, 0.06
# Both are matt: gloss that faces the camera blinds it.
PAINT = Material(albedo=0.5, texture=0.1, grain=0.006)
# Cameras drawn of a kind, and in a hurry.
UNITS = (4, 2)
# Demand on a frame (s).
LONGEST = 3.0
CORNERS = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
FACES = ((0, 1, 2), (0, 2, 3))


def optical_cameras(report: Report, settings: BenchSettings) -> None:
    """The tables of this file."""
    walls = Table(
        "Cameras imitated from their optics before a facing wall",
        [
            Column("camera"),
            Column("depth m"),
            Column("read %", 1),
            Column("noise mm"),
            Column("bias mm"),
            Column("processor s a frame"),
        ],
        note="Over cameras of a kind, walls and rooms. Bias: a quadric through the errors; noise: what it leaves. Read:"
        " of what the second eye or projector reaches.",
    )
    edges = Table(
        f"A plate {NEAR} m away before a wall at {FAR:.0f} m",
        [
            Column("camera"),
            Column("too wide px"),
            Column("ragged px"),
            Column("shadow px", 1),
            Column("by geometry px", 1),
            Column("flying pixels", 1),
        ],
        note="Too wide: each upright edge outwards; ragged: its standard deviation over rows; shadow: unread, left.",
    )
    units, longest = settings.count(*UNITS), 0.0
    for name, built in settings.progress(KNOWN_CAMERAS.items(), len(KNOWN_CAMERAS), "optical cameras"):
        for depth in DEPTHS:
            rows = np.array([_wall(built, depth * (1 + 0.01 * k / units), settings.seed + k) for k in range(units)])
            longest = max(longest, float(np.median(rows[:, 3])))
            share, noise, bias, cost = (Spread.of(values) for values in rows.T)
            walls.add(name, depth, share, noise, bias, cost)
        rows = np.array([_edges(built, settings.seed + k) for k in range(units)])
        geometry = _focal_baseline(built) * (1 / NEAR - 1 / FAR)
        wide, ragged, shadow, flying = (Spread.of(values) for values in rows.T)
        edges.add(name, wide, ragged, shadow, geometry, flying)
    report.tables += [walls, edges]
    report.claims.append(Claim("a frame of an optical camera (processor s)", longest, LONGEST, at_least=False))


def _focal_baseline(built: OpticalCamera) -> float:
    return 0.0 if isinstance(built, TimeOfFlightCamera) else VGA.fx * built.baseline


def _wall(built: OpticalCamera, depth: float, seed: int) -> tuple[float, float, float, float]:
    """Read %, noise and bias (mm), processor time (s)."""
    rng = np.random.default_rng(seed)
    scene = Renderer({"background": (9 * CORNERS + [0, 0, depth], FACES)})
    begin = time.process_time()
    read = take(scene, {"background": np.eye(4)}, VGA, built, rng, draw_unit(rng)).depth.astype(np.float64)
    cost = time.process_time() - begin
    read = read[12:-12, int(_focal_baseline(built) / depth) + 12 : -12]
    v, u = np.nonzero(read)
    error = read[v, u] - depth
    x, y = u / VGA.width - 0.5, v / VGA.height - 0.5
    terms = np.stack([np.ones(len(u)), x, y, x * x, x * y, y * y], axis=1)
    smooth = terms @ np.linalg.lstsq(terms, error, rcond=None)[0]
    bias = 1e3 * float(np.sqrt(np.mean(smooth**2))) if len(u) else float("nan")
    return 100 * float((read > 0).mean()), 1e3 * float((error - smooth).std()), bias, cost


def _edges(built: OpticalCamera, seed: int) -> tuple[float, float, float, float]:
    """How much too wide, ragged (px), width of the shadow (px), pixels between both depths."""
    rng = np.random.default_rng(seed)
    plate, wall = (HALF * CORNERS + [0, 0, NEAR], FACES), (9 * CORNERS + [0, 0, FAR], FACES)
    scene = Renderer({"plate": plate, "background": wall})
    looks = dict.fromkeys(scene.names, PAINT)
    read = take(scene, dict.fromkeys(scene.names, np.eye(4)), VGA, built, rng, draw_unit(rng), looks).depth
    near, far = np.abs(read - NEAR) < 0.05, np.abs(read - FAR) < 0.1
    # pixel centres on integers: the outermost one inside is half a pixel from the edge in the mean
    left, right = VGA.cx - VGA.fx * HALF / NEAR, VGA.cx + VGA.fx * HALF / NEAR
    reach = int(VGA.fx * HALF / NEAR) - 12
    outward, band = [], []
    for v in range(240 - reach, 240 + reach):
        columns, behind = np.flatnonzero(near[v]), np.flatnonzero(far[v, : int(left)])
        if len(columns):
            outward.append((left - columns.min() + 0.5, columns.max() - right + 0.5))
        if len(behind):
            band.append(left - behind.max() - 0.5)
    if not outward or not band:
        return (float("nan"),) * 4
    flying = (read > NEAR + 0.05) & (read < FAR - 0.1)
    spread = float(np.std(outward, axis=0).mean())
    return float(np.mean(outward)), spread, float(np.median(band)), float(flying.sum())
