"""Vision's tracker: each frame aligned from where the last ones lead to, with loss detection and a new start.

Frame to frame, with a constant-velocity prior: the rows of the pixels near the predicted pose, one Levenberg-Marquardt
from a few starts, a check of what the pose explains. A lost object is looked for around where it was last seen, then
everywhere. Poses are camera_from_object (4, 4), metres; covariances as everywhere (poses.perturb about the centroid).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from scenes.evidence import table as tables
from scenes.evidence.align import AlignSettings, Prior, align
from scenes.evidence.modes import covariance_of
from scenes.evidence.search import SearchStage, search, starts_around
from scenes.evidence.table import SIGMA, Evidence
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.beliefs import Beliefs
from scenes.recordings.frames import Frame
from vision.look.look import LookSettings, look
from vision.look.looked import free_space_rows, surface_rows
from vision.look.warm import Looker, WarmLookSettings
from vision.sight import Sight
from vision.starts import pixel_starts

Array = NDArray[np.float64]

# Turning farther than this between two frames (rad) is a mistake, not a speed.
FASTEST_TURN = 0.5
# And moving farther (m): 1.5 m/s at 30 frames a second.
FASTEST = 0.05


@dataclass(frozen=True)
class VelocitySettings:
    """How an object moves that nothing is known of: its last velocity, and what that leaves open a frame later.
    Values by judgement.
    """

    # Share of the last velocity that is believed: full extrapolation doubles the noise of the two poses it is made of.
    damping: float = 0.8
    # Standard deviation of what the velocity does not explain, per axis and frame: a tool at 0.2 m/s and 1 rad/s that
    # stops within three frames of a 30 Hz camera (rad, m).
    angle: float = float(np.deg2rad(2.0))
    distance: float = 0.003
    # Share of the motion from frame to frame by which what is seen may be elsewhere than at the time that the frame is
    # said to be of: ten milliseconds of exposure after it are 0.15 of it at 30 Hz.
    exposure: float = 0.12


class ConstantVelocity:
    """Extrapolates the last two poses. Frames count by their index, so a gap is a longer step."""

    def __init__(self, centre: Array, settings: VelocitySettings | None = None) -> None:
        """centre: (3,) the object's centroid, object frame."""
        self.centre = centre
        self.settings = settings or VelocitySettings()
        self.index: int | None = None
        self.pose = np.eye(4)
        self.velocity = np.zeros(6)

    def predict(self, index: int) -> tuple[Array, Array]:
        """The pose (4, 4) expected in frame `index`, and the covariance (6, 6) of what the prediction leaves out."""
        steps = 1 if self.index is None else index - self.index
        # a velocity fades: after a long gap the object may be anywhere near, not far along a line
        fade = self.settings.damping
        share = abs(steps) if fade == 1.0 else fade * (1.0 - fade ** abs(steps)) / (1.0 - fade)
        delta = np.sign(steps) * share * self.velocity
        sigma = np.repeat([self.settings.angle, self.settings.distance], 3) * max(1, abs(steps))
        return se3.perturb(self.pose, delta, self.centre), np.diag(sigma**2)

    def update(self, index: int, pose: Array, own: Array | None = None) -> None:
        """Take the pose found in frame `index`, known to covariance own (6, 6), None for exactly; a frame not newer
        than the last is not taken.
        """
        if self.index is not None and index > self.index:
            delta = se3.difference(pose, self.pose, self.centre) / (index - self.index)
            if own is not None:  # what noise seems to move is no velocity
                change = np.diag(np.repeat([self.settings.angle, self.settings.distance], 3) ** 2)
                before = self.velocity
                delta = before + change @ np.linalg.solve(change + 2.0 * own, delta - before)
            slow = np.linalg.norm(delta[:3]) < FASTEST_TURN and np.linalg.norm(delta[3:]) < FASTEST
            self.velocity = delta if slow else np.zeros(6)
        if self.index is None or index > self.index:
            self.index, self.pose = index, pose

    def corrected(self, pose: Array) -> None:
        """The pose of the last frame was wrong: it is this one, and its velocity stays."""
        self.pose = pose

    def coast(self, index: int) -> None:
        """No pose in this frame: the state moves on by its prediction, and slows down."""
        self.pose, self.index = self.predict(index)[0], index
        self.velocity = self.settings.damping * self.velocity

    def restart(self, index: int, pose: Array) -> None:
        """Begin again at rest."""
        self.index, self.pose, self.velocity = index, pose, np.zeros(6)


@dataclass(frozen=True)
class VisionTrackerSettings:
    """The vision tracker. Values tuned on generated sequences."""

    look: WarmLookSettings = field(default_factory=lambda: WarmLookSettings(most_rows=300))
    # The whole image is searched as it is: nothing is known of a hand.
    first: LookSettings = field(default_factory=lambda: LookSettings(tidy=False))
    velocity: VelocitySettings = field(default_factory=VelocitySettings)
    beliefs: Beliefs = field(default_factory=Beliefs)
    # Blur (m) of the first of two passes over the pixels: as wide as the prediction's error.
    blur: float = 0.004
    # Lost: fewer pixels than this, fewer of them within three sigmas than this share, or seen past at more cells than
    # this many nats (a right pose costs below 10 with a hand in front, see vision.sight).
    fewest_pixels: int = 30
    least_explained: float = 0.4
    most_past: float = 40.0
    # A sudden fall of the explained share to this part of what it was: something else is being followed.
    least_of_usual: float = 0.6
    # Frames of coasting before the object is looked for again; frames between global searches; starts of either.
    patience: int = 1
    global_every: int = 10
    starts_near: int = 200
    starts_global: int = 2500
    # Where it is looked for first: this far around the prediction, per axis (rad, m).
    near_angle: float = float(np.deg2rad(15.0))
    near_distance: float = 0.025


@dataclass(frozen=True)
class VisionTrack:
    """One frame of a track: pose (4, 4); covariance (6, 6); lost; how: "started", "tracked", "coasted",
    "re-initialised"; explained: share of the pixels within three sigmas (NaN without any); pixels: how many.
    """

    frame: int
    pose: Array
    covariance: Array
    lost: bool
    how: str
    explained: float
    pixels: int


class VisionTracker:
    """Follows one object through frames with depth (or clouds)."""

    def __init__(
        self,
        model: ObjectModel,
        pose: Array | None = None,
        settings: VisionTrackerSettings | None = None,
        seed: int = 0,
    ) -> None:
        """pose: a start, camera_from_object (4, 4); None takes the first frame's prior or searches."""
        self.model = model
        self.settings = settings or VisionTrackerSettings()
        self.motion = ConstantVelocity(model.centroid, self.settings.velocity)
        self._looker = Looker(model, self.settings.look, self.settings.first, self.settings.beliefs)
        self._rng = np.random.default_rng(seed)
        self._start = pose
        self._started = False
        self._lost_for = 0
        self._usual: float | None = None

    def step(self, frame: Frame) -> VisionTrack:
        """The object in this frame."""
        if not self._started:
            return self._begin(frame)
        predicted, noise = self.motion.predict(frame.index)
        found = self._follow(frame, predicted, noise)
        if not found.lost:
            self._accept(frame, found)
            return found
        self._lost_for += 1
        if self._lost_for > self.settings.patience:
            again = self._search(frame, predicted, self._lost_for % self.settings.global_every == 0)
            if again is not None:
                self.motion.restart(frame.index, again.pose)
                self._usual, self._lost_for = again.explained, 0
                return again
        self.motion.coast(frame.index)
        return replace(found, pose=predicted, how="coasted")

    def _begin(self, frame: Frame) -> VisionTrack:
        start = self._start if self._start is not None else frame.prior
        found = self._search(frame, start, start is None)
        pose = start if start is not None else np.eye(4)
        if found is None:
            return VisionTrack(
                frame.index, pose, covariance_of(self.model, np.zeros((6, 6))), True, "started", np.nan, 0
            )
        self._started, self._usual = True, found.explained
        self.motion.restart(frame.index, found.pose)
        return replace(found, how="started")

    def _accept(self, frame: Frame, found: VisionTrack) -> None:
        self._lost_for = 0
        usual = found.explained if self._usual is None else self._usual
        self._usual = 0.9 * usual + 0.1 * found.explained
        self.motion.update(frame.index, found.pose)

    def _follow(self, frame: Frame, predicted: Array, noise: Array) -> VisionTrack:
        s = self.settings
        looked = self._looker.look(frame, predicted)
        seen = surface_rows(looked, s.beliefs.depth, self._looker.first.rows)
        if len(seen) < s.fewest_pixels:
            covariance = noise + covariance_of(self.model, np.zeros((6, 6)))
            return VisionTrack(frame.index, predicted, covariance, True, "coasted", np.nan, len(seen))
        rows = tables.stack(seen, free_space_rows(looked, self._looker.first.rows))
        prior = Prior(predicted, np.diag(1.0 / np.diag(noise)))
        starts = np.stack([predicted, self.motion.pose])
        coarse = align(self.model, rows, starts, prior, AlignSettings(blur=s.blur, iterations=8))
        fine = align(self.model, rows, coarse.poses, prior, AlignSettings(iterations=12))
        return self._judged(frame, rows, fine.poses, fine.costs, fine.hessians, predicted, "tracked")

    def _judged(
        self, frame: Frame, rows: Evidence, poses: Array, costs: Array, hessians: Array, reference: Array, how: str
    ) -> VisionTrack:
        """The best of the aligned poses, with what it explains; the symmetric twin nearest to the reference."""
        s = self.settings
        past = Sight(frame, self.model, s.beliefs.depth).costs(poses)
        best = int(np.argmin(costs + past))
        pose = self.model.symmetries.nearest(poses[best], reference)
        explained, count = explained_share(self.model, rows, pose)
        lost = bool(explained < s.least_explained or past[best] > s.most_past)
        if self._usual is not None:
            lost = lost or explained < s.least_of_usual * self._usual
        covariance = covariance_of(self.model, hessians[best])
        return VisionTrack(frame.index, pose, covariance, lost, how, explained, count)

    def _search(self, frame: Frame, around: Array | None, everywhere: bool) -> VisionTrack | None:
        """Look for the object near a pose, or everywhere; None when nothing explains the pixels."""
        s = self.settings
        start = None if everywhere else around
        looked = look(frame, self.model, s.beliefs, start, s.first)
        seen = surface_rows(looked, s.beliefs.depth, self._looker.first.rows)
        if len(seen) < s.fewest_pixels:
            return None
        rows = tables.stack(seen, free_space_rows(looked, self._looker.first.rows))
        prior = None
        if start is not None:
            starts = starts_around(self.model, start, s.near_angle, s.near_distance, s.starts_near, self._rng)
            prior = Prior.isotropic(start, 2 * s.near_angle, 2 * s.near_distance)
            stages: tuple[SearchStage, ...] = (
                SearchStage(3 * s.blur, 0.5, 80, 8, 40),
                SearchStage(s.blur, 0.25, 160, 10, 10),
            )
        else:
            starts = pixel_starts(self.model, looked.pixels.points, s.starts_global, self._rng)
            stages = (
                SearchStage(9 * s.blur, 0.8, 40, 3, 400),
                SearchStage(3 * s.blur, 0.4, 80, 8, 80),
                SearchStage(s.blur, 0.25, 160, 10, 20),
            )
        sight = Sight(frame, self.model, s.beliefs.depth)
        coarse = search(self.model, rows, starts, stages, prior, rank=sight.costs)
        fine = align(self.model, rows, coarse.poses, prior, AlignSettings(iterations=20))
        reference = around if around is not None else fine.poses[0]
        self._usual, usual = None, self._usual
        found = self._judged(frame, rows, fine.poses, fine.costs, fine.hessians, reference, "re-initialised")
        self._usual = usual
        return None if found.lost else found


def explained_share(model: ObjectModel, rows: Evidence, pose: Array) -> tuple[float, int]:
    """Share of the ON rows within three sigmas of the surface at pose (4, 4), and how many there are; NaN for none."""
    on = rows.rows[rows.on]
    if not len(on):
        return float("nan"), 0
    distance = model.field.distance(se3.apply(se3.inverse(pose), on[:, :3]))
    return float(np.mean(np.abs(distance) < 3 * on[:, SIGMA])), len(on)


def track_by_vision(
    frames: Iterable[Frame],
    model: ObjectModel,
    pose: Array | None = None,
    settings: VisionTrackerSettings | None = None,
    seed: int = 0,
) -> Iterator[VisionTrack]:
    """A VisionTracker over frames, one answer a frame."""
    tracker = VisionTracker(model, pose, settings, seed)
    for frame in frames:
        yield tracker.step(frame)
