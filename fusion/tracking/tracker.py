"""Frame after frame: predict from the hand, look near the prediction, solve with both senses, update, judge.

    for answer in track(read_capture("captures/drill"), model):
        print(answer.frame, answer.verdict, answer.slip, answer.pose)

The first frame is `fusion.estimation.estimate.estimate`. Later ones skip the search: the object moves with the palm
and the fingertips, so a few steps from the predicted pose find it, and one joint solution with the depth camera's and
the robot's errors follows. A frame may lack either sense, come late, or hold nothing. When an answer explains too
little, the object is looked for with `estimate` again. Camera frame, metres, radians.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fusion.estimation import verdict as posterior
from fusion.estimation.answer import Estimate
from fusion.estimation.asked import as_prior, check_senses, sure_to_be_within
from fusion.estimation.confidence import within
from fusion.estimation.estimate import estimate
from fusion.estimation.solve.joint import JointResult
from fusion.estimation.solve.problem import JointProblem
from fusion.estimation.solve.rigs import solve_modes
from fusion.estimation.solve.settings import Rig
from fusion.estimation.trace import Trace
from fusion.tracking.answer import TrackedEstimate, TrackSettings, as_carried, as_tracked
from fusion.tracking.filter import Belief, Measurement, moved_modes, update
from fusion.tracking.motion import HandMotion, HandState, calibration_drift
from fusion.tracking.slip import SlipWatch, Watched
from scenes.errors import CaptureError
from scenes.evidence import table as tables
from scenes.evidence.align import Alignment, AlignSettings, Prior, align
from scenes.evidence.modes import Mode, distinct_modes
from scenes.evidence.table import Evidence
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.beliefs import Beliefs
from scenes.recordings.frames import Frame
from scenes.threads import one_blas_thread
from touch.arrays.readings import readings_of
from touch.contacts import Felt, feel
from vision.look.looked import Looked
from vision.look.warm import Looker
from vision.sight import Sight
from vision.tracking.by_vision import ConstantVelocity
from vision.visibility import visibility

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
    for frame in frames:
        yield tracker.step(frame)


class Tracker:
    """`track` for frames that arrive one by one."""

    def __init__(
        self,
        model: ObjectModel,
        prior: Array | Prior | None = None,
        use: Iterable[str] = ("vision", "touch"),
        seed: int = 0,
        settings: TrackSettings | None = None,
        beliefs: Beliefs | None = None,
        sure_within: float | None = None,
    ) -> None:
        """As `track`."""
        self.model = model
        settings = settings or TrackSettings()
        self.settings = replace(settings, first=sure_to_be_within(settings.first, sure_within))
        self._senses = check_senses(use)
        self._prior = as_prior(prior, self.settings.first)
        self._seed = seed
        self._asked = beliefs
        self._believe(beliefs or Beliefs())
        self._hand_motion = HandMotion(model, self.settings.hand)
        self._velocity = ConstantVelocity(model.centroid, self.settings.velocity)
        self._forget()

    def _believe(self, beliefs: Beliefs) -> None:
        self._beliefs = beliefs
        self._looker = Looker(self.model, self.settings.look, self.settings.first.look, beliefs)
        self._watch = SlipWatch(self.model, beliefs.depth.bias_length, self.settings.slip)

    def _forget(self) -> None:
        self._belief: Belief | None = None
        self._modes: tuple[Mode, ...] = ()
        self._hand: HandState | None = None
        self._index = 0
        self._unseen = 0
        self._lost_for = 0
        self._usual: float | None = None
        self._found = 0.0
        self._rigs: list[float] = []

    def step(self, frame: Frame) -> TrackedEstimate:
        """The object in this frame."""
        if self._belief is None:
            if self._asked is None and frame.beliefs is not None:
                self._believe(frame.beliefs)
            return self._begin(frame)
        with one_blas_thread():
            answer = self._sure(self._follow(frame, self._belief))
        if answer.how == "lost":
            self._lost_for += 1
            return self._recover(frame, answer)
        return answer

    def _sure(self, answer: TrackedEstimate) -> TrackedEstimate:
        """With its confidence: that the object was found at all, which the picture told then, times what the posterior
        says now of its mode and of being within the tolerance. What is lost is not to be trusted at all.
        """
        how, first = self.settings.first.confidence, answer.modes[0]
        near = 0.0 if answer.how == "lost" else self._near(first)
        return replace(answer, confidence=self._found * first.weight * near, sure_within=how.tolerance)

    def _near(self, mode: Mode) -> float:
        """Probability that the object is within the tolerance of a mode, if that is the right one."""
        how = self.settings.first.confidence
        return within(self.model, mode.pose, mode.covariance, how.tolerance, how.seen.nearest)

    # --- beginning, and beginning again

    def _begin(self, frame: Frame) -> TrackedEstimate:
        answer = self._estimated(frame, self._prior)
        if answer.verdict == "lost":
            return as_tracked(answer, "lost")
        self._restart(frame, answer)
        return as_tracked(answer, "started")

    def _restart(self, frame: Frame, answer: Estimate) -> None:
        """Believe an estimate."""
        share = self.settings.first_lasting
        self._belief = Belief(answer.pose, (1 - share) * answer.covariance, share * answer.covariance)
        self._modes = answer.modes[: self.settings.modes]
        explained = answer.modes[0].weight * self._near(answer.modes[0])
        self._found = min(1.0, answer.confidence / explained) if explained > 1e-9 else 0.0
        self._index, self._unseen, self._lost_for, self._usual = frame.index, 0, 0, None
        contacts = self._feel(frame).reported_contacts
        self._hand = HandState.of(frame, contacts)
        self._velocity.restart(frame.index, answer.pose)
        self._watch.let_go()
        self._watch.feel(readings_of(self._felt_frame(frame)))

    def _recover(self, frame: Frame, lost: TrackedEstimate) -> TrackedEstimate:
        """Look for the object around the prediction, now and then everywhere."""
        s = self.settings
        tries: list[Prior | None] = [Prior.isotropic(lost.pose, s.near_angle, s.near_distance)]
        if self._lost_for == 2 or self._lost_for % s.global_every == 0:
            tries.append(None)
        for prior in tries:
            bare = replace(frame, prior=None)
            try:
                found = self._estimated(bare, prior)
            except CaptureError as error:  # a frame amid a track whose sizes make no sense is a frame without evidence
                return replace(lost, notes=(*lost.notes, str(error)))
            if found.verdict == "ok" or (prior is not None and found.verdict == "ambiguous"):
                pose = self.model.symmetries.nearest(found.pose, lost.pose)
                found = replace(found, pose=pose, trace=(*lost.trace, *found.trace))
                self._restart(frame, found)
                return as_tracked(found, "re-initialised")
        return lost

    def _estimated(self, frame: Frame, prior: Prior | None) -> Estimate:
        """The frame by itself."""
        first, senses, beliefs = self.settings.first, self._senses, self._beliefs
        return estimate(frame, self.model, prior, senses, seed=self._seed, settings=first, beliefs=beliefs)

    # --- one frame

    def _follow(self, frame: Frame, belief: Belief) -> TrackedEstimate:
        trace = Trace()
        with trace.stage("predict", True, "") as stage:
            predicted, modes, why = self._predict(frame, belief)
            stage.note(0, why)
        viewed = frame if "vision" in self._senses else frame.without_vision()
        with trace.stage("look", "vision" in self._senses, "vision not asked for") as stage:
            looked = self._looker.look(viewed, predicted.pose)
            seen = looked.rows(self._beliefs.depth, self._looker.first.rows)
            stage.note(len(seen), f"{len(looked.pixels)} object pixels, {len(looked.of_hand)} of the hand")
        with trace.stage("feel", "touch" in self._senses, "touch not asked for") as stage:
            felt = self._feel(frame, looked)
            contacts, felt_rows = len(felt.reported_contacts), len(felt.reported_rows)
            stage.note(felt_rows, f"{contacts} contacts, {felt_rows - contacts} empty points")
        if not len(seen) and not contacts:
            return self._carry(frame, predicted, trace, felt)
        with trace.stage("align", True, "") as stage:
            prior = self._loose(predicted)
            rows = tables.stack(seen, felt.rows)
            found, switched = self._align(viewed, rows, modes, prior)
            stage.note(len(rows), "another mode explains more" if switched else "a few steps from the prediction")
        with trace.stage("solve together", True, "") as stage:
            if switched:
                prior = replace(prior, pose=found[0].pose)
            solved = self._solve(frame, looked, seen, felt, prior, found[0].pose)
            measured = self._measurement(solved, predicted, looked)
            if looked.hand is not None and felt_rows:
                felt = felt.corrected(solved.correct())
            stage.note(
                len(rows), f"calibration off by {1e3 * _shift(felt.correction, self._middle(solved.pose)):.1f} mm"
            )
        return self._judged(frame, viewed, trace, predicted, measured, found, switched, (looked, seen, felt))

    def _predict(self, frame: Frame, belief: Belief) -> tuple[Belief, tuple[Mode, ...], str]:
        """The belief and the modes in this frame, before anything is sensed in it."""
        steps = frame.index - self._index
        now = HandState.of(frame, feel(frame.without_touch(), np.eye(4), self._beliefs).reported_contacts)
        if self._hand is None or now is None:
            pose, noise = self._velocity.predict(frame.index)
            motion = pose @ se3.inverse(belief.pose)
            self._watch.restart()  # nothing holds it that could lose it
            moved = replace(belief.moved(motion), pose=pose)
            return (
                Belief(pose, moved.own + noise, moved.shared),
                moved_modes(self._modes, motion),
                "at its last velocity",
            )
        motion = now.camera_from_hand @ se3.inverse(self._hand.camera_from_hand)
        hold = se3.inverse(self._hand.camera_from_hand) @ belief.pose
        expected = self._hand_motion.in_hand(self._hand, frame, hold, max(1, abs(steps)))
        expected = expected.turned(now.camera_from_hand[:3, :3])
        moved = belief.moved(motion)
        centre = self._middle(moved.pose)
        drift = calibration_drift(self._hand.camera_from_hand, now.camera_from_hand, centre, self._beliefs.calibration)
        delta, noise = expected.motion, expected.noise + drift
        self._watch.predict(motion, expected, drift)
        whole = se3.perturb(motion @ belief.pose, delta, self.model.centroid) @ se3.inverse(belief.pose)
        why = (
            "with the palm"
            if not delta.any()
            else f"with palm and fingertips, {1e3 * np.linalg.norm(delta[3:]):.2f} mm"
        )
        return moved.shifted(delta, noise, self.model.centroid), moved_modes(self._modes, whole), why

    def _felt_frame(self, frame: Frame) -> Frame:
        return frame if "touch" in self._senses else frame.without_touch()

    def _feel(self, frame: Frame, looked: Looked | None = None) -> Felt:
        """What is felt, moved to where the hand is seen, or was last; as the robot reports it before a look."""
        region = None if looked is None else looked.region
        felt = feel(self._felt_frame(frame), np.eye(4), self._beliefs, region, self.settings.first.touch)
        if looked is None or not len(felt.reported_rows):
            return felt
        if looked.hand is not None:
            return felt.corrected(looked.hand.correct())
        return felt if self._looker.correction is None else felt.corrected(self._looker.correction)

    def _loose(self, predicted: Belief) -> Prior:
        s = self.settings
        wide = predicted.covariance + np.diag(np.repeat([s.loose_angle, s.loose_distance], 3) ** 2)
        return Prior(predicted.pose, np.asarray(np.linalg.inv(wide), dtype=np.float64))

    def _align(
        self, viewed: Frame, rows: Evidence, modes: tuple[Mode, ...], prior: Prior
    ) -> tuple[tuple[Mode, ...], bool]:
        """The carried modes (the prediction first) after a few steps; and whether another now leads."""
        s, model = self.settings, self.model
        starts = np.array([prior.pose, *(m.pose for m in modes[1:])])
        odds = np.array([m.weight for m in modes[: len(starts)]] or [1.0])
        coarse = align(
            model, rows, starts, prior if len(starts) == 1 else None, AlignSettings(blur=s.blur, iterations=6)
        )
        fine = align(model, rows, coarse.poses, prior if len(starts) == 1 else None, AlignSettings(iterations=12))
        past = Sight(viewed, model, self._beliefs.depth, s.first.sight).costs(fine.poses)
        costs = fine.costs + past - s.inherited * np.log(np.maximum(odds, 1e-6))
        hessians = fine.hessians if len(starts) == 1 else fine.hessians + prior.information
        found = distinct_modes(model, Alignment(fine.poses, costs, hessians, fine.iterations), s.first.modes)
        return found, bool(np.argmin(costs) != 0)

    def _solve(
        self, frame: Frame, looked: Looked, seen: Evidence, felt: Felt, prior: Prior, start: Array
    ) -> JointResult:
        s = self.settings
        known = len(self._rigs) >= s.level_frames
        how = replace(s.joint, rigs=(self._usual_rig(),)) if known else s.joint
        hand = looked.hand
        rows = felt.reported_rows if hand is not None else felt.rows
        problem = JointProblem.of(self.model, frame, seen, rows, prior, hand, self._beliefs, how)
        solved = solve_modes([problem], [start])[0]
        if not known and len(seen) and hand is not None:
            self._rigs.append(solved.level)
        return solved

    def _middle(self, pose: Array) -> Array:
        """Where the object's centroid is (3,): its file's origin may be anywhere."""
        return se3.apply(pose, self.model.centroid[None])[0]

    def _usual_rig(self) -> Rig:
        """The rig that most of the first frames were taken for, the lesser of two."""
        usual = sorted(self._rigs)[(len(self._rigs) - 1) // 2]
        return next(rig for rig in self.settings.joint.rigs if rig.level == usual)

    def _measurement(self, solved: JointResult, predicted: Belief, looked: Looked) -> Measurement:
        """The frame's own answer; a frame without a camera has the robot's error of its own."""
        s = self.settings
        pose = self.model.symmetries.nearest(solved.pose, predicted.pose)
        shared = solved.shared
        if self._hand is not None and not len(looked.pixels):
            left = self._looker.correction is not None
            calibration = self._beliefs.calibration
            angle = s.left_angle if left else calibration.rotation_sigma
            lever = float(np.linalg.norm(self._middle(pose)))
            distance = np.hypot(calibration.translation_sigma, calibration.rotation_sigma * lever)
            distance = s.left_distance if left else float(distance)
            shared = shared + np.diag(np.repeat([angle, distance], 3) ** 2)
        return Measurement.of(pose, solved.independent, shared, s.noise, s.lasting)

    def _judged(
        self,
        frame: Frame,
        viewed: Frame,
        trace: Trace,
        predicted: Belief,
        measured: Measurement,
        found: tuple[Mode, ...],
        switched: bool,
        sensed: tuple[Looked, Evidence, Felt],
    ) -> TrackedEstimate:
        """Update the belief, test for slip, say what may be said."""
        s, model = self.settings, self.model
        looked, seen, felt = sensed
        with trace.stage("judge", True, "") as stage:
            pixel = None if frame.camera is None else frame.camera.project(self._middle(measured.pose)[None])[0][0]
            pixel = pixel if pixel is not None and np.isfinite(pixel).all() else None  # behind the camera
            alone = Belief(measured.pose, measured.own, measured.shared)
            belief = alone if switched else update(model, predicted, measured)
            late = frame.index < self._index
            watched = Watched() if late else self._watch.feel(readings_of(self._felt_frame(frame)))
            if switched:
                self._watch.restart()
            elif self._hand is not None:
                watched = self._watch.step(measured, belief, pixel, watched)
            if watched.slip and not switched:  # what was believed of the hold is worth no more than how far it was off
                step = se3.difference(measured.pose, predicted.pose, model.centroid)
                wide = replace(predicted, own=predicted.own + np.outer(step, step))
                belief = update(model, wide, measured)
                self._watch.follow(belief, pixel)
            pose = model.symmetries.nearest(belief.pose, predicted.pose)
            belief = replace(belief, pose=pose)
            modes = (Mode(pose, found[0].weight, found[0].cost, belief.covariance), *found[1:])
            residuals = posterior.contact_residuals(model, felt.contacts, pose, s.first.verdict)
            share, rms = posterior.pixel_agreement(model, seen, pose)
            seeing = visibility(viewed, model, pose, self._beliefs.depth)
            word, why = posterior.verdict(model, modes, residuals, share, seeing, s.first.verdict)
            leap = se3.difference(measured.pose, predicted.pose, model.centroid)
            if word != "lost" and self._strays(share, len(looked.pixels)):
                word, why = "lost", f"{share:.0%} of the pixels explained, {self._usual:.0%} before"
            if word != "lost" and not switched and s.leaps(leap):
                word, why = "lost", f"{1e3 * np.linalg.norm(leap[3:]):.0f} mm from the prediction"
            if watched.slip:
                why = f"slips in the hand ({watched.by}); {why}"
            stage.note(len(seen) + len(felt.rows), why)
        how = "lost" if word == "lost" else "tracked"
        if how == "tracked":
            self._accept(frame, felt, belief, modes, share)
        return TrackedEstimate(
            frame=frame.index,
            pose=pose,
            covariance=belief.covariance,
            modes=modes,
            verdict=word,
            unobservable=posterior.unobservable(model, pose, belief.covariance, s.first.verdict),
            hand_from_object=frame.hand_from_object(pose, felt.correction),
            visible_fraction=seeing.visible,
            trace=trace.stages,
            contacts=residuals,
            pixel_rms_mm=1e3 * rms,
            notes=(why,),
            dropped=looked.dropped,
            start=predicted.pose,
            how=how,
            slip=watched.slip,
            slip_statistic=watched.statistic,
            moved_in_hand=watched.moved,
        )

    def _strays(self, share: float, pixels: int) -> bool:
        if self._usual is None or pixels < self.settings.fewest_pixels or not np.isfinite(share):
            return False
        return bool(share < self.settings.least_of_usual * self._usual)

    def _accept(self, frame: Frame, felt: Felt, belief: Belief, modes: tuple[Mode, ...], share: float) -> None:
        """Keep what this frame taught; a late frame's lesson is moved on to the present."""
        self._lost_for = self._unseen = 0
        if np.isfinite(share):
            self._usual = share if self._usual is None else 0.9 * self._usual + 0.1 * share
        hand = HandState.of(frame, felt.reported_contacts)
        if frame.index < self._index:
            if self._hand is None or hand is None:
                return
            motion = self._hand.camera_from_hand @ se3.inverse(hand.camera_from_hand)
            self._belief, self._modes = belief.moved(motion), moved_modes(modes, motion)
            self._watch.carry(motion)
            return
        self._belief, self._modes, self._index, self._hand = belief, modes[: self.settings.modes], frame.index, hand
        self._velocity.update(frame.index, belief.pose)

    def _carry(self, frame: Frame, predicted: Belief, trace: Trace, felt: Felt) -> TrackedEstimate:
        """Nothing was sensed: the object is where the hand has carried it, for a while."""
        s = self.settings
        if frame.index > self._index:
            self._unseen += frame.index - self._index
            modes = moved_modes(self._modes, predicted.pose @ se3.inverse(self._modes[0].pose)) if self._modes else ()
            self._belief, self._modes, self._index = predicted, modes, frame.index
            self._hand = HandState.of(frame, felt.reported_contacts)
            self._velocity.coast(frame.index)
        held = self._hand is not None and self._unseen <= s.coast
        return as_carried(self.model, frame, predicted, trace.stages, held, self._hand is not None, s)


def _shift(correction: Array, point: Array) -> float:
    """How far a correction (4, 4) moves a point (3,), metres."""
    return float(np.linalg.norm(se3.apply(correction, point[None])[0] - point))
