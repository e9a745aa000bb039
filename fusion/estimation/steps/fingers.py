"""What contacts of one finger are off by together, told of an answer whose rows do not say it.

Rows err each by itself; where their finger is, its contacts share. Camera frame, metres, radians.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from scenes.evidence.align import Prior, terms
from scenes.evidence.modes import Mode
from scenes.geometry.objects import ObjectModel
from touch.contacts import Felt

Array = NDArray[np.float64]


def with_fingers(model: ObjectModel, felt: Felt, mode: Mode, prior: Prior | None = None) -> Mode:
    """The mode as unsure as the places of its fingers leave it, where the rows of `felt` were not weighed down to that.

    They are considered, not solved for (Schmidt 1966): a finger's points that move together by an error of variance s
    move the pose as if the object had moved the other way, so with N the normal matrix of all rows and the prior, and E
    the columns of moves in that of a finger's, s N^-1 E E' N^-1 is added to the covariance.
    """
    shared = felt.shared
    if felt.weighed or shared is None or not len(shared.of):
        return mode
    moved = [np.zeros((6, 0))]
    for finger in range(int(shared.of.max()) + 1):
        rows = np.flatnonzero(shared.of == finger)
        if len(rows) > 1:
            moves = terms(model, felt.rows.take(rows), mode.pose)[2][:, 3:]
            moved.append(np.sqrt(float(shared.variance[rows].mean())) * moves)
    together = np.concatenate(moved, axis=1)
    if not together.any():
        return mode
    # what nothing ties follows no finger
    following = np.linalg.pinv(terms(model, felt.rows, mode.pose, prior)[2], rcond=1e-9, hermitian=True)
    spread = following @ together  # times its transpose, symmetric to the last digit
    return replace(mode, covariance=mode.covariance + spread @ spread.T)
