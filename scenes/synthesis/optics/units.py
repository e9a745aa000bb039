"""One camera of its kind, before one set of things: what does not change from frame to frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# Seeds are drawn below this.
SEEDS = 2**31


@dataclass(frozen=True)
class CameraUnit:
    """One camera.

    seed: of its pattern and of the things' materials; flaws (6,): what its calibration left, in standard deviations of
    its kind (turns about x, y, z, baseline, delay, distortion); lamp (3,): unit direction towards the lamp of the room,
    camera frame.
    """

    seed: int
    flaws: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    lamp: tuple[float, float, float] = (-0.4, -0.7, -0.6)


def draw_unit(rng: np.random.Generator) -> CameraUnit:
    """Any camera, before any things, under a lamp above."""
    seed, flaws = int(rng.integers(SEEDS)), tuple(float(x) for x in rng.normal(size=6))
    lamp = np.array([rng.normal(), -abs(rng.normal()) - 0.3, rng.normal() - 0.5])
    lamp /= np.linalg.norm(lamp)
    return CameraUnit(seed, flaws, (float(lamp[0]), float(lamp[1]), float(lamp[2])))
