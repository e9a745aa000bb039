"""Where the robot's hand is seen when it is far from where the robot says: looked for, not only aligned.

An alignment follows pixels as far as they are taken for the hand's, a centimetre; beyond, it ends on the next finger,
on what the hand holds, or where it began, and does not say so. So the hand is moved over a grid of places, at each of
which the depth image says how much of it is read where it would be and how much is seen past: lookups alone, a fraction
of a millisecond. Where a place explains much more than the alignment does, the hand is aligned from there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenes.recordings.frames import Frame
from vision.look.hand.hand_kernels import explained

Array = NDArray[np.float64]


@dataclass(frozen=True)
class HandSearchSettings:
    """Where and how the hand is looked for. Tuned on frames of `lab`, `d435` and `rough` whose robots were moved."""

    # Points of the hand's surface that are looked up (no unit).
    points: int = 400
    # Steps of the grid to either side (no unit), and its spacing (m).
    steps: int = 2
    spacing: float = 0.012
    # On the grid: a reading within so much (m) of a point of the hand is the hand's, and one so much (m) farther behind
    # it is something that the hand should hide.
    near: float = 0.012
    past: float = 0.015
    # The same (m) where two places are compared: what depth and calibration are usually off by.
    close: float = 0.006
    beyond: float = 0.010
    # By what share of its points (no unit) a place must explain more than another to be believed instead.
    better: float = 0.02


def shares(
    frame: Frame, points: Array, camera_from_hand: Array, grid: tuple[Array, Array, Array], near: float, past: float
) -> NDArray[np.float64]:
    """(a, b, c) of the hand's points (n, 3), hand frame: the share that is read where it would be, less the share that
    is seen past, with the hand at camera_from_hand (4, 4) moved to each place of a grid: (a,), (b,) and (c,) metres
    along the camera's axes.
    """
    assert frame.camera is not None
    assert frame.depth is not None
    there = points @ camera_from_hand[:3, :3].T + camera_from_hand[:3, 3]
    camera, out = frame.camera, np.zeros([len(line) for line in grid[::-1]], dtype=np.int64)
    lens = camera.fx, camera.fy, camera.cx, camera.cy
    explained(there, *grid, lens, np.ascontiguousarray(frame.depth), near, past, out)
    return np.asarray(out.T / max(len(points), 1), dtype=np.float64)


def elsewhere(frame: Frame, points: Array, aligned: Array, settings: HandSearchSettings) -> Array | None:
    """A shift (3,) of an aligned hand, (4, 4) camera_from_hand, to where much more of it would be explained, in metres;
    None where there is none.
    """
    s = settings
    far, fine = s.spacing * _line(s.steps), 0.5 * s.spacing * _line(1)
    here, best = (fine,) * 3, _largest(shares(frame, points, aligned, (far,) * 3, s.near, s.past))
    there = (far[best[0]] + fine, far[best[1]] + fine, far[best[2]] + fine)
    found = [shares(frame, points, aligned, grid, s.close, s.beyond) for grid in (here, there)]
    # where both have as much of it, the nearer
    grid, told = (there, found[1]) if found[1].max() > found[0].max() else (here, found[0])
    if told.max() < found[0][1, 1, 1] + s.better:
        return None
    return np.array([line[k] for line, k in zip(grid, _largest(told))], dtype=np.float64)


def here_alone() -> tuple[Array, Array, Array]:
    """The grid of one place: where the hand is."""
    return (_line(0),) * 3


def _line(steps: int) -> Array:
    """(k,) whole numbers up to `steps` to either side of 0."""
    return np.arange(-steps, steps + 1, dtype=np.float64)


def _largest(values: Array) -> tuple[int, int, int]:
    """Where (a, b, c) is largest."""
    a, b, c = np.unravel_index(int(np.argmax(values)), values.shape)
    return int(a), int(b), int(c)
