"""What came with a frame and is contradicted by the rest of it: a start, a mask, the hand, the sign of normals.

A statement is believed while it may be true. Where the answer that believes it is contradicted, the frame is asked
again without it, or with less of it, and an answer that is sure without it is taken, and says so. Camera frame, metres,
radians.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fusion.estimation.answer import Estimate
from fusion.estimation.asked import Asked, as_prior
from fusion.estimation.steps.doubt_settings import DoubtSettings
from fusion.estimation.trace import Trace
from scenes.evidence.align import Prior
from scenes.geometry import poses as se3
from scenes.geometry.cameras import Camera
from scenes.geometry.objects import ObjectModel
from scenes.recordings.beliefs import CalibrationModel, usual_beliefs
from scenes.recordings.checking.validation import FARTHEST_HELD
from scenes.recordings.frames import Contacts, Frame
from scenes.words import counted
from vision.contour.evidence import UNREGISTERED
from vision.look.hand.hand import HandView
from vision.look.looked import Looked
from vision.plausibility import hand_doubts, is_displaced, share_seen_past
from vision.visibility import visibility

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Question:
    """A frame and what is asked about it; said: of what is not believed in it any more, in words, at an answer."""

    frame: Frame
    asked: Asked
    said: Callable[[Estimate], str] = lambda answer: ""


Ask = Callable[[Question], Estimate]
Change = Callable[[Question], Question]


def doubted(model: ObjectModel, first: Question, looked: Looked, answer: Estimate, ask: Ask, trace: Trace) -> Estimate:
    """The answer, or one without what it contradicts: each statement alone is left out first, then all of them."""
    changes = dict(_doubts(model, first, looked, answer)) if not trace.over_budget else {}
    why_not = "" if changes else "nothing that was told is contradicted"
    with trace.stage("doubt", bool(changes), why_not) as stage:
        tried: list[tuple[Change, ...]] = [(change,) for change in changes.values()]
        if len(tried) > 1:
            tried.append(tuple(changes.values()))
        for among in tried:
            if trace.over_budget:
                break
            question, said = first, []
            for change in among:
                question = change(question)
                said.append(question.said)
            other = ask(question)
            if other.verdict == "ok" and _may_stand(model, first, looked, question, answer, other):
                stage.note(0, f"without {' and '.join(n for n, c in changes.items() if c in among)}")
                return replace(other, notes=(*other.notes, *(words(other) for words in said)))
        stage.note(0, f"no surer without {', '.join(changes)}")
    start = _start(first.asked)
    if start is None or answer.verdict != "ok" or _off(model, answer.pose, start) <= first.asked.settings.doubt.start:
        return answer
    return replace(answer, notes=(*answer.notes, f"the start is wrong: {_far(model, answer, start)}"))


def _start(asked: Asked) -> Prior | None:
    """The start, where there is one that may be doubted."""
    return asked.prior if np.isfinite(asked.settings.doubt.start) else None


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


def _doubts(model: ObjectModel, question: Question, looked: Looked, answer: Estimate) -> Iterable[tuple[str, Change]]:
    """What is contradicted, by name, and how to ask without it; what is cheapest to believe otherwise first."""
    frame, asked, s = question.frame, question.asked, question.asked.settings.doubt
    start = _start(asked)
    off = _off(model, answer.pose, start) if start is not None else 0.0
    contradicted = start is not None and off > s.start
    if answer.verdict == "ok" and not contradicted:
        return
    if start is not None and (contradicted or answer.verdict != "ok") and _is_surer(start, asked):
        yield "so sure a start", _with_usual_start(model)
    if answer.verdict == "ok":
        yield "the start", _without_start(model)
        return
    if _inward(model, frame, answer, s) and "touch" in asked.senses:
        yield "the normals' sign", _with_normals_turned
    if frame.mask is not None and "vision" in asked.senses and _beside_mask(model, question, looked, answer):
        yield "the mask", _without_mask(model)
    if looked.hand is not None and "vision" in asked.senses and _elsewhere(asked, looked.hand):
        yield "the hand", _without_hand
    if answer.verdict == "lost" and "touch" in asked.senses and _with_usual_calibration(question) is not question:
        yield "so sure a calibration", _with_usual_calibration
    if start is not None and (contradicted or answer.verdict == "lost") and _in_view(model, frame, start):
        yield "the start", _without_start(model)


def _off(model: ObjectModel, pose: Array, start: Prior) -> float:
    """Squared distance of a pose from a start, in its standard deviations; the nearest of the object's symmetries."""
    delta = _from_start(model, pose, start)
    return float(delta @ start.information @ delta)


def _from_start(model: ObjectModel, pose: Array, start: Prior) -> Array:
    """(6,) how far, by turn and move, a pose is from a start; the nearest of the object's symmetries."""
    if model.symmetries.is_spherical:  # turns tell nothing of a ball
        return np.asarray(se3.difference(pose, start.pose, model.centroid)) * np.repeat([0.0, 1.0], 3)
    delta = se3.difference(pose @ model.symmetries.poses(), start.pose, model.centroid)
    return np.asarray(delta[np.argmin(np.einsum("ni,ij,nj->n", delta, start.information, delta))])


def _in_view(model: ObjectModel, frame: Frame, start: Prior) -> bool:
    """Whether a start is where a camera can see the object: behind it, or at its lens, it is no place but a mistake."""
    depth = float(se3.apply(start.pose, model.centroid[None])[0, 2])
    return frame.camera is None or model.radius < depth < FARTHEST_HELD


def _usual(start: Prior, asked: Asked) -> Prior:
    """The same start, as wide as one of which nothing is told."""
    usual = as_prior(start.pose, asked.settings)
    assert usual is not None
    return usual


def _is_surer(start: Prior, asked: Asked) -> bool:
    """Whether a start says more, in some direction, than one of which nothing is told; by more than half of it."""
    usual = np.sqrt(np.diag(_usual(start, asked).information))
    return bool(np.linalg.eigvalsh(start.information / usual / usual[:, None])[-1] > 4.0)


def _with_usual_start(model: ObjectModel) -> Change:
    def change(question: Question) -> Question:
        start = question.asked.prior
        assert start is not None
        asked = replace(question.asked, prior=_usual(start, question.asked))
        return Question(
            question.frame, asked, lambda answer: f"the start is not as sure as told: {_far(model, answer, start)}"
        )

    return change


def _without_start(model: ObjectModel) -> Change:
    def change(question: Question) -> Question:
        start = question.asked.prior
        assert start is not None
        frame, viewed = (replace(one, prior=None) for one in (question.frame, question.asked.viewed))
        asked = replace(question.asked, prior=None, viewed=viewed)
        return Question(frame, asked, lambda answer: f"the start is not believed: {_far(model, answer, start)}")

    return change


def _far(model: ObjectModel, answer: Estimate, start: Prior) -> str:
    delta = _from_start(model, answer.pose, start)
    turn, move = np.rad2deg(np.linalg.norm(delta[:3])), 1e3 * np.linalg.norm(delta[3:])
    return f"the object is found {move:.0f} mm and {turn:.0f} degrees from it"


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


def _may_stand(
    model: ObjectModel, first: Question, looked: Looked, question: Question, answer: Estimate, other: Estimate
) -> bool:
    """Whether another question's answer may stand for the first: likelier than a sure one, where it is the start alone
    that speaks for that; and of the thing that was meant: felt, near a start, in the mask, or in the hand.
    """
    start, settings = _start(first.asked), first.asked.settings.doubt
    if answer.verdict == "ok" and start is not None and question.asked.prior is None:
        sensed = answer.modes[0].cost - 0.5 * _off(model, answer.pose, start)
        if other.modes[0].cost > sensed - settings.likelier:
            return False
    mask = first.asked.viewed.mask
    said_by_mask, said_by_start = mask is not question.asked.viewed.mask, question.asked.prior is not first.asked.prior
    if said_by_mask and any(UNREGISTERED in note for note in other.notes):
        return False  # image and mask together say that it is depth that lies beside
    if other.contacts or question.asked.prior is not None or not (said_by_mask or said_by_start):
        return True
    seen_at = other.pose if other.as_seen is None else other.as_seen
    points = se3.apply(seen_at, model.vertices[:: max(1, len(model.vertices) // 500)])
    if mask is not None and mask.any():
        return _share_within(mask, first.asked.viewed.camera, points) >= settings.within_mask
    hand = looked.seen_hand
    return hand is not None and hand.gap(points) < settings.in_hand


def _share_within(mask: NDArray[np.bool_], camera: Camera | None, points: Array) -> float:
    """Share of camera-frame points (n, 3) before the camera and in the image that are in a mask."""
    if camera is None:
        return 0.0
    pixels, depth = camera.project(points)
    u, v = np.round(pixels[depth > 0]).astype(int).T
    inside = (u >= 0) & (v >= 0) & (u < camera.width) & (v < camera.height)
    return float(mask[v[inside], u[inside]].mean()) if inside.any() else 0.0
