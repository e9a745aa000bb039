"""All that a track remembers from frame to frame, as plain arrays and numbers; and how closely it looks at which frame.

Most frames are glanced at (`steps.glancing`), some looked at in full, few searched as if nothing were known: a track
that follows a wrong pose agrees with itself for ever. Single frames searched without the track's memory do not share
its mistake: they are asked soon after a start, ever more rarely while they agree, and often again when they do not or
when something else gives cause for doubt. The rate is bounded on both sides.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from fusion.estimation.posterior.verdict import VerdictSettings
from fusion.estimation.solve.settings import Level
from fusion.tracking.filter import Belief, Measurement, block
from fusion.tracking.memory.held import Held, Instant
from fusion.tracking.memory.hypotheses import Hypotheses, moved
from fusion.tracking.memory.last_image import LastImage
from fusion.tracking.memory.last_touch import LastTouch
from fusion.tracking.memory.lateness import Lateness
from fusion.tracking.memory.occluders import Occluders
from fusion.tracking.memory.rest import Rest
from fusion.tracking.memory.sizes import Jumps, Sizes, SizeSettings
from fusion.tracking.memory.touched import Touched
from fusion.tracking.memory.untold import Untold, leaves_turn
from fusion.tracking.motion import HandState, palm_motion
from scenes.geometry import poses as se3
from scenes.geometry.cameras import Camera, is_reading
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Contacts, Frame
from touch.contacts import Felt
from vision.look.hand.hand import HandTold, camera_from_hand
from vision.tracking.by_image import Marks
from vision.tracking.by_vision import FASTEST, FASTEST_TURN, VelocitySettings

Array = NDArray[np.float64]


def is_empty(frame: Frame) -> bool:
    """Whether there is nothing in a frame that an object could be looked for in: no reading of any camera."""
    return (frame.depth is None or not is_reading(frame.depth).any()) and frame.cloud is None


@dataclass(frozen=True)
class GlanceSettings:
    """When a glance is enough. Tuned on sequences of the tuning family `lab`."""

    # Frames from one look in full to the next, at most (1: all are looked at in full); frames that a hypothesis must
    # have led before; frames that may be missing between two.
    every: int = 6
    settled: int = 3
    gap: int = 2
    # Share of the posterior (no unit) that the leader must hold; where it holds less than the second share, frames are
    # looked at in full every so many.
    leads: float = 0.8
    alone: float = 0.98
    every_open: int = 3
    # Steps of the fit.
    steps: int = 10
    # Share of their weight that looks until now keep when another comes: what the whole solution adds to a fit (bias,
    # scale, calibration) is the same from look to look, and each tells it as well as one frame can.
    memory: float = 0.75
    # Pixels of a look near the object, as a share of those of a look in full.
    pixels: float = 0.5
    # What asks for a look in full. Share of the pixels that the pose explains: so much less than at the last look.
    fewer: float = 0.12
    # Nats of what is seen past the object or hides it (vision.sight): so many more.
    sight: float = 4.0
    # Millimetres that contacts are off, root mean square: so many more. A false contact is off by more than twice that.
    contacts: float = 1.5
    # Squared innovation (chi-square, 6 degrees of freedom), one in a thousand by chance; of an object that slips, two
    # glances must differ by as much.
    surprise: float = 22.5
    # How far (m) a fit goes from the prediction before pixels are chosen anew where it has led, if nothing tells what
    # hides the object: those that lie inside the outline where it was expected hold it there, and what starts to move
    # was followed half of the way and `ok` 10 mm behind. By judgement: held half of the way, it is as far behind, and
    # 4 mm are still right. Of 2 mm the median frame of `visitor` takes twice the time. Turns do not count: those that
    # little tells of wander.
    anew_distance: float = 0.004


@dataclass(frozen=True)
class Known:
    """What the last look in full has found out.

    index: of its frame; pose (4, 4) as solved; offset (6,): from a fit of the rows alone to that, camera axes, the mean
    of the looks until now, and their weight (1 / m^2; 0: the next stands alone); own, shared, biased, hidden (6, 6):
    covariances of a measurement; correction (4, 4) camera_from_camera of what the robot reports, their mean, too;
    share, sight, felt: how pixels, image (nats) and contacts (mm, root mean square) agreed with such a fit; verdict,
    why, right, visible, unobservable: how it was judged; part: of what its own solution takes of them, what rows count.
    """

    index: int
    pose: Array
    offset: Array
    weight: float
    own: Array
    shared: Array
    biased: Array
    hidden: Array
    correction: Array
    share: float
    sight: float
    felt: float
    verdict: str
    why: str
    right: float
    visible: float
    unobservable: tuple[str, ...]
    part: float = 1.0

    def measured(self, model: ObjectModel, fit: Array, nearest: Array) -> Measurement:
        """What a fit (4, 4) of a later frame's rows measures; nearest (4, 4): of symmetric twins the one near this."""
        pose = model.symmetries.nearest(se3.perturb(fit, self.offset, model.centroid), nearest)
        turn = block(pose[:3, :3] @ self.pose[:3, :3].T)
        return Measurement(pose, *(turn @ one @ turn.T for one in (self.own, self.shared, self.biased, self.hidden)))


@dataclass(frozen=True)
class RenewalSettings:
    """How often single frames are searched. By judgement: a search costs as much as a hundred glances."""

    # Frames from a start, or from a doubt, to the next search; the wait doubles with each that brings nothing new, up
    # to the longest (60 = two seconds).
    soonest: int = 3
    longest: int = 60
    # Frames from one search to the next, at least, when answers come and go about the limit of what is called ok.
    hurried: int = 10
    # The longest wait, for so many frames after a start, while no search has spoken for the track, or the last one
    # found what its frame prefers to it.
    doubting: int = 5
    doubtful: int = 30
    # Standard deviations of a start (rad, m) from which a frame is searched, too, around a track that nothing has
    # spoken for: from a track of `lab` 26 degrees and 26 mm off these found the object in three frames of five, half
    # the angle in one, and a search without a start in none.
    around_angle: float = float(np.deg2rad(40.0))
    around_distance: float = 0.03
    # Frames from one estimate around the answer to the next, at least, where nothing tells what hides the object: while
    # the answer is not `ok`, and while it is.
    closer: int = 3
    closer_sure: int = 12
    # Frames to the next search of one whose answer is not `ok`, where a mask tells what is the object's and no hand how
    # it moves: one, and twice as many with each that finds nothing surer, up to so many. What moves by its own size
    # from frame to frame is found by a frame by itself where the steps of a track end elsewhere.
    alone: int = 16


@dataclass
class Renewal:
    """due: frame index of the next search; wait: frames from one to the next; last, begun: frame index of the last, and
    of the start; closest: of the last estimate around the answer; alone, patience: frame index of the next search of a
    doubted frame with a mask, and frames from it to the one after.
    """

    due: int = 0
    wait: int = 1
    last: int = 0
    begun: int = 0
    closest: int = 0
    alone: int = 0
    patience: int = 1

    def restart(self, index: int, settings: RenewalSettings) -> None:
        """A track has begun in this frame."""
        self.due, self.wait, self.last = index + settings.soonest, settings.soonest, index
        self.begun = self.closest = index
        self.alone, self.patience = index + 1, 1

    def found(self, index: int, agrees: bool | None, settings: RenewalSettings, believed: bool = True) -> None:
        """A search in this frame agrees with the track, contradicts it, or tells nothing (None); believed: whether one
        has ever spoken for it.
        """
        doubtful = not believed and index - self.begun < settings.doubtful
        longest = settings.doubting if doubtful else settings.longest
        self.wait = settings.soonest if agrees is False else min(2 * self.wait, longest)
        self.due, self.last = index + self.wait, index

    def in_vain(self, index: int, settings: RenewalSettings) -> None:
        """A doubted frame with a mask has been searched, and nothing surer was found."""
        self.patience = min(2 * self.patience, settings.alone)
        self.alone = index + self.patience

    def hurry(self, index: int, settings: RenewalSettings) -> None:
        """An answer is no longer ok: search soon, if the last search was not just now."""
        soon = max(index + settings.soonest, self.last + settings.hurried)
        if soon < self.due:
            self.due, self.wait = soon, settings.soonest


@dataclass
class TrackState:
    """All that a track remembers of the object; arrays and numbers, so that it can be kept.

    belief: of the leading hypothesis, None before a start; hypotheses: the leader first; hand: at the last frame;
    index: of that; seen_at (4, 4): camera_from_hand, as reported, where pixels told of the object last; unseen: frames
    without evidence; lost_for: frames; leads: how often another hypothesis has taken the lead; usual: share of pixels
    that the pose explains, usually; things: what goes with the object and is not it; untold: what no frame tells of it;
    sizes: what looks left unexplained; jumps: how far frames were from what was predicted; levels: of each of the
    first frames, how large its shared errors may be; right: chance that the leader is the right
    one, as last judged; sure: whether the last answer was ok; known: from the last look in full, None when the next
    frame must be looked at so; correction (4, 4) camera_from_camera of what the robot reports, as the last joint
    solution has it where no pixels of the hand tell: a calibration stays; None before; lens (4,): focal lengths (px,
    and shares of the image) of the last image looked at, and lens_for: images since, which had others; touched: what
    the fingers have felt of it last, None where there is no hand or they have not; marks: on its surface in the last
    colour image, where no hand tells how it moves; released: the hand has let go; apart: it is clear of it; camera: of
    the last image, None before; imaged: whether an image has shown it; glanced: glances since the last look in full;
    image, touch: the last image and contacts that were new ones, None before some; lateness: of images beside the
    robot's reports; held: whether it goes with the hand; rest: where it has been at rest.
    """

    belief: Belief | None = None
    hypotheses: Hypotheses = ()
    hand: HandState | None = None
    index: int = 0
    seen_at: Array | None = None
    unseen: int = 0
    lost_for: int = 0
    leads: int = 0
    usual: float | None = None
    things: Occluders = field(default_factory=Occluders)
    untold: Untold = field(default_factory=Untold)
    sizes: Sizes = field(default_factory=Sizes)
    jumps: Jumps = field(default_factory=Jumps)
    levels: list[Level] = field(default_factory=list)
    renewal: Renewal = field(default_factory=Renewal)
    right: float = 0.0
    sure: bool = False
    known: Known | None = None
    correction: Array | None = None
    lens: Array | None = None
    lens_for: int = 0
    touched: Touched | None = None
    marks: Marks | None = None
    released: bool = False
    apart: bool = False
    camera: Camera | None = None
    imaged: bool = False
    glanced: int = 0
    image: LastImage | None = None
    touch: LastTouch | None = None
    lateness: Lateness = field(default_factory=Lateness)
    held: Held = field(default_factory=Held)
    rest: Rest = field(default_factory=Rest)

    def before_its_camera(self, frame: Frame) -> Frame:
        """A frame between images, before the camera of the last one: it has not gone, and what is felt is off by what
        its calibration is off.
        """
        if frame.depth is not None:
            self.camera = frame.camera
        elif frame.camera is None and frame.cloud is None and self.camera is not None:
            return replace(frame, camera=self.camera)
        return frame

    def waits_for_image(self, frame: Frame) -> bool:
        """Whether a frame is not searched by itself though that is due: it has nothing that an object could be looked
        for in, and others have. Fingers alone seldom tell a pose, and would spend the search that an image is due.
        """
        return self.imaged and is_empty(frame)

    @contextmanager
    def as_of(self, frame: Frame, seen: Array | None) -> Iterator[bool]:
        """The state at the time of a frame that came late, and at the present again after; whether the hand tells how
        it has moved since. What begins anew meanwhile stays in that time. seen: as in `corrected`.
        """
        if frame.index >= self.index:
            yield True
            return
        on, now = self.since(HandState.of(frame, Contacts.none()), seen), self.index
        if on is None or self.belief is None:
            yield False
            return
        self._move(se3.inverse(on))
        try:
            yield True
        finally:
            if self.index == now:
                self._move(on)

    def since(self, then: HandState | None, seen: Array | None) -> Array | None:
        """(4, 4) the motion of what is held from where the hand was `then` to the present; None where nothing tells.
        seen: as in `corrected`.
        """
        if then is None or self.hand is None:
            return None
        return palm_motion(then, self.hand, self.corrected(seen))

    def explained(self, share: float) -> None:
        """An accepted frame's pixels, of which the pose explains a share; NaN where none were looked at."""
        self.lost_for = self.unseen = 0
        if np.isfinite(share):
            self.imaged = True
            self.usual = share if self.usual is None else 0.9 * self.usual + 0.1 * share

    def feeling(
        self, model: ObjectModel, felt: Felt, hand: HandState | None, pose: Array, settings: VerdictSettings
    ) -> None:
        """What an accepted frame's fingers feel of the object at a pose (4, 4)."""
        if hand is not None and len(felt.reported_contacts):
            at = felt.correction @ hand.camera_from_hand
            self.touched = Touched.of(model, felt.contacts, hand, at, pose, settings)

    def taught_late(
        self, belief: Belief, hypotheses: Hypotheses, hand: HandState | None, seen: Array | None
    ) -> Array | None:
        """Keep what a frame taught that came late, and had the hand so, moved on to the present: by that motion (4, 4);
        nothing is kept and None where nothing tells it. seen: as in `corrected`.
        """
        motion = self.since(hand, seen)
        if motion is not None:
            self.belief, self.hypotheses = belief.moved(motion), moved(hypotheses, motion)
        return motion

    def _move(self, motion: Array) -> None:
        assert self.belief is not None
        self.belief, self.hypotheses = self.belief.moved(motion), moved(self.hypotheses, motion)

    def forget(self, model: ObjectModel, frame: Frame, pose: Array, covariance: Array, settings: SizeSettings) -> None:
        """What looks at an object have taught, which begins anew in a frame, at pose (4, 4), known to a covariance
        (6, 6).
        """
        hand = camera_from_hand(frame)
        if hand is not None and self.held.last is None:
            self.held = replace(self.held, last=Instant(frame.index, frame.camera_from_world, hand))
        self.things, self.jumps = Occluders(), Jumps()
        self.untold = Untold(turns=leaves_turn(model, pose, covariance))
        self.touched = self.marks = None
        self.sizes = self.sizes.faded(settings)

    def holding(
        self,
        model: ObjectModel,
        hand: HandState | None,
        pose: Array,
        late: bool,
        told: HandTold | None,
        settings: VerdictSettings,
    ) -> HandState | None:
        """The hand of a frame with the object at `pose` (4, 4), None when it has let go: nothing is felt, and where it
        was felt last in the hand is no object. It is not carried then, until something is felt again. told: by the
        last look at the hand; late: the frame is older than the last one, and says nothing of what is held now.
        """
        if hand is None or late:
            return hand
        lateness = self.lateness if told is None else self.lateness.of_hand
        self.lateness = lateness.looked(told, se3.apply(pose, model.centroid[None])[0])
        right = self.corrected(None if told is None else told.correction)
        at = hand.camera_from_hand if right is None else right @ hand.camera_from_hand
        if len(hand.points):
            self.released = self.apart = False
            off = model.field.distance(se3.apply(se3.inverse(pose) @ at, hand.points))
            if (np.abs(off) <= settings.outlier_distance).mean() >= settings.least_contacts:
                self.held = self.held.touching
        elif self.touched is not None and not self.released:
            self.released = self.touched.is_let_go(model, pose, at @ self.touched.hold, at, settings)
        return None if self.released or self.apart or self.held.stays else hand

    def smear(self, model: ObjectModel, index: int, pose: Array, settings: VelocitySettings) -> Array:
        """(6,) by how much an object at `pose` (4, 4) in frame `index` may be elsewhere at the time that the frame is
        said to be of, where only its motion tells: what moves with a hand that is known is seen where that is seen.
        """
        frames = index - self.index
        if self.hand is not None or self.belief is None or frames <= 0:
            return np.zeros(6)
        before = model.symmetries.nearest(self.belief.pose, pose)
        step = se3.difference(pose, before, model.centroid) / frames
        # what comes from farther was not moved there, but was taken for something else before
        far = np.linalg.norm(step[:3]) > FASTEST_TURN or np.linalg.norm(step[3:]) > FASTEST
        return np.zeros(6) if far else settings.exposure * step

    def corrected(self, seen: Array | None) -> Array | None:
        """(4, 4) camera_from_camera of what the robot reports, as looks at the hand have it; seen: as the last has it,
        None where no image has shown the hand.
        """
        return seen if seen is None or self.known is None else self.known.correction

    def judged(self, index: int, sure: bool, settings: RenewalSettings) -> None:
        """Whether the answer to a frame is sure; one that is not any more hastens the next search."""
        if self.sure and not sure:
            self.renewal.hurry(index, settings)
        self.sure = sure

    @property
    def said(self) -> tuple[str, ...]:
        """Notes of what holds for this frame and the next ones."""
        return *self.lateness.said, *self.held.said

    def told(self, belief: Belief, settings: SizeSettings, sizes: Sizes | None = None) -> Belief:
        """A belief as wide as it is to be told; sizes: with those of a look that is not remembered yet."""
        told = self.jumps.told_of((sizes or self.sizes).told_of(belief, settings), settings)
        smear = self.lateness.smear
        return replace(told, own=told.own + np.outer(smear, smear)) if smear.any() else told
