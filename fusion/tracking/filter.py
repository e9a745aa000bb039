"""What a tracker believes from frame to frame, and when it stops believing that the object is held.

Errors of an estimate are of two kinds. Independent noise of pixels and contacts averages out over frames; what all
frames share (calibration, depth scale and bias, joint errors) does not, however many there are. A belief carries the
two covariances apart: a Kalman update shrinks the first and passes the second through its gain (a consider filter,
Schmidt 1966), so a long track is not sure of what a calibration got wrong. Chart: poses.perturb about the centroid,
camera axes.
"""

from __future__ import annotations

import math
from copy import copy
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from fusion.estimation.answer import Estimate
from fusion.tracking.spans import SpanSettings, SpanTest
from scenes.evidence.modes import Mode
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel

Array = NDArray[np.float64]

# Frames (no unit) whose fits leave the same wide open, and together tell of it no more than one does: a second of them.
# And what is wide (rad, and radii of the object): of a handle that is known to less than it is wide fits still tell how
# it turns, beyond that they wander.
REPEATED, WIDE = 30.0, 0.35


@dataclass(frozen=True)
class Belief:
    """pose (4, 4) camera_from_object; own (6, 6): covariance that frames average out; shared (6, 6): what stays; hidden
    (6, 6): what stays, too, of directions of which no frame tells (memory.untold); crept (6, 6): by how much
    the last prediction has made `own` wider.
    """

    pose: Array
    own: Array
    shared: Array
    hidden: Array = field(default_factory=lambda: np.zeros((6, 6)))
    crept: Array = field(default_factory=lambda: np.zeros((6, 6)))

    @staticmethod
    def begun(answer: Estimate, lasting: float) -> Belief:
        """Of a frame searched by itself; lasting: share of its variance that later frames do not average out."""
        wide = answer.modes[0].covariance
        return Belief(answer.pose, (1.0 - lasting) * wide, lasting * wide)

    @property
    def covariance(self) -> Array:
        """(6, 6) of all together."""
        return self.own + self.shared + self.hidden

    def moved(self, camera_from_camera: Array) -> Belief:
        """The same after a rigid motion (4, 4) of hand and object together."""
        turn = block(camera_from_camera[:3, :3])
        parts = (turn @ one @ turn.T for one in (self.own, self.shared, self.hidden, self.crept))
        return Belief(camera_from_camera @ self.pose, *parts)

    def shifted(self, delta: Array, noise: Array, centre: Array) -> Belief:
        """The same after a motion (6,) of the object alone, known with covariance noise (6, 6)."""
        return replace(self, pose=se3.perturb(self.pose, delta, centre)).widened(noise)

    def widened(self, noise: Array) -> Belief:
        """The same after a motion that is known to a covariance (6, 6)."""
        return replace(self, own=self.own + noise, crept=noise)


@dataclass(frozen=True)
class Measurement:
    """One frame's own answer, without the prediction: pose (4, 4); own, shared and hidden as in a Belief; biased
    (6, 6): what of `shared` comes of the depth bias, and is otherwise elsewhere in the image.
    """

    pose: Array
    own: Array
    shared: Array
    biased: Array = field(default_factory=lambda: np.zeros((6, 6)))
    hidden: Array = field(default_factory=lambda: np.zeros((6, 6)))

    @staticmethod
    def of(pose: Array, independent: Array, shared: Array, biased: Array, noise: float) -> Measurement:
        """From what independent noise and shared errors, the depth bias's among them, make of the frame's covariance
        (6, 6); noise: share of the former that the next frame does not have, too.
        """
        return Measurement(pose, noise * independent, shared + (1.0 - noise) * independent, biased)

    def alone(self) -> Belief:
        """The belief of who knows nothing else."""
        return Belief(self.pose, self.own, self.shared, self.hidden)

    def smeared(self, by: Array) -> Measurement:
        """The same of a thing that moves by so much (6,) in the time that the frame may be off by."""
        return replace(self, own=self.own + np.outer(by, by))


def block(rotation: Array) -> Array:
    """(6, 6) that turns rotation and displacement alike."""
    out = np.zeros((6, 6))
    out[:3, :3] = out[3:, 3:] = rotation
    return out


def moved_modes(modes: tuple[Mode, ...], motion: Array) -> tuple[Mode, ...]:
    """Modes after a rigid motion (4, 4) of hand and object together."""
    turn = block(motion[:3, :3])
    return tuple(replace(m, pose=motion @ m.pose, covariance=turn @ m.covariance @ turn.T) for m in modes)


def scales(model: ObjectModel) -> Array:
    """(6,) units in which a turn and a displacement of the object weigh alike: 1 rad and its radius."""
    return np.repeat([1.0, model.radius], 3)


def positive_part(matrix: Array, scale: Array) -> Array:
    """The nearest positive semi-definite matrix (6, 6), in units of scale (6,)."""
    return _spectral(matrix[None], scale)[0][0]


def _spectral(matrices: Array, scale: Array) -> tuple[Array, Array]:
    """Positive parts (n, 6, 6) of symmetric matrices (n, 6, 6), in units of scale (6,), and the square roots of those
    parts without units.
    """
    unit = scale * scale[:, None]
    values, vectors = np.linalg.eigh(0.5 * (matrices + matrices.transpose(0, 2, 1)) / unit)
    values, turned = np.maximum(values, 0.0)[:, None], vectors.transpose(0, 2, 1)
    return (vectors * values) @ turned * unit, (vectors * np.sqrt(values)) @ turned


def surplus(model: ObjectModel, measured: Measurement, shared: Array) -> Array:
    """(6, 6) by how much more a frame shares with others of its sense alone than is `shared` (6, 6) with those before
    it: where images have said where an object is, a calibration that is off moves what fingers say, and no object. 0 of
    a frame that an image tells of, whose depth bias is another's, too.
    """
    if measured.biased.any():
        return np.zeros((6, 6))
    return positive_part(measured.shared - shared, scales(model))


def repeated(model: ObjectModel, untold: Array) -> Array:
    """(6, 6) as how wide a frame counts of what it leaves open (6, 6), which its neighbours leave open, too."""
    scale = scales(model)
    values, vectors = np.linalg.eigh(untold / scale / scale[:, None])
    values = np.maximum(values, 0.0)
    axes = vectors * scale[:, None]
    return np.asarray((axes * values * (1.0 + (REPEATED - 1.0) * values / (values + WIDE**2))) @ axes.T)


def relearned(model: ObjectModel, predicted: Belief, measured: Measurement) -> Belief:
    """A belief of which what frames share is as a later frame has it, which was told more of it than the first; but of
    what that does not tell it stays as unsure as it was.
    """
    scale = scales(model)
    more = positive_part(predicted.shared - measured.shared, scale)
    wide = measured.own + measured.shared + measured.hidden + np.diag((1e-9 * scale) ** 2)  # where nothing is open, too
    untold = np.linalg.solve(wide, measured.hidden).T
    return replace(predicted, own=predicted.own + untold @ more @ untold.T, shared=measured.shared)


def update(model: ObjectModel, predicted: Belief, measured: Measurement, held: bool = True) -> Belief:
    """The belief after a frame's own answer.

    The gain weighs the prediction's own covariance against the frame's, plus by how much the frame's shared error is
    larger than the belief's (a frame of touch alone must not drag a seen object to where the calibration has it), and
    plus what no frame tells (where a fit has turned a handle that is out of sight is chance, and says of no turn).
    Shared errors are taken as one and the same source: A A^T with A = (I - K) S_predicted^1/2 + K S_measured^1/2. So is
    what no frame tells, in which a frame counts by that share of it that so many like it leave it: the turn of a handle
    that was seen, or that a start has told, is known as well when it is out of sight. But what moves it is seen no more
    than it is: it may be the same from step to step, so that the error grows with them, up to what frames leave open.
    What no hand holds (held) turns by itself, and of it no more is known than each frame tells.
    """
    scale = scales(model)
    five = [measured.shared - predicted.shared, predicted.shared, measured.shared, predicted.hidden, measured.hidden]
    (surplus, *_), (_, *roots) = _spectral(np.array(five), scale)
    untold = repeated(model, measured.hidden) if held else np.zeros((6, 6))
    gain = _gain(predicted.own, measured.own + surplus, untold, scale)
    rest = np.eye(6) - gain
    innovation = se3.difference(measured.pose, predicted.pose, model.centroid)
    own = rest @ predicted.own @ rest.T + gain @ measured.own @ gain.T
    unitless = gain * scale / scale[:, None]
    mixed = [(np.eye(6) - unitless) @ before + unitless @ now for before, now in (roots[:2], roots[2:])]
    mixed[1] += (_unseen(predicted.crept, roots[3], scale) if held else 1.0) * (roots[3] - mixed[1])
    shared, hidden = (root @ root.T * scale * scale[:, None] for root in mixed)
    pose = se3.perturb(predicted.pose, gain @ innovation, model.centroid)
    return Belief(pose, 0.5 * (own + own.T), 0.5 * (shared + shared.T), 0.5 * (hidden + hidden.T))


def _gain(before: Array, now: Array, untold: Array, scale: Array) -> Array:
    """(6, 6) Kalman's, of covariances (6, 6) of the belief and of a frame that leaves untold open beside its own. What
    is wide open is by itself: what else a frame tells says nothing of it, however the two go together in a fit of
    another turn.
    """
    values, vectors = np.linalg.eigh(untold / scale / scale[:, None])
    values, axes, along = np.maximum(values, 0.0), vectors * scale[:, None], vectors / scale[:, None]
    before, now = along.T @ before @ along, along.T @ now @ along
    own, its = np.diag(before).copy(), np.diag(now).copy()
    told = (own + its) / np.maximum(own + its + values, 1e-300)
    both = np.outer(told, told)
    before, now = both * before + np.diag((1.0 - told**2) * own), both * now + np.diag((1.0 - told**2) * its)
    return np.asarray(axes @ np.linalg.solve(before + now + np.diag(values), before).T @ along.T)


def _unseen(crept: Array, root: Array, scale: Array) -> float:
    """Standard deviation of a step (6, 6), as a share of what frames leave open (root (6, 6), in units of scale) where
    they leave most open.
    """
    values, vectors = np.linalg.eigh(root)
    along = vectors[:, -1] / scale
    variance = max(float(along @ crept @ along), 0.0)
    return min(1.0, math.sqrt(variance) / max(float(values[-1]), 1e-9))


def gone_on(model: ObjectModel, before: Belief, tracked: Array, found: Belief, untold: Array | None = None) -> Belief:
    """A belief of where a frame, tracked to a pose (4, 4) by what was believed before, was `found` when it was searched
    by itself; but of what no frame tells (6, 6), of which one search knows no more than the track does, as it was, if
    a hand has held it.
    """
    step, scale = se3.difference(found.pose, tracked, model.centroid), scales(model)
    hidden = np.zeros((6, 6)) if untold is None else repeated(model, untold)
    values, vectors = np.linalg.eigh(hidden / scale / scale[:, None])
    axes, along = vectors * scale[:, None], vectors / scale[:, None]  # of what is told, and is not
    room = np.einsum("ik,ij,jk->k", along, found.covariance, along) + (along.T @ step) ** 2
    gain = (axes * (room / np.maximum(room + np.maximum(values, 0.0), 1e-300))) @ along.T
    rest, step = np.eye(6) - gain, gain @ step
    own = found.own + rest @ before.own @ rest.T + np.outer(step, step)
    pose = se3.perturb(tracked, step, model.centroid)
    return replace(found, pose=pose, own=0.5 * (own + own.T), hidden=rest @ before.hidden @ rest.T)


def after_slip(model: ObjectModel, predicted: Belief, measured: Measurement) -> Belief:
    """As `update`, of an object that has slipped: what was believed of the hold is worth no more than how far it was
    off, and of what frames do not tell nothing.
    """
    step = se3.difference(measured.pose, predicted.pose, model.centroid)
    after = update(model, replace(predicted, own=predicted.own + np.outer(step, step)), measured)
    return replace(after, hidden=measured.hidden)


@dataclass(frozen=True)
class TrackSlipSettings:
    """When an object that should be held has moved in the hand. Values tuned on generated sequences."""

    # A squared innovation (chi-square, 6 degrees of freedom) above this in one frame: one in 10^8 by chance.
    alarm: float = 50.0
    # Several frames together (Page's cumulative sum of those squares, 1954): what a frame may add without counting, and
    # the limit. Of 46 sequences of `lab` in which nothing closes anew 6 had a false alarm with 30, 3 with 60, and of 28
    # slides as many were said.
    allowance: float = 12.0
    limit: float = 60.0
    # Limit of the same sum (chi-square) of what the fingertips' own motion is off any rigid one.
    sliding: float = 30.0
    # Errors of two frames that no covariance speaks of: bent surfaces, other pixels (rad, m).
    floor_angle: float = float(np.deg2rad(0.2))
    floor_distance: float = 0.0002
    # Motion below this is no slip, whatever its significance (rad, m).
    least_angle: float = float(np.deg2rad(1.0))
    least_distance: float = 0.0007
    # Frames after a slip's last sign during which it is still going on.
    lasts: int = 2
    # Frames after that which are looked at in full: what looks have in common is not what it was before the slip. By 48
    # sequences of `lab`, `clean` and `rough` whose object slips or slides rotation at the end falls from 0.78 to 0.69
    # degrees (single frames: 0.72).
    settles: int = 2
    # A span of frames against an earlier one.
    spans: SpanSettings = field(default_factory=SpanSettings)


class SlipTest:
    """Compares each frame's own answer with a belief that never lets the object move in the hand.

    That belief averages over all frames since the last slip: a slow slip, each step of it within the noise, adds up
    against it. Page's cumulative sum of the squared innovations decides; so does what two spans of frames differ by
    (fusion.tracking.spans), and the fingertips' own motion where no rigid motion of the object explains it.
    """

    def __init__(self, model: ObjectModel, length: float, settings: TrackSlipSettings | None = None) -> None:
        """length: correlation length of the depth bias in pixels, over which shared errors change."""
        self.model = model
        self.settings = settings or TrackSlipSettings()
        self._length = length
        self._spans = SpanTest(model, length, self.settings.spans)
        self._held: Belief | None = None
        self._pixel: Array | None = None
        self._sum = self._slid = 0.0
        self._quiet = 1_000_000
        self.statistic = 0.0

    @property
    def going_on(self) -> bool:
        """Whether the last step was in a slip or just after it."""
        return self._quiet <= self.settings.lasts

    @property
    def settling(self) -> bool:
        """Whether a slip has just ended, so that what looks have in common is to be found anew."""
        return 0 <= self._quiet - self.settings.lasts < self.settings.settles

    def copied(self) -> SlipTest:
        """Another that has seen the same."""
        other = copy(self)
        other._spans = copy(self._spans)
        return other

    def restart(self, belief: Belief | None, pixel: Array | None) -> None:
        """Forget; the object is held as `belief` has it, seen at `pixel` (2,) (None without a camera)."""
        self._held, self._pixel = belief, pixel
        self._spans.forget()
        self._sum = self._slid = self.statistic = 0.0

    def predict(
        self, camera_from_camera: Array, delta: Array, noise: Array, sliding: float = 0.0, drift: Array | None = None
    ) -> None:
        """Move with the hand (4, 4), and by what the fingers do to the object (6,), camera axes, known to noise (6, 6);
        sliding: chi-square by which the fingertips' own motion contradicts contacts that stick. drift (6, 6): what a
        wrong calibration makes of it, beside the noise.
        """
        drift = np.zeros((6, 6)) if drift is None else drift
        self._spans.predict(camera_from_camera, delta, noise, np.sqrt(np.diag(drift)))
        if self._held is not None:
            self._held = self._held.moved(camera_from_camera).shifted(delta, noise + drift, self.model.centroid)
        self._slid = max(0.0, self._slid + sliding - 0.5 * self.settings.allowance)

    def step(self, measured: Measurement, belief: Belief, pixel: Array | None) -> bool:
        """Whether the object slips in this frame. belief: the tracker's own, to start from after a slip."""
        if self._held is None:
            self.restart(belief, pixel)
            self._quiet += 1
            return False
        s, centre = self.settings, self.model.centroid
        changed = 2.0 * (1.0 - self._correlation(pixel)) * measured.biased
        floor = np.diag(np.repeat([s.floor_angle, s.floor_distance], 3) ** 2)
        # a handle out of sight may be anywhere, and what is said of it tells of no motion
        # nor does what frames of one sense share and others do not, where the last was of another
        other = surplus(self.model, measured, self._held.shared)
        noise = measured.own + changed + measured.hidden + other + floor
        innovation = se3.difference(measured.pose, self._held.pose, centre)
        square = float(innovation @ np.linalg.solve(self._held.own + noise, innovation))
        self._sum = max(0.0, self._sum + square - s.allowance)
        squared, step = self._spans.add(measured.pose, measured.own, measured.biased, measured.hidden, pixel, other)
        held = min(max(square / s.alarm, self._sum / s.limit), self._moved(innovation))
        self.statistic = max(held, min(squared / s.spans.limit, self._moved(step)), self._slid / s.sliding)
        if self.statistic > 1.0:
            statistic = self.statistic
            self.restart(belief, pixel)
            self.statistic = statistic
            self._quiet = 0
            return True
        self._held = update(self.model, self._held, replace(measured, own=noise))
        if self._pixel is None:
            self._pixel = pixel
        elif pixel is not None:
            self._pixel = 0.9 * self._pixel + 0.1 * pixel
        self._quiet += 1
        return self._quiet <= s.lasts

    def _moved(self, step: Array) -> float:
        """How large a motion (6,) is, in units of the least that is a slip."""
        s = self.settings
        return float(max(np.linalg.norm(step[:3]) / s.least_angle, np.linalg.norm(step[3:]) / s.least_distance))

    def _correlation(self, pixel: Array | None) -> float:
        if pixel is None or self._pixel is None:
            return 1.0
        return float(np.exp(-0.5 * np.sum((pixel - self._pixel) ** 2) / self._length**2))
