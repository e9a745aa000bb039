"""Slip: the pressure pattern moves over the array from frame to frame when the object moves in the hand.

An object that is held still keeps its pattern; more or less force makes it higher, not elsewhere. What is followed is
the displacement that lays one pattern on the next, in the tangent plane, and how far the shape itself changed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from scenes.errors import InputError
from scenes.geometry import poses as se3
from touch.arrays.descriptor import SMALLEST_VARIANCE, tangent_frame
from touch.arrays.readings import Reading

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PatternSlipSettings:
    """When a pattern has moved. Values tuned on generated sequences."""

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


def slip_between(before: Reading, after: Reading, settings: PatternSlipSettings | None = None) -> Slip:
    """How the pattern of one array changed. Raises InputError for readings of different layouts."""
    settings = settings or PatternSlipSettings()
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
    turn = _turn(plane, old, new, settings.elongated)
    change = 0.5 * float(np.abs(new - old).sum())
    found = Slip(displacement, turn, change, float(after.pressure.sum() / before.pressure.sum()), "held")
    moved = limits_moved(found, before.pitch, settings)
    return replace(found, state="slipped") if moved > 1.0 else found


def _turn(plane: Array, before: Array, after: Array, elongated: float) -> float:
    """Angle (rad) between the long axes, in (-pi/2, pi/2], of shares of pressure (k,) at places (k, 2); a line has no
    ends. Both in one plane and weighed by pressure: a taxel at the threshold must not turn the pattern.
    """
    first, second = _heading(plane, before), _heading(plane, after)
    if min(np.linalg.norm(first), np.linalg.norm(second)) < elongated:
        return float("nan")
    double = np.arctan2(first[0] * second[1] - first[1] * second[0], first @ second)
    return 0.5 * float(double)


def _heading(plane: Array, share: Array) -> Array:
    """(2,) the long axis by its double angle, times how much longer the pattern is than wide (0 to 1)."""
    away = plane - share @ plane
    c = (away * share[:, None]).T @ away
    total = c[0, 0] + c[1, 1]
    return np.array([c[0, 0] - c[1, 1], 2.0 * c[0, 1]]) / total if total > SMALLEST_VARIANCE else np.zeros(2)


def slipped(
    before: list[Reading], after: list[Reading], settings: PatternSlipSettings | None = None
) -> tuple[bool, dict[str, Slip]]:
    """Whether the object moved in the hand between two frames, and each array's change by its name.

    It moved when an array slipped; a contact made or broken alone is a finger that moved. Arrays that only one of the
    frames has say nothing.
    """
    later = {reading.sensor: reading for reading in after}
    changes = {r.sensor: slip_between(r, later[r.sensor], settings) for r in before if r.sensor in later}
    return any(change.state == "slipped" for change in changes.values()), changes


@dataclass(frozen=True)
class PatternSettings:
    """When the patterns of a hand say that the object has moved in it. Values tuned on generated sequences."""

    # Of one array. Noise of 400 Pa moves the middle by 0.1 mm where the pressure is low and by 0.03 mm elsewhere.
    slip: PatternSlipSettings = field(default_factory=PatternSlipSettings)
    # One array that is this many times its limits from where its pattern was is enough; a finger that rolls moves its
    # own pattern alone, so two need less.
    alone: float = 0.75
    together: float = 0.4
    # Frames over which what the pattern was is averaged: a slip lasts a fifth of a second or less, 6 frames at 30 Hz,
    # and warm rubber drifts in minutes.
    memory: float = 8.0
    # Frames for which a new contact must last before it can slip.
    settled: int = 3
    # A force that has changed by this factor or more is a new grip, not a slip.
    gripped: float = 3.0
    # All taxels of an array together must feel this many times what one reports at least: of less, noise and the
    # threshold make a pattern of their own.
    faint: float = 10.0


@dataclass(frozen=True)
class PatternChange:
    """What the arrays say of one frame: slipped; statistic, above 1 is a slip; changes: each array's own."""

    slipped: bool
    statistic: float
    changes: dict[str, Slip]


class PatternWatch:
    """Compares each array's pattern with what it was a moment ago, frame after frame."""

    def __init__(self, settings: PatternSettings | None = None) -> None:
        """Cheap."""
        self.settings = settings or PatternSettings()
        self._usual: dict[str, tuple[Reading, int]] = {}

    def restart(self) -> None:
        """Forget what the patterns were."""
        self._usual = {}

    def step(self, readings: Sequence[Reading]) -> PatternChange:
        """The readings of the next frame, in any frame of reference."""
        s = self.settings
        usual, changes, moved = {}, {}, [0.0, 0.0]
        for reading in readings:
            before, age = self._usual.get(reading.sensor, (reading, 0))
            change = slip_between(before, reading, s.slip)
            changes[reading.sensor] = change
            faint = min(r.pressure[r.active].sum() for r in (before, reading)) < s.faint * reading.layer.threshold
            if faint or change.state not in ("held", "slipped") or not 1.0 / s.gripped < change.force < s.gripped:
                usual[reading.sensor] = reading, 0
                continue
            if age >= s.settled:
                moved.append(limits_moved(change, reading.pitch, s.slip))
            share = 1.0 / min(age + 2.0, s.memory)
            pressure = (1.0 - share) * before.pressure + share * reading.pressure
            usual[reading.sensor] = replace(reading, pressure=pressure), age + 1
        second, first = sorted(moved)[-2:]
        statistic = max(first / s.alone, second / s.together)
        if statistic > 1.0:  # what comes next is compared with where the object has come to
            usual = {r.sensor: (r, min(usual[r.sensor][1], s.settled)) for r in readings}
        self._usual = usual
        return PatternChange(statistic > 1.0, statistic, changes)


def limits_moved(change: Slip, pitch: float, settings: PatternSlipSettings) -> float:
    """How far a pattern has moved, in units of what noise may do: the largest of displacement, turn and change."""
    turn = abs(change.turn) / settings.turn if np.isfinite(change.turn) else 0.0
    return max(
        float(np.linalg.norm(change.displacement)) / (settings.share * pitch), turn, change.change / settings.change
    )
