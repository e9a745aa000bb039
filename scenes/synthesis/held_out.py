"""Generated objects on which nothing is tuned: benchmarks only report them (docs/evaluation.md). Metres, z up."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from scenes.synthesis import shapes

Array = NDArray[np.float64]


def banana() -> shapes.Mesh:
    """A bent fruit of 180 mm, thicker in the middle, with a stalk; five soft edges along it."""

    def surface(p: Array) -> Array:
        # along an arc of 110 mm radius about (0, 0, 0.11): s runs from end to end
        radius, z = np.hypot(p[:, 0], p[:, 2] - 0.110), p[:, 2] - 0.110
        s = 0.110 * np.arctan2(p[:, 0], -z)
        away, side = radius - 0.110, p[:, 1]
        around = np.arctan2(side, away)
        thick = 0.0185 * np.sqrt(np.maximum(1.0 - (s / 0.098) ** 2, 0.04)) * (1.0 + 0.04 * np.cos(5 * around))
        body = 0.85 * np.maximum(np.hypot(away, side) - thick, np.abs(s) - 0.078)
        stalk = shapes.capsule(np.stack([s, side, away], axis=1), [0.074, 0, 0], [0.098, 0, -0.002], 0.0060, 0.0045)
        return shapes.smooth_union([body, 0.85 * stalk], 0.006)

    return shapes.mesh_implicit(surface, [-0.094, -0.030, -0.030], [0.110, 0.030, 0.080], 0.0024)


def sprayer() -> shapes.Mesh:
    """A trigger spray bottle: oval body, neck, head with nozzle, trigger; 235 mm high."""

    def surface(p: Array) -> Array:
        body = shapes.rounded_box(p, [0, 0, 0.065], [0.036, 0.026, 0.065], 0.016)
        shoulder = shapes.capsule(p, [0, 0, 0.130], [0, 0, 0.205], 0.024, 0.010)
        collar = shapes.rounded_cylinder(p, [0, 0, 0.168], [0, 0, 0.188], 0.0165, 0.003)
        head = shapes.rounded_box(p, [0.008, 0, 0.210], [0.036, 0.0125, 0.015], 0.006)
        nozzle = shapes.rounded_cylinder(p, [0.040, 0, 0.215], [0.060, 0, 0.215], 0.0085, 0.002)
        trigger = shapes.capsule(p, [0.030, 0, 0.200], [0.044, 0, 0.158], 0.0065, 0.0055)
        bottle = shapes.smooth_union([body, shoulder], 0.012)
        return shapes.smooth_union([bottle, collar, head, nozzle, trigger], 0.004)

    return shapes.mesh_implicit(surface, [-0.044, -0.034, -0.008], [0.070, 0.034, 0.236], 0.0026)


def camera() -> shapes.Mesh:
    """A compact camera: flat body with a grip on one side, lens, viewfinder hump, shutter button; 125 mm wide."""

    def surface(p: Array) -> Array:
        body = shapes.rounded_box(p, [0, 0, 0.036], [0.060, 0.017, 0.036], 0.007)
        grip = shapes.capsule(p, [-0.049, -0.016, 0.012], [-0.049, -0.016, 0.058], 0.0125)
        lens = shapes.rounded_cylinder(p, [0.010, -0.010, 0.034], [0.010, -0.058, 0.034], 0.029, 0.003)
        hump = shapes.rounded_box(p, [0.010, 0, 0.076], [0.020, 0.014, 0.010], 0.006)
        button = shapes.rounded_cylinder(p, [-0.046, -0.010, 0.070], [-0.046, -0.010, 0.077], 0.007, 0.0015)
        return shapes.smooth_union([body, grip, lens, hump, button], 0.004)

    return shapes.mesh_implicit(surface, [-0.070, -0.066, -0.008], [0.070, 0.025, 0.094], 0.0026)


def kettle() -> shapes.Mesh:
    """A small pot with a spout, a knob and a handle on the other side; 170 mm from handle to spout."""

    def surface(p: Array) -> Array:
        pot = shapes.ellipsoid(p, [0, 0, 0.044], [0.052, 0.052, 0.044])
        foot = shapes.rounded_cylinder(p, [0, 0, 0.003], [0, 0, 0.016], 0.031, 0.003)
        lid = shapes.rounded_cylinder(p, [0, 0, 0.080], [0, 0, 0.090], 0.025, 0.004)
        knob = shapes.ellipsoid(p, [0, 0, 0.099], [0.010, 0.010, 0.010])
        spout = shapes.capsule(p, [0.040, 0, 0.036], [0.088, 0, 0.082], 0.0135, 0.0075)
        ring = np.hypot(p[:, 0] + 0.058, (p[:, 2] - 0.048) / 1.15) - 0.029
        handle = np.hypot(ring, p[:, 1]) - 0.0062
        return shapes.smooth_union([pot, foot, lid, knob, spout, handle], 0.006)

    return shapes.mesh_implicit(surface, [-0.102, -0.062, -0.008], [0.106, 0.062, 0.118], 0.0022)


def ladle() -> shapes.Mesh:
    """A flat handle of 240 mm with a bowl of 70 mm across at its end, tilted to one side."""

    def surface(p: Array) -> Array:
        handle = shapes.rounded_box(p, [0, 0, 0.120], [0.0095, 0.0042, 0.120], 0.003)
        ball = np.linalg.norm(p - [0.0, 0.026, 0.268], axis=1)
        # open towards +y
        bowl = np.maximum(np.abs(ball - 0.033) - 0.0031, p[:, 1] - 0.0337)
        return shapes.smooth_union([handle, bowl], 0.006)

    return shapes.mesh_implicit(surface, [-0.042, -0.016, -0.006], [0.042, 0.046, 0.310], 0.0022)


def wrench() -> shapes.Mesh:
    """A spanner of 260 mm: a flat shaft, an open jaw at one end and a ring at the other."""

    def surface(p: Array) -> Array:
        shaft = shapes.rounded_box(p, [0, 0, 0.130], [0.0100, 0.0045, 0.100], 0.003)
        head = np.hypot(p[:, 0], p[:, 2] - 0.238) - 0.023
        opening = shapes.rounded_box(p, [0.004, 0, 0.258], [0.0095, 0.020, 0.024], 0.002)
        jaw = np.maximum(np.maximum(head, -opening), np.abs(p[:, 1]) - 0.0065)
        ring = np.maximum(np.abs(np.hypot(p[:, 0], p[:, 2] - 0.018) - 0.0135) - 0.0055, np.abs(p[:, 1]) - 0.0075)
        return shapes.smooth_union([shaft, jaw, ring], 0.003)

    return shapes.mesh_implicit(surface, [-0.030, -0.013, -0.006], [0.030, 0.013, 0.268], 0.0022)


MAKERS: dict[str, Callable[[], shapes.Mesh]] = {
    "banana": banana,
    "camera": camera,
    "kettle": kettle,
    "ladle": ladle,
    "sprayer": sprayer,
    "wrench": wrench,
}
