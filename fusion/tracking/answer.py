"""What a track says of a frame, and its settings. Camera frame, metres, radians."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion.estimation.answer import Estimate, Mode, Stage
from fusion.estimation.asked import sure_to_be_within
from fusion.estimation.posterior import verdict as posterior
from fusion.estimation.posterior.confidence import ConfidenceSettings, near_enough
from fusion.estimation.posterior.whole import whole_covariance
from fusion.estimation.search.modes import PlanSettings
from fusion.estimation.settings import EstimateSettings
from fusion.estimation.solve.settings import JointSettings
from fusion.tracking.filter import Belief
from fusion.tracking.memory.hypotheses import HypothesisSettings
from fusion.tracking.memory.occluders import OccluderSettings
from fusion.tracking.memory.sizes import SizeSettings
from fusion.tracking.memory.state import GlanceSettings, RenewalSettings
from fusion.tracking.motion import HandMotionSettings
from fusion.tracking.slip import WatchSettings
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Frame
from vision.look.warm import WarmLookSettings
from vision.tracking.by_image import MarkSettings
from vision.tracking.by_vision import VelocitySettings

Array = NDArray[np.float64]

# Why a frame tells nothing of the object, and where that leaves it: "" with the hand, or at its last velocity.
Because = tuple[str, str]
NOTHING_SENSED: Because = ("nothing sensed in this frame", "")
OUT_OF_SIGHT: Because = ("out of sight, and what is felt contradicts every pose near where it was", "")


@dataclass(frozen=True)
class ByPictureSettings:
    """What competes with a fit of the rows where nothing tells what hides the object (`steps.by_picture`). By
    judgement; tried on 40 sequences of the tuning families `stranger` and `borrowed`: of 1200 frames 70.8 % right
    before, 76.8 after.
    """

    # How many of the fit, the prediction and draws around both are fitted at most, and the nats by which one must be
    # likelier than the fit of the rows: pictures of one pose by other rays differ by one.
    fitted: int = 4
    least: float = 2.0


# A search that is not done anew.
ONCE = PlanSettings(anew=0.0, drawn_again=2)


@dataclass(frozen=True)
class TrackSettings:
    """Tracking with both senses; `first` is how the first frame, and a lost object, is found. Values tuned on
    generated sequences.
    """

    # What a track does not find in one frame it looks for in the next: no frame is searched twice, and as many pairs of
    # pixels are drawn as where none is.
    first: EstimateSettings = field(default_factory=lambda: EstimateSettings(plan=ONCE))
    # Whether a track is `ok` only where it is known which way round the object lies: a frame to come may tell, and
    # until then each way is followed. In place of `first`'s own `VerdictSettings.way_round`.
    way_round: bool = True
    look: WarmLookSettings = field(default_factory=WarmLookSettings)
    velocity: VelocitySettings = field(default_factory=VelocitySettings)
    marks: MarkSettings = field(default_factory=MarkSettings)
    hand: HandMotionSettings = field(default_factory=HandMotionSettings)
    slip: WatchSettings = field(default_factory=WatchSettings)
    # Blur (m) of the first of two passes: as wide as a slip in one frame.
    blur: float = 0.003
    # The prior of a frame's own answer is the prediction widened by this much, so that a slip is not held back and
    # directions that nothing tells of stay where they are (rad, m).
    loose_angle: float = float(np.deg2rad(6.0))
    loose_distance: float = 0.006
    # A frame's own answer this many times those widths from the prediction is not trusted: the object is searched.
    leap: float = 2.5
    # The joint solution starts within a millimetre and knows the size of the shared errors from the first frames.
    joint: JointSettings = field(default_factory=lambda: JointSettings(steps=4, most_inducing=24, spacing=1.6, modes=1))
    level_frames: int = 3
    # Share of the variance that the solution takes for independent noise which really changes from frame to frame; it
    # counts pixels by a part because neighbours share errors, and the rest of these stays. Of 19 sequences of `lab` the
    # squared change of a frame's own answer to the next was 1.1 of what this says.
    noise: float = 0.6
    # Share of the first estimate's variance that later frames do not average out.
    first_lasting: float = 0.6
    # How large what all frames share is, by what looks leave unexplained.
    sizes: SizeSettings = field(default_factory=SizeSettings)
    # ADD-S over the root mean square (no unit) of how far a track's covariance has the surface off. By geometry it is
    # 0.8; single frames' is 0.56, because theirs are wide for the sake of tails that a track, which learns how large
    # its errors are, has less of. With theirs tracks of bad rigs said 99 % where 90 % were right. It makes what 347
    # sequences of the tuning families state of 3, 5 and 10 mm likeliest: 0.65 to 0.8 by family. Where nothing tells
    # what hides the object a track is as wide as its frames, and states what they do.
    nearest: float = 0.7
    # What competes with a fit of the rows where nothing tells what hides the object.
    by_picture: ByPictureSettings = field(default_factory=ByPictureSettings)
    # Which frames are only glanced at.
    glance: GlanceSettings = field(default_factory=GlanceSettings)
    # Poses carried from frame to frame until the data decide, and how often frames are searched without a memory.
    hypotheses: HypothesisSettings = field(default_factory=HypothesisSettings)
    renewal: RenewalSettings = field(default_factory=RenewalSettings)
    # Things that go with the object without being it.
    occluders: OccluderSettings = field(default_factory=OccluderSettings)
    # Rays along each side of an outline inside which pixels are the object's, and room (m) around predicted poses
    # that their picture needs.
    side: int = 28
    room: float = 0.03
    # Nats by which the picture of a frame searched by itself must be better than the track's for the track to begin
    # anew from there, although the two are one hypothesis: so drift has a bound.
    anchor: float = 3.0
    # Lost: the share of explained pixels falls below this part of the usual one.
    least_of_usual: float = 0.6
    fewest_pixels: int = 40
    # Share of a mask's readings near the object at least: where fewer are, the mask shows it elsewhere, and it is
    # followed there. A mask that half of is something else's is none.
    shown: float = 0.5
    # Frames without evidence for which a held object is still where the hand has carried it (30 = a second).
    coast: int = 30
    # Where a lost object is looked for first (rad, m); it is looked for everywhere in the second frame in which it is
    # lost, in the first where that has nothing near the prediction, and then every so many.
    near_angle: float = float(np.deg2rad(10.0))
    near_distance: float = 0.02
    global_every: int = 5
    # Share by which focal lengths may change from one frame to the next (a zoom), and images of another lens that are
    # not looked at before it is believed.
    zoom: float = 0.1
    other_lens: int = 5
    # Confidence (a probability, no unit) from which what is found everywhere is followed though it is ambiguous: more
    # likely right than not, where nothing else is known. It is not ok before other frames have found it, too.
    found_again: float = 0.5
    # And that (a probability, no unit) from which what is found around the prediction is: of 16 such answers of tuning
    # sequences (`stranger`, `borrowed`) below it none was right, of 22 from there to 0.6 eight.
    found_near: float = 0.3
    # Error that is left in the robot's frame after the hand was last seen (rad, m), and motion of what is seen
    # relative to a fixed camera, per frame without a hand.
    left_angle: float = float(np.deg2rad(0.15))
    left_distance: float = 0.001

    def asked(self, sure_within: float | None, model: ObjectModel) -> TrackSettings:
        """With the tolerance (ADD-S, m) that answers are to be sure within, None for these settings' own, and a track's
        rules of what is `ok`. Raises InputError for a tolerance that is none, or beyond the object.
        """
        first = sure_to_be_within(self.first, sure_within, model)
        return replace(self, first=replace(first, verdict=replace(first.verdict, way_round=self.way_round)))

    @property
    def confident(self) -> ConfidenceSettings:
        """How sure a tracked answer is, by its own covariance, where it is known what hides the object."""
        how = self.first.confidence
        seen, felt = (replace(one, nearest=self.nearest) for one in (how.seen, how.felt))
        return replace(how, seen=seen, felt=felt)

    def is_far(self, step: Array) -> bool:
        """Farther from the prediction (6,) than the prior of a frame's own answer is wide, and pulled by it."""
        turn, move = np.linalg.norm(step[:3]), np.linalg.norm(step[3:])
        return bool(turn > self.loose_angle or move > self.loose_distance)

    def leaps(self, step: Array, room: Array | None = None) -> bool:
        """Farther from the prediction (6,) than few steps are to be trusted: another place was found by chance. room
        (6, 6): covariance of what prediction and frame leave open; a step within that is none.
        """
        if room is not None and float(step @ np.linalg.solve(room, step)) <= self.glance.surprise:
            return False
        turn, move = np.linalg.norm(step[:3]), np.linalg.norm(step[3:])
        return bool(turn > self.leap * self.loose_angle or move > self.leap * self.loose_distance)


@dataclass(frozen=True, eq=False, repr=False)
class TrackedEstimate(Estimate):
    """An estimate that remembers. how: "started", "tracked", "carried" (nothing sensed: moved with the hand),
    "re-initialised" or "lost"; slip: the object moves in the hand otherwise than its fingers; slip_statistic: the test
    of it, above 1 is a slip; moved_in_hand: it moves against the palm, with the fingers or without.
    """

    how: str = "tracked"
    slip: bool = False
    slip_statistic: float = 0.0
    moved_in_hand: bool = False

    def to_json(self) -> dict[str, Any]:
        """The frame's entry of result.json, with the track's own words under "tracking"."""
        said = {
            "how": self.how,
            "slip": self.slip,
            "slip_statistic": float(self.slip_statistic),
            "moved_in_hand": self.moved_in_hand,
        }
        return {**super().to_json(), "tracking": said}


def as_tracked(answer: Estimate, how: str) -> TrackedEstimate:
    """An estimate as a member of a track."""
    own = {name: getattr(answer, name) for name in Estimate.__dataclass_fields__}
    return TrackedEstimate(**own, how=how)


def as_carried(
    model: ObjectModel,
    frame: Frame,
    predicted: Belief,
    trace: tuple[Stage, ...],
    held: bool,
    by_hand: bool,
    because: Because,
    correction: Array,
    right: float,
    settings: TrackSettings,
) -> TrackedEstimate:
    """The answer of a frame that tells nothing of the object, because ...: where the prediction has it.

    held: it may still be believed, as likely as the track was right (a probability) and near enough; by_hand: the hand
    has carried it there, otherwise its last velocity. correction (4, 4): camera_from_camera of what the robot reports.
    """
    covariance, how = predicted.covariance, settings.confident
    right = right if held else 0.0
    modes = (Mode(predicted.pose, 1.0, 0.0, covariance),)
    reason, moved = because
    why = f"{reason}: " + (moved or ("moved with the hand" if by_hand else "at its last velocity"))
    return TrackedEstimate(
        frame=frame.index,
        pose=predicted.pose,
        covariance=whole_covariance(model, modes, how.none_of(right), None, how),
        modes=modes,
        verdict="ambiguous" if held else "lost",
        unobservable=posterior.unobservable(model, predicted.pose, covariance, settings.first.verdict),
        hand_from_object=frame.hand_from_object(predicted.pose, correction),
        visible_fraction=0.0,
        trace=trace,
        notes=(why,),
        start=predicted.pose,
        confidence=right * near_enough(model, modes[0], how),
        sure_within=how.tolerance,
        how="carried",
    )
