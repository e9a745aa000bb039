"""Slip: the pressure pattern moves over the array from frame to frame when the object moves in the hand.

An object that is held still keeps its pattern; more or less force makes it higher, not elsewhere. What is followed is
the displacement that lays one pattern on the next, in the tangent plane, and how far the shape itself changed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenes import poses as se3
from scenes.errors import InputError
from touch.arrays.descriptor import describe, tangent_frame
from touch.arrays.readings import Reading

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SlipSettings:
    """When a pattern has moved."""

    # Displacement (m) of the pressure's middle, as a share of the pitch, below which noise explains it; a pattern that
    # grows over one more row of taxels moves by less.
    share: float = 0.25
    # Turn of the pattern (rad) that counts, and how long beside its width a pattern must be to have a direction.
    turn: float = float(np.deg2rad(12.0))
    elongated: float = 0.3
    # Share of the pattern, scaled to the same force, that lies elsewhere than before.
    change: float = 0.35


@dataclass(frozen=True)
class Slip:
    """displacement (2,) m of the pressure's middle in the tangent plane (x along the sensor's x); turn (rad) of the
    pattern, NaN when it has no direction; change: share of the pressure that lies elsewhere, 0 to 1, forces made
    equal; force: ratio of the sums of pressure; state: "none", "held", "slipped", "made" or "broken" contact.
    """

    displacement: Array
    turn: float
    change: float
    force: float
    state: str


def slip_between(before: Reading, after: Reading, settings: SlipSettings | None = None) -> Slip:
    """How the pattern of one array changed. Raises InputError for readings of different layouts."""
    settings = settings or SlipSettings()
    if before.taxels.shape != after.taxels.shape:
        raise InputError(f"slip: expected two readings of one array, got {before.taxels.shape}, {after.taxels.shape}")
    old, new = (np.where(r.active, r.pressure, 0.0) for r in (before, after))
    if not old.any() or not new.any():
        state = "none" if not old.any() and not new.any() else "made" if new.any() else "broken"
        return Slip(np.zeros(2), float("nan"), 0.0 if state == "none" else 1.0, float("nan"), state)
    # both in the array's own frame: the hand may have moved in between
    places = se3.apply(se3.inverse(before.frame_from_sensor), before.taxels[:, :3])
    frame = se3.inverse(before.frame_from_sensor) @ tangent_frame(before)
    plane = se3.apply(se3.inverse(frame), places)[:, :2]
    old, new = old / old.sum(), new / new.sum()
    displacement = (new - old) @ plane
    turn = _turn(before, after, settings.elongated)
    change = 0.5 * float(np.abs(new - old).sum())
    moved = float(np.linalg.norm(displacement)) > settings.share * before.pitch
    turned = bool(np.isfinite(turn) and abs(turn) > settings.turn)
    state = "slipped" if moved or turned or change > settings.change else "held"
    return Slip(displacement, turn, change, float(after.pressure.sum() / before.pressure.sum()), state)


def _turn(before: Reading, after: Reading, elongated: float) -> float:
    """Angle (rad) between the long axes, in (-pi/2, pi/2]; a line has no ends."""
    first, second = describe(before).heading, describe(after).heading
    if min(np.linalg.norm(first), np.linalg.norm(second)) < elongated:
        return float("nan")
    double = np.arctan2(first[0] * second[1] - first[1] * second[0], first @ second)
    return 0.5 * float(double)


def slipped(
    before: list[Reading], after: list[Reading], settings: SlipSettings | None = None
) -> tuple[bool, dict[str, Slip]]:
    """Whether the object moved in the hand between two frames, and each array's change by its name.

    It moved when an array slipped; a contact made or broken alone is a finger that moved. Arrays that only one of the
    frames has say nothing.
    """
    later = {reading.sensor: reading for reading in after}
    changes = {r.sensor: slip_between(r, later[r.sensor], settings) for r in before if r.sensor in later}
    return any(change.state == "slipped" for change in changes.values()), changes
