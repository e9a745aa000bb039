"""A start: how far answers are from it, whether it alone speaks for one, and how to ask without it.

Camera frame, metres, radians.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fusion.estimation.answer import Estimate
from fusion.estimation.asked import Asked, as_prior
from fusion.estimation.posterior.whole import whole_covariance
from fusion.estimation.steps.doubts.question import Change, Question
from fusion.estimation.steps.doubts.settings import DoubtSettings
from fusion.estimation.steps.sense import Sensed
from fusion.estimation.trace import Trace
from scenes.evidence.align import Prior
from scenes.evidence.modes import Mode, displaced
from scenes.evidence.symmetry.alike import alike
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.checking.validation import FARTHEST_HELD
from scenes.recordings.frames import Frame

Array = NDArray[np.float64]


def start_of(asked: Asked) -> Prior | None:
    """The start, where there is one that may be doubted."""
    return asked.prior if np.isfinite(asked.settings.doubt.start) else None


def off_start(model: ObjectModel, pose: Array, start: Prior) -> float:
    """Squared distance of a pose from a start, in its standard deviations; the nearest of the object's symmetries."""
    delta = _from_start(model, pose, start)
    return float(delta @ start.information @ delta)


def _from_start(model: ObjectModel, pose: Array, start: Prior) -> Array:
    """(6,) how far, by turn and move, a pose is from a start; the nearest of the object's symmetries."""
    if model.symmetries.is_spherical:  # turns tell nothing of a ball
        return np.asarray(se3.difference(pose, start.pose, model.centroid)) * np.repeat([0.0, 1.0], 3)
    delta = se3.difference(pose @ model.symmetries.poses(), start.pose, model.centroid)
    return np.asarray(delta[np.argmin(np.einsum("ni,ij,nj->n", delta, start.information, delta))])


def in_view(model: ObjectModel, frame: Frame, start: Prior) -> bool:
    """Whether a start is where a camera can see the object: behind it, or at its lens, it is no place but a mistake."""
    depth = float(se3.apply(start.pose, model.centroid[None])[0, 2])
    return frame.camera is None or model.radius < depth < FARTHEST_HELD


def _usual(start: Prior, asked: Asked) -> Prior:
    """The same start, as wide as one of which nothing is told."""
    usual = as_prior(start.pose, asked.settings)
    assert usual is not None
    return usual


def is_surer(start: Prior, asked: Asked) -> bool:
    """Whether a start says more, in some direction, than one of which nothing is told; by more than half of it."""
    usual = np.sqrt(np.diag(_usual(start, asked).information))
    return bool(np.linalg.eigvalsh(start.information / usual / usual[:, None])[-1] > 4.0)


def with_usual_start(model: ObjectModel) -> Change:
    """The start is as wide as one of which nothing is told."""

    def change(question: Question) -> Question:
        start = question.asked.prior
        assert start is not None
        asked = replace(question.asked, prior=_usual(start, question.asked))
        return Question(
            question.frame, asked, lambda answer: f"the start is not as sure as told: {far_from(model, answer, start)}"
        )

    return change


def without_start(model: ObjectModel) -> Change:
    """There is no start."""

    def change(question: Question) -> Question:
        start = question.asked.prior
        assert start is not None
        frame, viewed = (replace(one, prior=None) for one in (question.frame, question.asked.viewed))
        asked = replace(question.asked, prior=None, viewed=viewed)
        return Question(frame, asked, lambda answer: f"the start is not believed: {far_from(model, answer, start)}")

    return change


def far_from(model: ObjectModel, answer: Estimate, start: Prior) -> str:
    """How far an answer is from a start, in words."""
    delta = _from_start(model, answer.pose, start)
    turn, move = np.rad2deg(np.linalg.norm(delta[:3])), 1e3 * np.linalg.norm(delta[3:])
    return f"the object is found {move:.0f} mm and {turn:.0f} degrees from it"


def without_its_start(model: ObjectModel, asked: Asked, sensed: Sensed, answer: Estimate, trace: Trace) -> Mode | None:
    """What is likelier than an answer by all that is sensed, by more than its start may say: where the search ended,
    let go of the start, or turned to what looks nearly alike. None where a start does not keep an answer where it is.

    sensed: what the answer is from. A Gaussian start of 10 degrees says with 160 nats that a thing is not the other way
    round, and a search near it looks at nothing else; starts are wrong by half a turn far more often.
    """
    start, settings, end = start_of(asked), asked.settings, answer.searched
    pool, why_not = replace(sensed.pool, prior=None), ""
    if start is None or end is None or answer.verdict == "lost":
        why_not = "there is no start, or no answer"
    elif off_start(model, answer.pose, start) > settings.doubt.start:
        why_not = "the answer has left the start"
    elif trace.over_budget:
        why_not = "over the time budget"
    elif len(sensed.seen) and not pool.predictor.sees:
        why_not = "no picture says what a cloud must show"
    with trace.stage("without the start", not why_not, why_not) as stage:
        if why_not or start is None or end is None:
            return None
        here, least = float(pool.costs(end[None])[0]), least_by(model, answer, start, settings.doubt)
        turned = pool.turned(Mode(end, 1.0, here - least, answer.modes[0].covariance), settings.doubt.turned)
        # most slide back to where they were turned from
        turned = turned[displaced(model, turned, end) >= settings.modes.merge_share * model.radius]
        turned = turned[np.argsort(pool.walking(turned), kind="stable")[: settings.doubt.turned_fitted]]
        # one as wide as a usual start holds nothing against all that is sensed, but its way round
        free = np.concatenate([end[None], turned]) if is_surer(start, asked) else turned
        if not len(free):
            return None
        freed = pool.fitted(free)
        more = float(freed.costs[0]) - here
        stage.note(len(free), f"{max(-more, 0.0):.1f} nats likelier at best, {least:.1f} would count")
    if more >= -least:
        return None
    # as wide as the answer: how wide it is by itself, only asking without the start tells
    return Mode(freed.poses[0], 1.0, answer.modes[0].cost + more, answer.modes[0].covariance)


def in_doubt(model: ObjectModel, asked: Asked, answer: Estimate, rival: Mode, why: str) -> Estimate:
    """An answer, but not as a sure one: a rival may be the case as well. why: in words."""
    if answer.verdict != "ok":
        return answer
    # where both have their surface at the same place, either is right
    near = alike(model, (answer.modes[0], rival), asked.settings.confidence.tolerance).near
    share = 1.0 if len(near) > 1 else 0.5
    halves = [replace(mode, weight=0.5 * mode.weight) for mode in answer.modes]
    modes = (halves[0], replace(rival, weight=0.5), *halves[1:])
    return replace(
        answer,
        verdict="ambiguous",
        modes=modes,
        covariance=whole_covariance(model, modes, 0.0, asked.prior, asked.settings.confidence),
        confidence=min(share * answer.confidence, asked.settings.verdict.most_doubted),
        notes=(why, *answer.notes),
    )


def is_same(model: ObjectModel, asked: Asked, one: Mode | Estimate, other: Estimate) -> bool:
    """Whether two poses go on as one."""
    return float(displaced(model, one.pose[None], other.pose)[0]) < asked.settings.modes.merge_share * model.radius


def least_by(model: ObjectModel, answer: Estimate, start: Prior, s: DoubtSettings) -> float:
    """Nats by which something else must be likelier than an answer, by all but the start, for a start that speaks for
    the answer to be wrong: one that is contradicted says as much as at the limit from which on it is, and no more.
    """
    return s.likelier + 0.5 * max(s.start - off_start(model, answer.pose, start), 0.0)
