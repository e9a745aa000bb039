"""What a camera saw of the object at a pose, as rows of evidence: pixels that show it, and where it cannot be.

Camera frame, metres.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenes.evidence.table import COLUMNS, VISION, Evidence
from vision.look.looked import RowSettings
from vision.picture import shown_kernels as kernels
from vision.picture.prediction import View
from vision.picture.predictor import Predictor

Array = NDArray[np.float64]


def shown_rows(
    predictor: Predictor,
    poses: Array,
    free: Evidence,
    settings: RowSettings,
    least: int,
    side: int | None = None,
    most: int = 0,
) -> list[Evidence]:
    """Vision's rows if the object were at each of poses (n, 4, 4): ON rows of the pixels that show it there, at most
    settings.most, and OUTSIDE rows on the rays that see past it, where it cannot be, with those of `free`, which hold
    wherever it is.

    least: of fewer pixels none is believed. side: rays along each side of an outline's box; default as many as show
    enough pixels. most: at most so many ON rows and half as many OUTSIDE, carrying the weight of all; 0: all.
    """
    s = predictor.settings
    if side is not None:
        view = predictor.view(poses, side)
        return [_rows(predictor, view, n, free, settings, least, most)[1] for n in range(len(poses))]
    found = []
    for pose in poses:
        shown, rows = 0, Evidence(np.zeros((0, COLUMNS)), np.zeros(0, dtype=np.uint8))
        if _would_show(predictor, pose, s.sides_rows[0]) >= s.enough_rows:
            shown, rows = _rows(predictor, predictor.view(pose[None], s.sides_rows[0]), 0, free, settings, least, most)
        if shown < s.enough_rows:
            shown, rows = _rows(predictor, predictor.view(pose[None], s.sides_rows[1]), 0, free, settings, least, most)
        found.append(rows)
    return found


def _would_show(predictor: Predictor, pose: Array, side: int) -> float:
    """About how many of `side` rays along each side of the box around the outline at pose (4, 4) show the object, by
    the few that a pose is scored by: all but those at the rim of the outline.
    """
    few, finer = predictor.predict(pose[None]), side / predictor.side
    across = finer * np.sqrt(few.count[0])
    rim = 1.0 - 2.0 / max(across, 2.0)
    return float(few.agree[0] * across**2 * rim**2)


def _rows(
    predictor: Predictor, view: View, n: int, free: Evidence, settings: RowSettings, least: int, most: int
) -> tuple[int, Evidence]:
    """How many rays of pose n of a view show the object, and its rows."""
    s, belief, side = predictor.settings, predictor.belief, view.side
    chosen = np.zeros(side * side, dtype=np.int64)
    shown = kernels.shown_rays(view.state[n], side, 1, s.thin_share, chosen)
    depths = np.array(s.empty_depths)
    # of rays that see past, as many are taken as a pose is scored by
    room = np.zeros((min(side, predictor.side) ** 2 * len(depths), COLUMNS))
    kept = most + max(1, most // 2) if most else settings.most + len(free) + len(room)
    rows = np.zeros((kept, COLUMNS))
    count = kernels.fill_rows(
        view.u[n],
        view.v[n],
        view.step[n],
        (view.expected[n], view.seen[n], view.state[n], view.past[n]),
        predictor.known[1],
        chosen,
        (shown, least),
        (belief.axial_floor, belief.axial_growth, belief.axial_from, belief.bias_sigma),
        (settings.most, belief.sharing_length**2, settings.gate_above, settings.gate_below),
        (depths, s.empty_clearance, s.empty_sigma, s.empty_gate, s.cells, predictor.side),
        free.rows,
        most,
        room,
        rows,
    )
    return shown, Evidence(rows[:count], np.full(count, VISION, dtype=np.uint8))
