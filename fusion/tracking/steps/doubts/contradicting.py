"""Does what the fingers report belong to this instant, and to this object?

A stamp that is late by two frames, a driver that has stopped, and a sensor that always fires report contacts beside the
object. One frame cannot tell them from a hand beside where the robot has it; without sigmas they are never taken for
false (touch.contacts), and all together they pull the object after them. A track knows where the object was, and an
image shows it. Camera frame, metres, radians.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fusion.estimation.posterior.verdict import contact_residuals
from fusion.estimation.solve.joint import JointResult
from fusion.tracking.answer import TrackSettings
from fusion.tracking.memory.state import TrackState
from fusion.tracking.steps.refining import Refined, refine, solve_leader
from fusion.tracking.steps.sensing import Sensed
from scenes.evidence.align import Prior
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.beliefs import Beliefs, CalibrationModel
from scenes.recordings.frames import Contacts, Frame

Array = NDArray[np.float64]

# Why contacts of a frame are not used.
NOT_HERE = "contacts are not where the image has the object, by more than a robot may be off: left out"


def strain(xi: Array, centre: Array, calibration: CalibrationModel) -> float:
    """Squares of a correction xi (6,) about `centre` (3,), camera frame, in units of what is believed of the robot's
    calibration: 6 on average.
    """
    whole = np.zeros((6, 6))
    whole[:3, :3] = calibration.rotation_sigma * np.eye(3)
    whole[3:, :3] = -calibration.rotation_sigma * se3.skew(centre)
    whole[3:, 3:] = calibration.translation_sigma * np.eye(3)
    return float(np.square(np.linalg.solve(whole, xi)).sum())


def may_be_strangers(frame: Frame, sensed: Sensed | None, state: TrackState, settings: TrackSettings) -> bool:
    """Whether contacts of a frame may be held against its image: it shows an object whose track searches have spoken
    for, and no hand that says where contacts are.
    """
    if sensed is None or sensed.viewed.index != frame.index or sensed.pool is None or sensed.placed:
        return False
    enough = len(sensed.looked.pixels) >= settings.fewest_pixels and len(sensed.felt.reported_contacts) > 0
    believed = bool(state.hypotheses) and state.hypotheses[0].votes >= settings.hypotheses.believed
    return enough and believed and sensed.looked.hand is None


def without_strangers(
    model: ObjectModel,
    frame: Frame,
    prior: Prior,
    solved: JointResult,
    found: Refined,
    sensed: Sensed,
    state: TrackState,
    beliefs: Beliefs,
    settings: TrackSettings,
) -> Frame | None:
    """The frame without contacts that contradict what is seen of an object whose track searches have spoken for, where
    no hand in the image says where they are; None where none does. solved: the frame's own answer with all of them.

    All of them do where robot and depth scale would have to be off, and the picture be worse than without them, by what
    comes one time in a thousand. A few by themselves do where they are off the answer with them and off that without.
    """
    how, felt = settings.hypotheses, sensed.felt
    if found.switched or not may_be_strangers(frame, sensed, state, settings):
        return None
    off = strain(solved.xi, solved.centre, beliefs.calibration) + (solved.scale / beliefs.depth.scale_sigma) ** 2
    false = _outliers(model, felt.reported_contacts.moved(solved.correct()), solved.pose, settings)
    if off <= len(solved.xi) and not false.any():
        return None
    assert sensed.pool is not None
    none = np.zeros(0, dtype=np.intp)
    unfelt = replace(
        felt, reported_contacts=felt.reported_contacts.take(none), reported_rows=felt.reported_rows.take(none)
    )
    alone = replace(sensed, felt=unfelt, pool=replace(sensed.pool, felt=unfelt.rows, contacts=0, fingers=0))
    by_image = refine(model, (replace(found.hypotheses[0], pose=prior.pose),), prior, alone, state.imaged, settings)
    start, levels = by_image.hypotheses[0].pose, list(state.levels)
    shown = solve_leader(model, frame.without_touch(), start, prior, by_image, alone, levels, beliefs, settings)
    joint, image = sensed.pool.predictor.costs(np.array([solved.as_seen, shown.as_seen]))
    worth = 1.0 if sensed.told_apart else how.of_cost
    if off + 2.0 * worth * float(joint - image) > settings.glance.surprise:
        return frame.without_touch()
    false &= _outliers(model, felt.reported_contacts, shown.pose, settings)
    if not false.any() or false.mean() > 0.5 or len(false) != len(frame.contacts):
        return None
    return replace(frame, contacts=frame.contacts.take(~false))


def _outliers(model: ObjectModel, contacts: Contacts, pose: Array, settings: TrackSettings) -> NDArray[np.bool_]:
    """(n,) which contacts do not belong to the object at pose (4, 4)."""
    return np.array([r.outlier for r in contact_residuals(model, contacts, pose, settings.first.verdict)], dtype=bool)
