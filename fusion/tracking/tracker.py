"""Frame after frame: predict from the hand, look near the prediction, solve with both senses, update, judge.

    for answer in track(read_capture("captures/drill"), model):
        print(answer.frame, answer.verdict, answer.slip, answer.pose)

The first frame is `fusion.estimation.estimate.estimate`. Later ones skip the search: the object moves with palm and
fingertips, a few steps from the prediction find it, and one joint solution with camera's and robot's errors follows.
Where a frame leaves several poses open all are followed until frames decide (`hypotheses`), and now and then one is
searched as if nothing were known, so that a track that began wrong finds out (`state`). Where all goes as expected a
glance is enough (`steps.glancing`). A frame may lack either sense, come late, or hold nothing; an object that is lost
is looked for again. Camera frame, metres, radians.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from fusion.estimation.answer import Estimate
from fusion.estimation.asked import as_prior, believing, check_kinds, check_senses, each_frame
from fusion.estimation.estimate import estimate
from fusion.estimation.posterior.confidence import near_enough
from fusion.estimation.trace import Trace
from fusion.tracking.answer import NOTHING_SENSED, OUT_OF_SIGHT, TrackedEstimate, TrackSettings, as_carried, as_tracked
from fusion.tracking.filter import Belief, Measurement, after_slip, gone_on, relearned, update
from fusion.tracking.memory import hypotheses as several
from fusion.tracking.memory.hypotheses import Hypotheses
from fusion.tracking.memory.state import TrackState, is_empty
from fusion.tracking.motion import HandMotion, HandState
from fusion.tracking.slip import SlipWatch, Watched
from fusion.tracking.steps import searching
from fusion.tracking.steps.aside import ANEW, AROUND, Aside
from fusion.tracking.steps.doubts.bumped import bump, recalibrated
from fusion.tracking.steps.doubts.contradicting import NOT_HERE, without_strangers
from fusion.tracking.steps.doubts.delays import as_of_image, learn_delay, moved_on
from fusion.tracking.steps.doubts.repeated import of_now
from fusion.tracking.steps.following_hand import resting, seen_past, with_hand_or_not
from fusion.tracking.steps.glancing import as_judged, glance, known_of, may_glance, steadied
from fusion.tracking.steps.judging import as_believed, as_followed, as_learned, by_touch_alone, judge, slips_unseen
from fusion.tracking.steps.marking import mark, seen_motion
from fusion.tracking.steps.outlining import with_outline
from fusion.tracking.steps.predicting import SHOWN_ELSEWHERE, as_moved, predict, where_shown
from fusion.tracking.steps.printed import as_before, as_printed
from fusion.tracking.steps.refining import loose, measurement_of, middle_of, pixel_of, refine, shift, solve_leader
from fusion.tracking.steps.sensing import Sensed, feel_near, learn_things, pool_near
from scenes.errors import CaptureError
from scenes.evidence.align import Prior
from scenes.evidence.point_pairs import built_pair_table
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.beliefs import Beliefs
from scenes.recordings.frames import Frame
from scenes.threads import one_blas_thread
from scenes.words import counted
from touch.arrays.readings import readings_of
from touch.contacts import Felt, placed, unused_touch
from touch.gels.slip import in_palm
from vision.filling import as_measured
from vision.look.looked import Looked
from vision.look.warm import Looker
from vision.noise import believed_of
from vision.tracking.by_image import Motion
from vision.tracking.by_vision import ConstantVelocity

Array = NDArray[np.float64]


def track(
    frames: Iterable[Frame],
    model: ObjectModel,
    prior: Array | Prior | None = None,
    use: Iterable[str] = ("vision", "touch"),
    seed: int = 0,
    settings: TrackSettings | None = None,
    beliefs: Beliefs | None = None,
    sure_within: float | None = None,
) -> Iterator[TrackedEstimate]:
    """Where is the object in each of these frames?

    prior: of the first frame, as for `estimate`; default the frame's own. use: the senses allowed. Yields one answer a
    frame, in their order; a frame whose index is below its predecessors' came late: it corrects the present, and its
    answer is for its own time. beliefs: what the sensors are worth; default what the first frame says of its own.
    sure_within (m): what an answer's confidence is about, as for `estimate`.
    Raises InputError as `estimate` does.
    """
    tracker = Tracker(model, prior, use, seed, settings, beliefs, sure_within)
    for frame in each_frame(frames):
        yield tracker.step(frame)


class Tracker:
    """`track` for frames that arrive one by one. begun: whether one of them has shown the object."""

    def __init__(
        self,
        model: ObjectModel,
        prior: Array | Prior | None = None,
        use: Iterable[str] = ("vision", "touch"),
        seed: int = 0,
        settings: TrackSettings | None = None,
        beliefs: Beliefs | None = None,
        sure_within: float | None = None,
        live: bool = False,
    ) -> None:
        """As `track`. live: frames do not wait for searches, which a thread makes; answers depend on their pace."""
        check_kinds(model, seed, settings, beliefs, TrackSettings, live)
        self.model, self.live, self.begun = model, live, False
        self.settings = (settings or TrackSettings()).asked(sure_within, model)
        self._senses = check_senses(use)
        self._prior, self._seed, self._asked = as_prior(prior, self.settings.first), seed, beliefs
        self._believe(beliefs or Beliefs())
        self._hand_motion = HandMotion(model, self.settings.hand)
        self._velocity = ConstantVelocity(model.centroid, self.settings.velocity)
        self._state = TrackState()
        self._sensed: Sensed | None = None
        self._rest: Frame | None = None  # this frame, when contacts of it are left out
        self._aside: Aside | None = None  # made when a live tracker needs it, and not kept with its state

    def _believe(self, beliefs: Beliefs) -> None:
        self._beliefs = beliefs
        self._looker = Looker(self.model, self.settings.look, self.settings.first.look, beliefs)
        self._watch = SlipWatch(self.model, beliefs.depth.bias_length, self.settings.slip)

    def step(self, frame: Frame) -> TrackedEstimate:
        """The object in this frame."""
        state = self._state
        frame, unused = of_now(frame, state, self.settings, self._looker.correction is not None)
        frame, filled = as_measured(frame, self.settings.first.look.filling)
        world, (frame, on) = frame.camera_from_world, as_of_image(frame, state)
        if state.belief is None:
            self._believe(believed_of(frame, self._asked or frame.beliefs or Beliefs(), self.settings.first.look.noise))
            answer = self._begin(frame)
            return replace(answer, notes=(*answer.notes, *unused, *filled))
        if self.live and self._aside is None:
            self._aside = Aside()
            state.renewal.hurry(frame.index, self.settings.renewal)  # a search that ran when it was saved is not kept
        heard = self._aside.ready if self._aside is not None and frame.index > state.index else ""
        with one_blas_thread():
            moving = state, self._velocity, self._watch, self._looker.correction, self._sensed
            belief = with_hand_or_not(self.model, self._viewed(frame), world, state.belief, *moving)
            answer = self._follow(frame, belief, not heard)
        if self._rest is not None and self._rest.index == frame.index:
            frame, unused = self._rest, (*unused, NOT_HERE)
        self._rest = None  # no image is kept with the state
        if answer.verdict == "lost":
            state.lost_for += 1
            answer = self._recover(frame, answer, heard)
        elif answer.how == "tracked":
            with state.as_of(frame, self._looker.correction) as told:
                answer = self._search(frame, answer, heard) if told else answer
        answer = as_printed(self.model, self._sensed, state, (self._velocity, self._watch), answer, self.settings)
        state.judged(frame.index, answer.verdict == "ok", self.settings.renewal)
        unused = *unused, *state.said, *unused_touch(self._felt_frame(frame), self.settings.first.touch)
        return moved_on(answer, on, state, self._looker.correction, unused)

    def _begin(self, frame: Frame) -> TrackedEstimate:
        if self.live:  # a search beside the frames would build it, and keep them waiting
            built_pair_table(self.model)
        answer = self.estimated(frame, self._prior)
        self._prior = None  # it was the first frame's
        if answer.verdict == "lost":
            return as_tracked(answer, "lost")
        self.believe(frame, answer)
        return as_tracked(answer, "started")

    def believe(self, frame: Frame, answer: Estimate) -> None:
        """Begin (again) from an estimate of this frame, wherever it comes from."""
        state, s = self._state, self.settings
        self._anchor(answer)
        sure, how = several.sure_of(answer), s.hypotheses
        votes, odds = several.vote_of(answer.verdict, sure, how), several.log_odds(sure, how)
        state.hypotheses, felt = several.of_modes(self.model, answer.modes, votes, how, odds), self._feel(frame)
        state.hand, state.seen_at = self._holding(frame, felt, answer.pose), None
        state.index, state.unseen, state.lost_for, state.usual, state.known = frame.index, 0, 0, None, None
        state.forget(self.model, frame, answer.pose, answer.covariance, s.sizes)
        state.renewal.restart(frame.index, s.renewal)
        if self._aside is not None:
            self._aside.forget()
        near = near_enough(self.model, answer.modes[0], s.first.confidence)
        state.right = min(1.0, several.sure_of(answer) / near) if near > 1e-9 else 0.0
        self.begun, state.sure, state.imaged = True, answer.verdict == "ok", state.imaged or not is_empty(frame)
        self._velocity.restart(frame.index, answer.pose)
        self._watch.let_go()
        self._skins(frame, felt)

    def _anchor(self, answer: Estimate, tracked: Array | None = None) -> None:
        """Believe an estimate; of a pose that this frame was tracked to (4, 4) as unsure as the two are apart."""
        state, belief = self._state, Belief.begun(answer, self.settings.first_lasting)
        if tracked is not None and state.belief is not None:
            untold = state.untold.at(self.model, answer.pose) if state.hand is not None else None
            belief = gone_on(self.model, state.belief, tracked, belief, untold)
        state.belief = belief
        if tracked is not None and state.hand is None:  # only its velocity says where it goes from there
            state.hypotheses, state.known = several.leading(state.hypotheses, belief), None
            self._velocity.corrected(belief.pose)

    def _recover(self, frame: Frame, lost: TrackedEstimate, heard: str) -> TrackedEstimate:
        """Look for the object; the track begins again from where it is found."""
        asks = self._sensed, self._state, self.estimated, self._aside, heard, self.settings
        try:
            found = searching.recover(self.model, frame, lost, *asks)
        except CaptureError as error:  # a frame amid a track whose sizes make no sense is a frame without evidence
            return replace(lost, notes=(*lost.notes, str(error)))
        return lost if found is None else self._again(frame, lost, found)

    def _again(self, frame: Frame, lost: TrackedEstimate, found: Estimate) -> TrackedEstimate:
        """The track begins again from what the frame says by itself; lost: what it would have said otherwise."""
        state, s, before = self._state, self.settings, self._state.hypotheses
        found = replace(as_before(self.model, found, lost, s.first), trace=(*lost.trace, *found.trace))
        smear = state.smear(self.model, frame.index, found.pose, s.velocity)
        self.believe(frame, found)
        state.hypotheses = several.with_ways(self.model, state.hypotheses, before, lost.pose, s.hypotheses)
        return as_tracked(as_learned(self.model, found, state.sizes, smear, s), "re-initialised")

    def _search(self, frame: Frame, answer: TrackedEstimate, heard: str) -> TrackedEstimate:
        """A tracked frame searched by itself, where that is due: close around its answer, and as if nothing were known.
        A live tracker is told what was found in one before it: `heard` is what that was searched for.
        """
        state, s, aside = self._state, self.settings, self._aside
        near = partial(searching.near, self.estimated, frame, s)

        def searched(what: str, frame: Frame, prior: Prior | None) -> Estimate | None:
            if aside is None:
                return self.estimated(frame, prior)
            leader = searching.leader_at(answer, state)
            if heard == what:
                return aside.result(self.model, leader, state, near, s.hypotheses)
            aside.ask(what, self.estimated, frame, prior, leader, state)
            return None

        if aside is None:
            answer, alone = searching.surer_alone(self.model, frame, answer, self._sensed, state, self.estimated, s)
            if alone is not None:
                return self._again(frame, answer, alone)
        answer = searching.look_closer(self.model, frame, answer, self._sensed, state, self.estimated, self._anchor, s)
        asks = answer, self._sensed, state
        state.renewal.due = frame.index if heard == ANEW else state.renewal.due
        if heard == AROUND:
            searching.search_around(self.model, frame, *asks, searched, s)
            answer = self._believed(answer)
        elif frame.index >= state.renewal.due and not state.waits_for_image(frame):
            answer = self._believed(searching.renew(self.model, frame, *asks, searched, self._anchor, s))
        if aside is not None:
            aside.heard(heard)
            if aside.searching == ANEW:  # frames need not be looked at in full until it ends
                state.renewal.due = frame.index + s.renewal.longest
        return answer

    def _believed(self, answer: TrackedEstimate) -> TrackedEstimate:
        return as_believed(self.model, answer, self._state.hypotheses, self.settings)

    def estimated(self, frame: Frame, prior: Prior | None) -> Estimate:
        """The frame by itself, by this track's settings and beliefs; a place to look at is neither doubted nor told."""
        around = None if prior is self._prior else prior
        how = self.settings.first if around is None else believing(self.settings.first)
        found = estimate(frame, self.model, prior, self._senses, seed=self._seed, settings=how, beliefs=self._asked)
        return searching.by_itself(self.model, found, around, how)

    def _follow(self, frame: Frame, belief: Belief, briefly: bool, there: Array | None = None) -> TrackedEstimate:
        """Predict, look, solve, judge; a glance where it may be brief. there (4, 4): where else to predict it."""
        trace, s, state, model, beliefs = Trace(), self.settings, self._state, self.model, self._beliefs
        viewed = self._viewed(frame)
        with trace.stage("predict", True, "") as stage:
            told = beliefs.calibration, state.corrected(self._looker.correction)
            flow = seen_motion(model, frame, belief, state, self._velocity, s.marks)
            ahead = predict(model, frame, belief, state, self._velocity, self._hand_motion, self._watch, *told, flow)
            elsewhere = where_shown(model, viewed, ahead, state, s) if there is None else None
            near = elsewhere or (ahead if there is None else as_moved(model, ahead, there))
            predicted, carried = near.belief, near.hypotheses
            stage.note(0, near.why)
        if elsewhere is not None:  # few steps from a prediction that was off by that much end anywhere
            return self._carry(frame, predicted, carried, trace, self._feel(frame), SHOWN_ELSEWHERE)
        if briefly and not self._watch.settling and may_glance(model, viewed, state, carried, s):
            glanced = self._glance(frame, viewed, predicted, carried, trace, flow)
            if glanced is not None:
                return glanced
        with trace.stage("look", "vision" in self._senses, "vision not asked for") as stage:
            last, looked = self._looker.told, self._looker.look(viewed, predicted.pose)
            seen = looked.rows(beliefs.depth, self._looker.first.rows)
            stage.note(len(seen), f"{len(looked.pixels)} object pixels, {len(looked.of_hand)} of the hand")
        moved = None if there is not None else bump(model, viewed, predicted.pose, last, self._looker.told)
        if moved is not None:
            state.known, state.held = None, state.held.bumped
            self._watch.restart()
            self._beliefs = self._looker.beliefs = recalibrated(beliefs, self._looker.correction)
            self._asked = replace(self._asked or frame.beliefs or Beliefs(), calibration=self._beliefs.calibration)
            return self._follow(frame, belief, False, moved @ predicted.pose)
        with trace.stage("feel", "touch" in self._senses, "touch not asked for") as stage:
            felt = self._feel(frame, looked)
            contacts, felt_rows = len(felt.reported_contacts), len(felt.reported_rows)
            stage.note(felt_rows, f"{counted(contacts, 'contact')}, {counted(felt_rows - contacts, 'empty point')}")
        if not len(seen) and not contacts:
            return self._carry(frame, predicted, carried, trace, felt, NOTHING_SENSED)
        with trace.stage("picture", viewed.depth is not None, "no depth image") as stage:
            asked = np.array([h.pose for h in carried])
            pool = pool_near(viewed, model, asked, looked, felt, beliefs, s.first, s.room)
            unsolved = viewed.depth is None or not len(looked.pixels)
            placed = looked.hand is None and (unsolved or self._looker.correction is not None)
            self._sensed = sensed = Sensed(viewed, looked, seen, felt, pool, state.things, s.occluders, placed)
        with trace.stage("align", True, "") as stage:
            prior = loose(predicted.pose, predicted.own, s)
            found = refine(model, carried, prior, sensed, state.imaged, s)
            of = f"{len(carried)} hypotheses" if len(carried) > 1 else "a few steps from the prediction"
            stage.note(len(found.seen) + felt_rows, "another hypothesis leads" if found.switched else of)
        with trace.stage("solve together", True, "") as stage:
            leader = found.hypotheses[0].pose
            if found.switched:
                prior = replace(prior, pose=leader)
            learned = len(state.levels)
            solved = solve_leader(model, frame, leader, prior, found, sensed, state.levels, beliefs, s)
            solved = resting(model, with_outline(solved, sensed, beliefs, s, trace), sensed, state)
            rest = without_strangers(model, frame, prior, solved, found, sensed, state, beliefs, s)
            if rest is not None:
                self._rest, state.levels[learned:] = rest, []
                return self._follow(rest, belief, False, there)
            blind = state.hand is not None and not len(looked.pixels)
            shown = replace(sensed, seen=found.seen)
            how = blind, self._looker.correction is not None or state.correction is not None, state, beliefs, s
            measured, untold = measurement_of(model, solved, frame.index, predicted.pose, shown, *how)
            if len(state.levels) > learned:  # of what all frames share the first was told no more than this one
                predicted = relearned(model, predicted, measured)
            if felt_rows and not placed:
                felt = felt.corrected(solved.correct())
            now = replace(shown, felt=felt)
            common = steadied(model, prior, now, measured, None if found.switched else state.known, s)
            self._sensed = replace(sensed, seen_from=common.seen_from(model))
            off = 1e3 * shift(felt.correction, middle_of(model, solved.pose))
            stage.note(len(found.seen) + felt_rows, f"calibration off by {off:.1f} mm")
        step = se3.difference(measured.pose, ahead.belief.pose, model.centroid)
        if there is None and state.hand is None and not found.switched and s.is_far(step):
            return self._follow(frame, belief, False, measured.pose)
        with trace.stage("judge", True, "") as stage:
            belief, watched = self._updated(frame, predicted, common.measured, found.switched, felt, len(looked.pixels))
            leap = step * (not found.switched and s.leaps(step, ahead.belief.own + measured.own))
            said = judge(model, found, solved, belief, now, state, leap, beliefs, s)
            stage.note(len(found.seen) + felt_rows, said.why)
        if by_touch_alone(said, watched, len(looked.pixels), state, s):
            self._watch.follow(predicted, None)
            return self._carry(frame, predicted, carried, trace, felt, OUT_OF_SIGHT)
        if said.verdict != "lost":
            self._accept(frame, felt, belief, found.hypotheses, said.share)
            learn_delay(model, frame, found.seen, solved.pose, self._looker, state)
            state.right, state.untold, state.sizes = said.right, untold, said.sizes
            if felt_rows and not placed and looked.hand is None:
                state.correction = felt.correction
            if found.switched or viewed.depth is not None:  # frames between images say nothing of what looks share
                state.known = None if found.switched else known_of(model, common, now, said, beliefs, s)
                state.glanced = 0
            learn_things(model, sensed, state, belief.pose, found.switched, s)
            mark(model, sensed, belief.pose, None if found.switched else flow, state, s.marks)
        answer = as_followed(frame, belief, predicted, said, watched, replace(sensed, felt=felt), trace.stages, s)
        return self._believed(answer) if answer.how == "tracked" else answer

    def _glance(
        self, frame: Frame, viewed: Frame, predicted: Belief, carried: Hypotheses, trace: Trace, flow: Motion | None
    ) -> TrackedEstimate | None:
        """The frame by a glance; None when it must be looked at in full."""
        state, s, known = self._state, self.settings, self._state.known
        assert known is not None
        with trace.stage("glance", True, "") as stage:
            felt_frame = self._felt_frame(frame)
            found = glance(
                self.model, viewed, felt_frame, self._looker, predicted, known, state.things, self._watch.going_on,
                self._beliefs, state.rest, s,
            )  # fmt: skip
            seen, felt, pixels = found.sensed.seen, found.sensed.felt, len(found.sensed.looked.pixels)
            stage.note(len(seen) + len(felt.reported_rows), found.otherwise or "nothing is otherwise than expected")
            if found.otherwise or pixels < s.fewest_pixels:
                return None
            belief, watched = self._updated(frame, predicted, found.measured, False, felt, pixels)
            state.glanced += 1
            said = as_judged(self.model, known, carried, state.told(belief, s.sizes), found, s)
        self._accept(frame, felt, belief, carried, found.share)
        mark(self.model, found.sensed, belief.pose, flow, state, s.marks)
        return self._believed(as_followed(frame, belief, predicted, said, watched, found.sensed, trace.stages, s))

    def _viewed(self, frame: Frame) -> Frame:
        return frame if "vision" in self._senses else frame.without_vision()

    def _felt_frame(self, frame: Frame) -> Frame:
        return frame if "touch" in self._senses else frame.without_touch()

    def _feel(self, frame: Frame, looked: Looked | None = None) -> Felt:
        told = self._looker.correction, self._state.correction
        return feel_near(self._felt_frame(frame), looked, *told, self._beliefs, self.settings.first.touch)

    def _holding(self, frame: Frame, felt: Felt, pose: Array) -> HandState | None:
        hand, late = HandState.of(frame, felt.reported_contacts), frame.index < self._state.index
        return self._state.holding(self.model, hand, pose, late, self._looker.told, self.settings.first.verdict)

    def _skins(self, frame: Frame, felt: Felt) -> Watched:
        """Whether what presses arrays and gels has moved over them."""
        patches = in_palm(frame, felt.reported_patches) if felt.reported_patches else []
        return self._watch.feel(readings_of(placed(self._felt_frame(frame))[0]), patches)

    def _updated(
        self, frame: Frame, predicted: Belief, measured: Measurement, switched: bool, felt: Felt, pixels: int
    ) -> tuple[Belief, Watched]:
        """The belief after the frame, and whether the object slips. pixels: of the object, as many as are seen."""
        model, state = self.model, self._state
        pixel = pixel_of(frame, middle_of(model, measured.pose))
        belief = measured.alone() if switched else update(model, predicted, measured, state.hand is not None)
        watched = Watched() if (late := frame.index < state.index) else self._skins(frame, felt)
        if switched:
            self._watch.restart()
        elif state.hand is not None:
            watched = self._watch.step(measured, belief, pixel, watched)
        if state.sizes.looks and not (watched.slip or switched or late):
            state.jumps = state.jumps.learned(model, predicted, measured, self.settings.sizes)
        if watched.slip and not switched and not slips_unseen(watched, pixels, state, self.settings):
            belief = after_slip(model, predicted, measured)
            self._watch.follow(belief, pixel)
            if state.known is not None:  # its contacts are elsewhere now: what looks had in common was of another hold
                state.known = replace(state.known, weight=0.0)
        return replace(belief, pose=model.symmetries.nearest(belief.pose, predicted.pose)), watched

    def _accept(self, frame: Frame, felt: Felt, belief: Belief, found: Hypotheses, share: float) -> None:
        """Keep what this frame taught; a late frame's lesson is moved on to the present."""
        state = self._state
        state.explained(share)
        kept = several.sifted(self.model, several.leading(found, belief), self.settings.hypotheses)
        hand = self._holding(frame, felt, belief.pose)
        if frame.index < state.index:
            motion = state.taught_late(belief, kept, hand, self._looker.correction)
            return None if motion is None else self._watch.carry(motion)
        state.belief, state.hypotheses, state.index, state.hand = belief, kept, frame.index, hand
        state.feeling(self.model, felt, hand, belief.pose, self.settings.first.verdict)
        if np.isfinite(share):
            state.seen_at = None if hand is None else hand.camera_from_hand
        self._velocity.update(frame.index, belief.pose, belief.covariance)

    def _carry(
        self, frame: Frame, predicted: Belief, carried: Hypotheses, trace: Trace, felt: Felt, because: tuple[str, str]
    ) -> TrackedEstimate:
        """The frame tells nothing of the object: it is where the hand has carried it, for a while."""
        s, state = self.settings, self._state
        if frame.index > state.index:
            state.unseen += frame.index - state.index
            state.belief, state.hypotheses, state.index = predicted, carried, frame.index
            state.hand = self._holding(frame, felt, predicted.pose)
            self._velocity.coast(frame.index)
        past, because = seen_past(self.model, self._viewed(frame), predicted.pose, self._sensed, because)
        held = state.hand is not None and state.unseen <= s.coast and not past
        how = trace.stages, held, state.hand is not None, because, felt.correction, state.right, s
        return as_carried(self.model, frame, state.told(predicted, s.sizes), *how)
