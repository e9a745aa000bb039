"""Edges next to an outline: on each line the step from one side's level to the other's, to a tenth of a pixel.

What colours tell of a border (`lines`) holds wherever it is, but to half a pixel only: they are read at whole pixels
and counted in bins. Near the border a blurred step says more.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vision.contour import edge_kernels
from vision.contour.lines import Lines

Array = NDArray[np.float64]


@dataclass(frozen=True)
class EdgeSettings:
    """How steps are fitted. Tuned on the families `d435`, `lab`, `dots` and `rough`; of most of these, twice or half
    as much made no difference.
    """

    # Lines within this distance (px) along the outline, with normals of this cosine at least, are read together: dots
    # of a projector that are on fewer than half of them are left out.
    along: float = 5.0
    alike: float = 0.8
    # Standard deviation (px) that a step is smeared by, and how far from it (px) it is looked at.
    smear: float = 0.8
    window: float = 3.5
    # Least standard deviation of a pixel (levels of 255): they are rounded.
    rounding: float = 1.0
    # Gauss-Newton steps at most.
    rounds: int = 6
    # A step farther than this (px) from where the colours have the border is another, and one of fewer levels of 255
    # is none.
    farthest: float = 2.0
    least: float = 8.0


def edges_near(lines: Lines, start: Array, settings: EdgeSettings) -> Array:
    """(n, 2) where each line's step next to start (n,) is and its standard deviation (px), inf where there is none;
    start is NaN where none is looked for.
    """
    s, samples, outline = settings, lines.samples, lines.outline
    values, found = np.zeros(samples.shape[:2]), np.zeros((len(lines), 3))
    edge_kernels.profiles(samples, outline.places, outline.normals, s.along, s.alike, values)
    first = -float(samples.shape[1] // 2)
    edge_kernels.steps(values, first, start, s.smear, s.window, s.rounding, s.rounds, found)
    found[~(np.abs(found[:, 0] - start) < s.farthest) | (np.abs(found[:, 2]) < s.least), 1] = np.inf
    return found[:, :2].copy()
