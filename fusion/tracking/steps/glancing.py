"""A glance at a frame whose predecessors were understood: where is the object now, is anything otherwise than it was?

A look in full finds the hand in the image, solves with every shared error and draws the predicted picture. From frame
to frame none of that changes: a calibration stays, a camera's bias and scale stay, and a hand that closes on an object
stays closed. So between two looks in full a frame is fitted by its rows alone, a few steps from the prediction; what
the whole solution of the last look added to such a fit is added again, and what it said of its own certainty still
holds, in the object's own axes. Whatever is otherwise than expected (pixels, what is seen past the object, contacts)
asks for a look in full at this very frame, and so does a pose that nobody predicted; while the object slips, a second
glance at where it seems to be will do. Camera frame, metres, radians.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fusion.estimation.answer import ContactResidual, Mode
from fusion.estimation.posterior.confidence import within
from fusion.estimation.posterior.verdict import contact_residuals, pixel_agreement
from fusion.tracking.answer import TrackSettings
from fusion.tracking.filter import Belief, Measurement
from fusion.tracking.memory.hypotheses import Hypotheses, ways_of, weights
from fusion.tracking.memory.occluders import Occluders
from fusion.tracking.memory.rest import Rest
from fusion.tracking.memory.state import GlanceSettings, Known, TrackState
from fusion.tracking.steps.judging import Judged, as_open
from fusion.tracking.steps.refining import loose
from fusion.tracking.steps.sensing import Sensed, pool_near
from scenes.evidence import table as tables
from scenes.evidence.align import AlignSettings, Prior, align
from scenes.evidence.table import Evidence
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.beliefs import Beliefs
from scenes.recordings.frames import Frame
from touch.contacts import Felt, feel
from vision.look.warm import Looker
from vision.sight import Sight

Array = NDArray[np.float64]

# A contact farther off than this (mm) is false, however far.
_FALSE = 20.0
# No look is surer than this (m) of what the next has in common with it.
_SUREST = 1e-4
# No prior counts less (a share): what rows leave open must stay where it was predicted.
LEAST_PART = 0.01


@dataclass(frozen=True)
class Glanced:
    """What a glance has found: the frame's rows; the measurement; residuals of contacts; share of the pixels explained
    and their RMS (m); otherwise: what asks for a look in full, in words, empty when nothing does; surprised: nothing
    but how far it is from the prediction.
    """

    sensed: Sensed
    measured: Measurement
    residuals: tuple[ContactResidual, ...]
    share: float
    rms: float
    otherwise: str
    surprised: bool = False


@dataclass(frozen=True)
class Steadied:
    """A look in full by what looks have in common. fit (4, 4): of its rows alone, contacts where `correction` (4, 4)
    puts them; offset (6,): from there to what looks are solved as; weight: of these; measured: the frame's own answer
    by that; part: of what the whole solution takes of them, what rows count.
    """

    fit: Array
    offset: Array
    correction: Array
    weight: float
    measured: Measurement
    part: float

    def seen_from(self, model: ObjectModel) -> Array:
        """(4, 4) takes a pose to where the image, uncorrected, shows the object: along its ray by what the whole
        solutions of looks have added to their rows.
        """
        middle = se3.apply(self.measured.pose, model.centroid[None])[0]
        back = np.eye(4)
        back[:3, 3] = -float(self.offset[3:] @ middle) / max(float(middle @ middle), 1e-9) * middle
        return back


def may_glance(
    model: ObjectModel, frame: Frame, state: TrackState, carried: Hypotheses, settings: TrackSettings
) -> bool:
    """Whether a frame whose hypotheses were carried to it need not be looked at in full. Other ways round in place of
    the leader go with it.
    """
    s, known = settings.glance, state.known
    if known is None or frame.depth is None or frame.camera is None:
        return False
    parts = weights(carried, settings.hypotheses)
    share = float(parts[0] + sum(parts[k] for k in ways_of(model, carried, settings.hypotheses)))
    every = s.every if share >= s.alone else min(s.every, s.every_open)
    if not 0 < frame.index - state.index <= s.gap or state.glanced + 1 >= every:
        return False
    if frame.index >= state.renewal.due or carried[0].age < s.settled:
        return False
    return share >= s.leads


def glance(
    model: ObjectModel,
    frame: Frame,
    felt_frame: Frame,
    looker: Looker,
    predicted: Belief,
    known: Known,
    things: Occluders,
    moving: bool,
    beliefs: Beliefs,
    rest: Rest,
    settings: TrackSettings,
) -> Glanced:
    """Look at a frame near the prediction; felt_frame: the same as far as touch may tell; moving: the object is known
    to move in the hand, so that a surprise is none; rest: where it has been at rest.
    """

    def at(start: Array) -> Glanced:
        return _glanced_at(model, frame, felt_frame, looker, start, predicted, known, things, beliefs, settings)

    found = at(predicted.pose)
    if not found.otherwise and not found.sensed.told_apart:
        if rest.left(model, found.measured.pose) is not None:
            return replace(found, otherwise="it is not where it was at rest")
        return _followed(model, found, at, predicted.pose, settings)
    if not (found.surprised and moving):
        return found
    # it goes on moving otherwise than predicted, and all else is as it was: pixels are chosen anew where it is now
    here = found.measured.pose
    again = at(here)
    if again.otherwise and not again.surprised:
        return again
    step = se3.difference(again.measured.pose, here, model.centroid)
    still = float(step @ np.linalg.solve(2.0 * again.measured.own, step))
    way = se3.difference(again.measured.pose, predicted.pose, model.centroid)
    known_again = still <= settings.glance.surprise and not settings.leaps(way)
    return replace(again, otherwise="") if known_again else again


def _followed(
    model: ObjectModel, found: Glanced, at: Callable[[Array], Glanced], expected: Array, settings: TrackSettings
) -> Glanced:
    """A glance from the pose `expected` (4, 4), unless the object goes on from where it has led to: pixels inside the
    outline where it was expected hold it there, and those chosen anew tell. Then the frame is looked at in full.

    at: glances with the pixels near a pose (4, 4).
    """

    def moved(there: Array, here: Array) -> bool:
        step = se3.difference(there, here, model.centroid)
        return bool(np.linalg.norm(step[3:]) > settings.glance.anew_distance)

    there = found.measured.pose
    if not moved(there, expected):
        return found
    again = at(there)
    if again.otherwise:
        return again
    if moved(again.measured.pose, there):
        return replace(again, otherwise="it goes on from where pixels were chosen anew")
    return found


def _glanced_at(
    model: ObjectModel,
    frame: Frame,
    felt_frame: Frame,
    looker: Looker,
    start: Array,
    predicted: Belief,
    known: Known,
    things: Occluders,
    beliefs: Beliefs,
    settings: TrackSettings,
) -> Glanced:
    """A glance with the pixels near the pose `start` (4, 4)."""
    first, how = settings.first, settings.glance
    looked = looker.look(frame, start, how.pixels)
    touch = replace(first.touch, hand_points=0)
    felt = feel(felt_frame, known.correction, beliefs, None, touch)
    pool = None
    if not looked.told_apart:
        pool = pool_near(frame, model, start[None], looked, felt, beliefs, first, settings.room, pieces=False)
    near = looked.rows(beliefs.depth, looker.first.rows)
    sensed = Sensed(frame, looked, near, felt, pool, things, settings.occluders)
    if not sensed.told_apart:
        near = sensed.rows_at(start, settings.side)
        sensed = replace(sensed, seen=near)
    prior = loose(predicted.pose, predicted.own, settings)
    fit = fitted(model, near, _touching(felt), start, freed(prior, known.part), how.steps)
    measured = known.measured(model, fit, predicted.pose)
    residuals = contact_residuals(model, felt.contacts, fit, first.verdict, felt.of_finger)
    share, rms = pixel_agreement(model, near, fit)
    sight = float(Sight(frame, model, beliefs.depth, first.sight).costs(fit[None])[0])
    step = se3.difference(measured.pose, predicted.pose, model.centroid)
    surprise, told = surprise_of(step, predicted.own + measured.own, measured.hidden)
    changed, surprised = _otherwise(known, share, sight, _apart(residuals), how), False
    if not changed and surprise > how.surprise:
        changed, surprised = f"a surprise of {surprise:.0f} (chi-square)", True
    if not changed and settings.is_far(told):  # a fit of few pixels goes part of the way only
        changed, surprised = f"{1e3 * np.linalg.norm(told[3:]):.0f} mm from the prediction", True
    return Glanced(sensed, measured, residuals, share, rms, changed, surprised)


def as_judged(
    model: ObjectModel, known: Known, carried: Hypotheses, belief: Belief, glanced: Glanced, settings: TrackSettings
) -> Judged:
    """What the last look in full said holds of this frame, too, as far as the belief is sure of it."""
    confident = settings.first.confidence
    nearest = settings.nearest if glanced.sensed.told_apart else confident.seen.nearest
    part = weights(carried, settings.hypotheses)
    modes = (
        Mode(belief.pose, float(part[0]), 0.0, belief.covariance),
        *(Mode(h.pose, float(w), carried[0].score - h.score, h.covariance) for h, w in zip(carried[1:], part[1:])),
    )
    near = within(model, belief.pose, belief.covariance, confident.tolerance, nearest)
    word, why, sure = known.verdict, known.why, known.right * near
    if word == "ok" and sure < confident.sure:
        word, why = "ambiguous", f"only {sure:.0%} sure to be within {1e3 * confident.tolerance:.3g} mm"
    covariance = as_open(model, modes, word, known.right, settings)
    return Judged(
        word, why, covariance, known.right, sure, modes, glanced.residuals, glanced.share, glanced.rms,
        known.visible, known.unobservable,
    )  # fmt: skip


def steadied(
    model: ObjectModel,
    prior: Prior,
    sensed: Sensed,
    measured: Measurement,
    before: Known | None,
    settings: TrackSettings,
) -> Steadied:
    """A frame that was looked at in full, and solved as `measured`, by what looks have in common; prior: of its own
    answer; before: of the looks until then, None where it is the first.
    """
    centre = se3.apply(measured.pose, model.centroid[None])[0]
    if not len(sensed.looked.pixels):
        before = None  # what touch alone is solved as says nothing of a camera's errors
    weight = 1.0 / max(float(np.trace(measured.own[3:, 3:])), _SUREST**2)
    total = weight + (0.0 if before is None else settings.glance.memory * before.weight)
    correction, share = sensed.felt.correction, weight / total
    if before is not None:
        step = se3.difference(correction, before.correction, centre)
        correction = se3.perturb(before.correction, share * step, centre)
    touching = _touching(sensed.felt.corrected(correction))
    part = part_counted(model, tables.stack(sensed.seen, touching), measured)
    held = freed(prior, part)
    fit = fitted(model, sensed.seen, touching, measured.pose, held, settings.glance.steps)
    fit = model.symmetries.nearest(fit, measured.pose)
    offset = se3.difference(measured.pose, fit, model.centroid)
    if before is not None:
        offset = before.offset + share * (offset - before.offset)
    measured = replace(measured, pose=se3.perturb(fit, offset, model.centroid))
    return Steadied(fit, offset, correction, total, measured, part)


def known_of(
    model: ObjectModel,
    looked: Steadied,
    sensed: Sensed,
    said: Judged,
    beliefs: Beliefs,
    settings: TrackSettings,
) -> Known | None:
    """What a frame that was looked at in full is worth to the next. None without an image, or where it was lost."""
    frame, felt, first, measured = sensed.viewed, sensed.felt, settings.first, looked.measured
    if frame.depth is None or said.verdict == "lost":
        return None
    felt = felt.corrected(looked.correction)
    share, _ = pixel_agreement(model, sensed.seen, looked.fit)
    sight = float(Sight(frame, model, beliefs.depth, first.sight).costs(looked.fit[None])[0])
    off = _apart(contact_residuals(model, felt.contacts, looked.fit, first.verdict, felt.of_finger))
    return Known(
        frame.index, measured.pose, looked.offset, looked.weight,
        measured.own, measured.shared, measured.biased, measured.hidden, looked.correction, share, sight, off,
        said.verdict, said.why, said.right, said.visible, said.unobservable, looked.part,
    )  # fmt: skip


def part_counted(model: ObjectModel, rows: Evidence, measured: Measurement) -> float:
    """The part, up to 1, that rows count of what the whole solution of a look takes of them for its own noise.

    Rows are weighed down for the errors that neighbours share, most where nothing tells what hides the object. Of the
    direction that counts least: it is what a prior holds.
    """
    if not len(rows):
        return 1.0
    told = align(model, rows, measured.pose[None], None, AlignSettings(iterations=0)).hessians[0]
    sizes, axes = np.linalg.eigh(measured.own)
    root = axes * np.sqrt(np.maximum(sizes, 0.0))
    return float(np.clip(np.linalg.eigvalsh(root.T @ told @ root)[0], LEAST_PART, 1.0))


def freed(prior: Prior, part: float) -> Prior:
    """A prior beside rows that count by a part of what they tell: it counts by the same. A whole one holds a fit to the
    prediction, which a filter would take for a measurement of its own.
    """
    return Prior(prior.pose, part * prior.information)


def fitted(model: ObjectModel, seen: Evidence, felt: Evidence, start: Array, prior: Prior, steps: int) -> Array:
    """(4, 4) pose of the rows alone, from `start` (4, 4)."""
    rows = tables.stack(seen, felt)
    if not len(rows):
        return start
    return np.asarray(align(model, rows, start[None], prior, AlignSettings(iterations=steps)).poses[0])


def surprise_of(step: Array, own: Array, hidden: Array) -> tuple[float, Array]:
    """How surprising (chi-square, 6 degrees of freedom) a step (6,) from a prediction is that is known to own (6, 6),
    and the part (6,) of it that a frame tells, which leaves hidden (6, 6) open beside that.

    What is left open, as the turn of a handle that is out of sight, a fit has by chance.
    """
    weighed = np.linalg.solve(own + hidden, step)
    return float(step @ weighed), np.asarray(step - hidden @ weighed)


def _touching(felt: Felt) -> Evidence:
    """What fingers that touch say; that links do not fill the object's place adds little to a pose that is known."""
    rows = felt.rows
    return rows.take(rows.on)


def _apart(residuals: Sequence[ContactResidual]) -> float:
    """Root mean square (mm) of how far contacts are off; 0 without any."""
    if not residuals:
        return 0.0
    return float(np.sqrt(np.mean([min(abs(r.residual_mm), _FALSE) ** 2 for r in residuals])))


def _otherwise(known: Known, share: float, sight: float, felt: float, settings: GlanceSettings) -> str:
    """What asks for a look in full, in words; share, sight, felt: as in `Known`, now."""
    s = settings
    if np.isfinite(known.share) != np.isfinite(share) or share < known.share - s.fewer:
        return f"{share:.0%} of the pixels explained, {known.share:.0%} before"
    if sight > known.sight + s.sight:
        return f"the image says {sight - known.sight:.0f} nats less for it"
    if felt > known.felt + s.contacts:
        return f"contacts are {felt:.1f} mm off, {known.felt:.1f} before"
    return ""
