"""What came with a frame and is contradicted by the rest of it: a start, a mask, the hand, the sign of normals.

A statement is believed while it may be true. Where the answer that believes it is contradicted, the frame is asked
again without it, or with less of it, and an answer that is sure without it is taken, and says so. Camera frame, metres,
radians.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fusion.estimation.answer import Estimate
from fusion.estimation.asked import Asked
from fusion.estimation.steps.doubts.question import Ask, Change, Question
from fusion.estimation.steps.doubts.settings import DoubtSettings
from fusion.estimation.steps.doubts.start import (
    far_from,
    in_doubt,
    in_view,
    is_same,
    is_surer,
    least_by,
    off_start,
    start_of,
    with_usual_start,
    without_its_start,
    without_start,
)
from fusion.estimation.steps.sense import Sensed
from fusion.estimation.trace import Trace
from scenes.evidence.modes import Mode
from scenes.geometry import poses as se3
from scenes.geometry.cameras import Camera
from scenes.geometry.objects import ObjectModel
from scenes.recordings.beliefs import CalibrationModel, usual_beliefs
from scenes.recordings.frames import Contacts, Frame
from scenes.words import counted
from vision.contour.evidence import UNREGISTERED
from vision.look.hand.hand import HandView
from vision.look.looked import Looked
from vision.plausibility import hand_doubts, is_displaced, share_seen_past
from vision.visibility import visibility

Array = NDArray[np.float64]

# Statements by name, as the trace has them.
SO_SURE, THE_START = "so sure a start", "the start"
# Why an answer is in doubt, in words.
ALONE = "the start alone speaks for it: without one it is likelier elsewhere, or turned"
UNSURE = "it is not where the start has it, and without one it may be elsewhere"


@dataclass(frozen=True)
class _Tried:
    """A question without some statements: its answer, what that is from, and the answer whose notes say what is not
    believed; whether it is elsewhere than the first, likelier than that, and may stand for it.
    """

    question: Question
    other: Estimate
    sensed: Sensed
    noted: Estimate
    elsewhere: bool
    likely: bool
    stands: bool

    @property
    def bare(self) -> bool:
        """Whether it was asked without a start."""
        return self.question.asked.prior is None

    @property
    def sure(self) -> bool:
        """Whether it takes the first answer's place."""
        return self.stands and self.other.verdict == "ok"


def doubted(
    model: ObjectModel, first: Question, looked: Looked, answered: tuple[Estimate, Sensed], ask: Ask, trace: Trace
) -> Estimate:
    """The answer, or one without what it contradicts: each statement alone is left out first, then all of them.

    looked: before anything was left out. answered: the answer, and what it is from.
    """
    answer, sensed = answered
    rival = without_its_start(model, first.asked, sensed, answer, trace)
    changes = dict(_doubts(model, first, looked, answer, rival)) if not trace.over_budget else {}
    why_not = "" if changes else "nothing that was told is contradicted"
    tried: list[_Tried] = []
    with trace.stage("doubt", bool(changes), why_not) as stage:
        orders = [(name,) for name in changes]
        # a start that is left is not believed less, too
        every = tuple(name for name in changes if name != SO_SURE or THE_START not in changes)
        for names in (*orders, every) if len(every) > 1 else orders:
            if trace.over_budget or (tried and tried[-1].sure):
                break
            tried.append(_try(model, first, looked, answer, [changes[name] for name in names], ask, rival is not None))
            if tried[-1].sure:
                stage.note(0, f"without {' and '.join(names)}")
        if not (tried and tried[-1].sure):
            stage.note(0, f"no surer without {', '.join(changes)}")
    if tried and tried[-1].sure:
        last = tried[-1]
        # of a start that is believed less, the same is asked again
        less = not last.bare and last.question.asked.prior is not first.asked.prior
        return doubted(model, last.question, looked, (last.noted, last.sensed), ask, trace) if less else last.noted
    unsure = [one for one in tried if one.other.verdict == "ambiguous"]
    if rival is not None and any(one.likely and one.bare for one in tried):
        for one in unsure:
            if one.stands and (not one.bare or is_same(model, first.asked, rival, one.other)):
                return one.noted
        return in_doubt(model, first.asked, answer, rival, ALONE)
    start, most = start_of(first.asked), first.asked.settings.doubt.start
    if start is None or answer.verdict != "ok" or off_start(model, answer.pose, start) <= most:
        return answer
    for one in unsure:
        likely = one.other.modes[0].cost <= _by_rest(model, first.asked, answer) + first.asked.settings.doubt.likelier
        if one.bare and one.elsewhere and likely:
            return one.noted if one.stands else in_doubt(model, first.asked, answer, one.other.modes[0], UNSURE)
    return replace(answer, notes=(*answer.notes, f"the start is wrong: {far_from(model, answer, start)}"))


def _try(
    model: ObjectModel, first: Question, looked: Looked, answer: Estimate, changes: list[Change], ask: Ask, rival: bool
) -> _Tried:
    """The first question, changed, and its answer beside the first. rival: whether something else is likelier there."""
    question, said = first, []
    for change in changes:
        question = change(question)
        said.append(question.said)
    other, sensed = ask(question)
    noted = replace(other, notes=(*other.notes, *(words(other) for words in said)))
    elsewhere = not is_same(model, first.asked, answer, other)
    # a start that leads where none leads is not left for what its own search has missed
    likely = (elsewhere or not rival) and _is_likelier(model, first, question, answer, other)
    stands = likely and _may_stand(model, first, looked, question, answer, other, rival)
    return _Tried(question, other, sensed, noted, elsewhere, likely, stands)


def on_the_hand(question: Question, looked: Looked) -> tuple[Question, tuple[str, ...]]:
    """The question without contacts of the hand's sensors that are far from the hand where it is seen, and a note."""
    frame, asked, hand = question.frame, question.asked, looked.seen_hand
    if hand is None or frame.hand is None or "touch" not in asked.senses or not len(frame.contacts):
        return question, ()
    places = se3.apply(hand.correct() @ frame.camera_from_world, frame.contacts.points)
    own = np.isin(frame.contacts.sensors, [*frame.hand.sensors, *frame.hand.link_names])
    far = own & ~hand.nearer(places, asked.settings.doubt.astray)
    if not far.any() or hand_doubts(asked.viewed, hand, asked.beliefs.calibration, asked.settings.plausibility):
        return question, ()

    def kept(frame: Frame) -> Frame:
        return replace(frame, contacts=frame.contacts.take(~far))

    beyond = f"{1e3 * asked.settings.doubt.astray:g} mm from the hand's surface, where it is seen"
    note = f"{int(far.sum())} of {counted(len(far), 'contact')} left out: farther than {beyond}"
    return Question(kept(frame), replace(asked, viewed=kept(asked.viewed))), (note,)


def _doubts(
    model: ObjectModel, question: Question, looked: Looked, answer: Estimate, rival: Mode | None = None
) -> Iterable[tuple[str, Change]]:
    """What is contradicted, by name, and how to ask without it; what is cheapest to believe otherwise first."""
    frame, asked, s = question.frame, question.asked, question.asked.settings.doubt
    start = start_of(asked)
    off = off_start(model, answer.pose, start) if start is not None else 0.0
    contradicted = start is not None and (off > s.start or rival is not None)
    if answer.verdict == "ok" and not contradicted:
        return
    if start is not None and (contradicted or answer.verdict != "ok") and is_surer(start, asked):
        yield SO_SURE, with_usual_start(model)
    if answer.verdict == "ok":
        yield THE_START, without_start(model)
        return
    if _inward(model, frame, answer, s) and "touch" in asked.senses:
        yield "the normals' sign", _with_normals_turned
    if frame.mask is not None and "vision" in asked.senses and _beside_mask(model, question, looked, answer):
        yield "the mask", _without_mask(model)
    if looked.hand is not None and "vision" in asked.senses and _elsewhere(asked, looked.hand):
        yield "the hand", _without_hand
    if answer.verdict == "lost" and "touch" in asked.senses and _with_usual_calibration(question) is not question:
        yield "so sure a calibration", _with_usual_calibration
    if start is not None and (contradicted or answer.verdict == "lost") and in_view(model, frame, start):
        yield THE_START, without_start(model)


def _inward(model: ObjectModel, frame: Frame, answer: Estimate, s: DoubtSettings) -> bool:
    """Whether the contacts lie on the surface, and their normals point into the object."""
    felt = frame.contacts.moved(frame.camera_from_world)
    if not felt.has_normal.any():
        return False
    felt = felt.take(felt.has_normal)
    seen_at = answer.pose
    local = se3.apply(se3.inverse(seen_at), felt.points)
    near = np.abs(model.field.distance(local)) < s.near_surface
    turned = np.einsum("ij,ij->i", felt.normals, model.field.normals(local) @ seen_at[:3, :3].T) < np.cos(s.inward)
    fingers = len({name for name, is_near in zip(felt.sensors, near & turned) if is_near})
    return bool(fingers >= s.fewest_inward and (near & turned).sum() >= s.most_inward * len(felt))


def _with_normals_turned(question: Question) -> Question:
    def turned(frame: Frame) -> Frame:
        c = frame.contacts
        out = Contacts(c.points, -c.normals, c.sigma_point, c.sigma_normal, c.sensors, c.forces, c.sigma_told)
        return replace(frame, contacts=out)

    asked = replace(question.asked, viewed=turned(question.asked.viewed))
    said = "the contacts' normals point into the object: they are taken the other way round"
    return Question(turned(question.frame), asked, lambda answer: said)


def _beside_mask(model: ObjectModel, question: Question, looked: Looked, answer: Estimate) -> bool:
    """Whether the mask is not this object's outline, or nothing in it can be the object's."""
    bare = _bare(model, question, answer)
    return bare > question.asked.settings.verdict.most_bare or not len(looked.pixels) or answer.verdict == "lost"


def _bare(model: ObjectModel, question: Question, answer: Estimate) -> float:
    seen_at = answer.pose if answer.as_seen is None else answer.as_seen
    return visibility(question.asked.viewed, model, seen_at, question.asked.beliefs.depth).bare


def _without_mask(model: ObjectModel) -> Change:
    def change(question: Question) -> Question:
        frame, viewed = (replace(one, mask=None) for one in (question.frame, question.asked.viewed))

        def said(answer: Estimate) -> str:
            bare = _bare(model, question, answer)
            beside = f"{bare:.0%} of its inside is not the object" if np.isfinite(bare) else "nothing is in it"
            return f"the mask is not believed: {beside}"

        return Question(frame, replace(question.asked, viewed=viewed), said)

    return change


def _without_hand(question: Question) -> Question:
    def bare(frame: Frame) -> Frame:
        return replace(frame, hand=None, joints=None, world_from_hand=None)

    asked = replace(question.asked, viewed=bare(question.asked.viewed))
    return Question(
        bare(question.frame), asked, lambda answer: "the hand is not believed: it is not seen where it is told"
    )


def _elsewhere(asked: Asked, hand: HandView) -> bool:
    """Whether a hand is not what is seen, or is seen beside where it is told. Where it is nearer or farther, its depth
    may be right and the camera's wrong: it is believed, unless contacts have to agree with what the camera says then.
    """
    beliefs, rules = asked.beliefs, asked.settings.plausibility
    if share_seen_past(asked.viewed, hand, rules) > rules.most_past:
        return True
    away = float(np.linalg.norm(hand.centre))
    along = abs(float(hand.xi[3:] @ hand.centre)) / max(away, 1e-9)
    depth = np.hypot(beliefs.depth.scale_sigma * away, beliefs.depth.bias_sigma)
    felt = "touch" in asked.senses and len(set(asked.viewed.contacts.sensors)) > 1
    return is_displaced(hand, beliefs.calibration, rules) and (felt or along < asked.settings.doubt.along * depth)


def _with_usual_calibration(question: Question) -> Question:
    beliefs, usual = question.asked.beliefs, usual_beliefs()
    told, known = beliefs.calibration, usual.calibration
    calibration = CalibrationModel(
        max(told.translation_sigma, known.translation_sigma), max(told.rotation_sigma, known.rotation_sigma)
    )
    if calibration == told:
        return question
    asked = replace(question.asked, beliefs=replace(beliefs, calibration=calibration))
    said = "the calibration is not as good as told"
    return Question(question.frame, asked, lambda answer: said)


def _is_likelier(model: ObjectModel, first: Question, question: Question, answer: Estimate, other: Estimate) -> bool:
    """Whether another question's answer is likelier, by all but the start, than one that it alone may speak for; one
    that is not sure, or has the start's own sigmas contradicted, need not be.
    """
    start, left, s = start_of(first.asked), question.asked.prior, first.asked.settings.doubt
    if start is None or left is first.asked.prior or (answer.verdict != "ok" and other.verdict == "ok"):
        return True
    off = off_start(model, answer.pose, start)
    if left is not None and off > s.start:
        return True
    least = s.likelier if left is not None else least_by(model, answer, start, s)
    return _by_rest(model, question.asked, other) <= _by_rest(model, first.asked, answer) - least


def _by_rest(model: ObjectModel, asked: Asked, answer: Estimate) -> float:
    """Nats of an answer by all but the start that it was asked with."""
    start = start_of(asked)
    return answer.modes[0].cost - (0.0 if start is None else 0.5 * off_start(model, answer.pose, start))


def _may_stand(
    model: ObjectModel,
    first: Question,
    looked: Looked,
    question: Question,
    answer: Estimate,
    other: Estimate,
    kept: bool = False,
) -> bool:
    """Whether another question's answer is of the thing that was meant: felt, near a start, in the mask or in the hand;
    where the start alone keeps an answer where it is (kept), the same thing another way round.
    """
    settings = first.asked.settings.doubt
    mask = first.asked.viewed.mask
    said_by_mask, said_by_start = mask is not question.asked.viewed.mask, question.asked.prior is not first.asked.prior
    if said_by_mask and any(UNREGISTERED in note for note in other.notes):
        return False  # image and mask together say that it is depth that lies beside
    if other.contacts or question.asked.prior is not None or not (said_by_mask or said_by_start):
        return True
    if kept and _between(model, answer.pose, other.pose) < model.radius:
        return True  # the same thing, another way round
    seen_at = other.pose if other.as_seen is None else other.as_seen
    points = se3.apply(seen_at, model.vertices[:: max(1, len(model.vertices) // 500)])
    if mask is not None and mask.any():
        return _share_within(mask, first.asked.viewed.camera, points) >= settings.within_mask
    hand = looked.seen_hand
    return hand is not None and hand.gap(points) < settings.in_hand


def _between(model: ObjectModel, pose: Array, other: Array) -> float:
    """Metres between the object's middle at two poses (4, 4)."""
    here, there = (se3.apply(one, model.centroid[None])[0] for one in (pose, other))
    return float(np.linalg.norm(here - there))


def _share_within(mask: NDArray[np.bool_], camera: Camera | None, points: Array) -> float:
    """Share of camera-frame points (n, 3) before the camera and in the image that are in a mask."""
    if camera is None:
        return 0.0
    pixels, depth = camera.project(points)
    u, v = np.round(pixels[depth > 0]).astype(int).T
    inside = (u >= 0) & (v >= 0) & (u < camera.width) & (v < camera.height)
    return float(mask[v[inside], u[inside]].mean()) if inside.any() else 0.0
