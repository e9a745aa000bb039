"""What one frame's senses say before anything is searched, and the joint solution that ends a search.

The steps that an estimate and the judging of given poses share. Camera frame, metres, radians.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fusion.estimation.answer import Estimate
from fusion.estimation.asked import Asked
from fusion.estimation.ranking import guarded, joint_costs
from fusion.estimation.search.pool import Pool
from fusion.estimation.solve.joint import JointResult
from fusion.estimation.solve.problem import JointProblem
from fusion.estimation.solve.rigs import solve_modes
from fusion.estimation.steps.another import another_meant
from fusion.estimation.trace import Trace
from scenes.evidence import table as tables
from scenes.evidence.table import Evidence
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Frame
from scenes.words import counted
from touch.contacts import Felt, feel
from touch.held import Held
from vision.look.colours import parted_by_colour
from vision.look.hand.hand import HandView, camera_from_hand
from vision.look.look import LookSettings, among_others, coloured_pieces, look, surfaces
from vision.look.looked import Looked
from vision.look.pixels import Pixels
from vision.picture.predictor import Predictor
from vision.sight import Sight

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Sensed:
    """A frame's evidence: viewed and touched are the frame with what each sense may use; seen: vision's rows, rows: all
    of them; hand: where the robot's own is seen; pool: judges poses, sight quickly.
    """

    frame: Frame
    viewed: Frame
    touched: Frame
    looked: Looked
    felt: Felt
    seen: Evidence
    rows: Evidence
    sight: Sight
    pool: Pool

    @property
    def hand(self) -> HandView | None:
        """The robot's own hand, when enough of it is seen."""
        return self.looked.seen_hand

    @property
    def contacts(self) -> int:
        """How many contacts there are."""
        return len(self.felt.reported_contacts)

    @property
    def nothing(self) -> bool:
        """Whether nothing tells where the object is: emptiness alone tells where it is not."""
        return len(self.rows) == 0 or (self.pool.prior is None and not len(self.looked.pixels) and not self.contacts)


def look_once(model: ObjectModel, asked: Asked, trace: Trace) -> Looked:
    """What the camera saw, once for all that is asked about it."""
    settings, start = asked.settings.look, asked.prior.pose if asked.prior is not None else None
    with trace.stage("look", "vision" in asked.senses, "vision not asked for") as stage:
        looked = look(asked.viewed, model, asked.beliefs, start, settings)
        count = len(looked.rows(asked.beliefs.depth, settings.rows))
        stage.note(count, f"{len(looked.pixels)} object pixels, {len(looked.of_hand)} of the hand{looked.how}")
    return looked


def look_again(model: ObjectModel, asked: Asked, trace: Trace, looked: Looked, answer: Estimate) -> Looked | None:
    """What the camera saw, where an answer leaves much of what was taken for the object unexplained: then something
    else is at the hand, and nobody says what hides the object; or where nothing is at the hand: then the object may be
    anywhere. None where nothing speaks for that.
    """
    settings, hand = asked.settings.look, looked.hand
    told = looked.at_hand or looked.at_touch or looked.empty
    why_not = "what is the object's is not told by the hand" if not told or hand is None else ""
    if not why_not and answer.verdict == "ok":
        why_not = "the answer is ok"
    left = 0.0 if why_not or looked.empty else unexplained(model, looked, _seen_at(answer), settings)
    if not why_not and not looked.empty and left < settings.other_share:
        why_not = "the answer explains what was taken for the object"
    elif not why_not and trace.over_budget:
        why_not = "the time budget is spent"
    with trace.stage("look again", not why_not, why_not) as stage:
        if why_not or hand is None:
            return None
        found = among_others(asked.viewed, model, hand, asked.beliefs, settings, anywhere=looked.empty)
        count = len(found.rows(asked.beliefs.depth, settings.rows))
        why = "nothing is at the hand" if looked.empty else f"{left:.0%} of it are something else's"
        stage.note(count, f"{why}; {len(found.pixels)} object pixels{found.how}")
    return found


def without_copy(model: ObjectModel, asked: Asked, looked: Looked, answer: Estimate, trace: Trace) -> Asked | None:
    """The question without readings of what is at an answer, where a hand that is known holds another like it and not
    that; None elsewhere: what is likelier by its picture alone is not what is meant.
    """
    frame, settings = asked.viewed, asked.settings.another
    if trace.over_budget or frame.depth is None or frame.camera is None or not another_meant(answer.modes, settings):
        return None
    held = _held(asked.viewed, looked.seen_hand)
    if held is None:
        return None
    here, there = (held.gap(model, mode.pose) for mode in answer.modes[:2])
    if there >= settings.held or here - there <= settings.held:
        return None
    inverse, own = se3.inverse(_seen_at(answer)), max(settings.own, settings.own_share * model.radius)
    points = frame.camera.rays().reshape(-1, 3) * frame.depth.reshape(-1, 1)
    near = np.flatnonzero(np.linalg.norm(points - _seen_at(answer)[:3, 3], axis=1) < model.diameter + own)
    depth = frame.depth.copy()
    depth.reshape(-1)[near[np.abs(model.field.distance(se3.apply(inverse, points[near]))) < own]] = 0.0
    return replace(asked, viewed=replace(frame, depth=depth))


def unexplained(model: ObjectModel, looked: Looked, seen_at: Array, settings: LookSettings) -> float:
    """Share of the object's pixels that are on no surface of it where the image shows it, seen_at (4, 4), farther off
    than parts two things.
    """
    points = looked.pixels.points
    if not len(points):
        return 0.0
    off = np.abs(model.field.distance(se3.apply(se3.inverse(seen_at), points)))
    return float((off > np.maximum(settings.mask.step, settings.mask.step_share * points[:, 2])).mean())


def _seen_at(answer: Estimate) -> Array:
    """(4, 4) Where the image as it is shows the object of an answer."""
    return answer.pose if answer.as_seen is None else answer.as_seen


def sense(frame: Frame, model: ObjectModel, asked: Asked, trace: Trace, looked: Looked) -> Sensed:
    """Feel, and lay out what judges poses."""
    settings, beliefs, believed = asked.settings, asked.beliefs, asked.prior
    viewed = asked.viewed
    touched = frame if "touch" in asked.senses else frame.without_touch()
    seen = looked.rows(beliefs.depth, settings.look.rows)
    with trace.stage("feel", "touch" in asked.senses, "touch not asked for") as stage:
        hand = looked.seen_hand
        shown = len(seen) > 0
        correction = hand.correct() if hand is not None else None
        felt = feel(touched, correction, beliefs, looked.region, settings.touch, beside_vision=shown)
        contacts = len(felt.reported_contacts)
        stage.note(
            len(felt.reported_rows),
            f"{counted(contacts, 'contact')}, {counted(len(felt.reported_rows) - contacts, 'empty point')}",
        )
    sight = Sight(viewed, model, beliefs.depth, settings.sight)
    # where neither mask nor hand tells what hides the object, what is seen may be that
    unknown = not looked.told_apart and viewed.depth is not None
    with trace.stage("colours", unknown, "nothing is to be told apart") as stage:
        parted = _parted(viewed, looked, model, asked) if unknown else Parted()
        stage.note(parted.parts, f"surfaces parted into {parted.parts}" if parted.parts else parted.why_not)
    known = looked.planes, parted.numbers, parted.parts, looked.floors
    predictor = Predictor(viewed, model, beliefs.depth, hand, settings.prediction, *known)
    asks = settings.look.rows, settings.proposals, settings.modes, settings.pool
    rng = np.random.default_rng(asked.seed)
    pool = Pool(
        model,
        felt.rows,
        contacts,
        felt.fingers,
        believed,
        predictor,
        sight,
        looked,
        beliefs.depth,
        rng,
        *asks,
        held=_held(frame, hand),
        coloured=parted.pieces,
        told=settings.told,
        each=felt.each,
    )
    return Sensed(frame, viewed, touched, looked, felt, seen, tables.stack(seen, felt.rows), sight, pool)


@dataclass(frozen=True)
class Parted:
    """Surfaces of the image: numbers (h, w), the first `parts` of them parted by colour, as Predictor takes them;
    pieces that colour proposes; why nothing is parted.
    """

    numbers: NDArray[np.int64] | None = None
    parts: int = 0
    pieces: tuple[Pixels, ...] = ()
    why_not: str = ""


def _parted(viewed: Frame, looked: Looked, model: ObjectModel, asked: Asked) -> Parted:
    """The surfaces of a frame with depth; where there is an image beside it, parted by its colours. Pieces that propose
    are made where nothing is believed of the pose.
    """
    assert viewed.camera is not None
    how, anywhere = asked.settings.look, asked.prior is None
    points, numbers = surfaces(viewed, looked.planes, asked.beliefs, how)
    if viewed.rgb is None:
        return Parted(numbers, why_not="no image beside depth")
    box = looked.region.box(viewed.camera) if looked.region is not None and not anywhere else None
    found = parted_by_colour(viewed.rgb, points, numbers, how.colour, box, anywhere)
    if found.why_not:
        return Parted(numbers, why_not=found.why_not)
    pieces = coloured_pieces(found, points, viewed.camera, model, how)
    return Parted(found.numbers, found.count, pieces)


def _held(frame: Frame, seen: HandView | None) -> Held | None:
    """The hand at its joints, where it is seen or else where the robot says that it is."""
    reported = camera_from_hand(frame)
    if frame.hand is None or frame.joints is None or reported is None:
        return None
    return Held(frame.hand, frame.joints, reported if seen is None else seen.aligned)


@dataclass(frozen=True)
class Solved:
    """Joint solutions of one frame, their costs (k,) by all that was sensed, nats, and vision's rows of each."""

    results: list[JointResult]
    costs: Array
    shown: list[Evidence]


def solve_together(sensed: Sensed, poses: list[Array], asked: Asked) -> Solved:
    """The joint solution from each of poses (4, 4), the likeliest first: it tells how large shared errors are."""
    settings, pool, hand = asked.settings, sensed.pool, sensed.hand
    shown = [pool.evidence(pose) if pool.predictor.sees else sensed.seen for pose in poses]
    known = sensed.felt.reported_rows, sensed.felt.fingers, asked.prior, hand, asked.beliefs, settings.joint
    first = JointProblem.of(pool.model, sensed.frame, shown[0], *known)
    problems = [first, *(JointProblem.of(pool.model, sensed.frame, rows, *known, first) for rows in shown[1:])]
    results = solve_modes(problems, poses)
    results = guarded(pool, results, poses, hand, settings)
    return Solved(results, joint_costs(sensed.touched, pool, results, poses, hand, sensed.sight, settings), shown)
