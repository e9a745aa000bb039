"""What a tracker believes from frame to frame, and when it stops believing that the object is held.

Errors of an estimate are of two kinds. Independent noise of pixels and contacts averages out over frames; what all
frames share (calibration, depth scale and bias, joint errors) does not, however many there are. A belief carries the
two covariances apart: a Kalman update shrinks the first and passes the second through its gain (a consider filter,
Schmidt 1966), so a long track is not sure of what a calibration got wrong. Chart: poses.perturb about the centroid,
camera axes.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from fusion.tracking.spans import SpanSettings, SpanTest
from scenes.evidence.modes import Mode
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Belief:
    """pose (4, 4) camera_from_object; own (6, 6): covariance that frames average out; shared (6, 6): what stays; hidden
    (6, 6): what stays, too, of directions of which no frame tells (fusion.tracking.untold).
    """

    pose: Array
    own: Array
    shared: Array
    hidden: Array = field(default_factory=lambda: np.zeros((6, 6)))

    @property
    def covariance(self) -> Array:
        """(6, 6) of all together."""
        return self.own + self.shared + self.hidden

    def moved(self, camera_from_camera: Array) -> Belief:
        """The same after a rigid motion (4, 4) of hand and object together."""
        turn = block(camera_from_camera[:3, :3])
        parts = (turn @ one @ turn.T for one in (self.own, self.shared, self.hidden))
        return Belief(camera_from_camera @ self.pose, *parts)

    def shifted(self, delta: Array, noise: Array, centre: Array) -> Belief:
        """The same after a motion (6,) of the object alone, known with covariance noise (6, 6)."""
        return replace(self, pose=se3.perturb(self.pose, delta, centre), own=self.own + noise)


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


def update(model: ObjectModel, predicted: Belief, measured: Measurement) -> Belief:
    """The belief after a frame's own answer.

    The gain weighs the prediction's own covariance against the frame's, plus by how much the frame's shared error is
    larger than the belief's (a frame of touch alone must not drag a seen object to where the calibration has it).
    Shared errors are taken as one and the same source: A A^T with A = (I - K) S_predicted^1/2 + K S_measured^1/2. What
    no frame tells is as the measurement has it, which has learned it from all of them.
    """
    scale = scales(model)
    three = np.array([measured.shared - predicted.shared, predicted.shared, measured.shared])
    (surplus, _, _), (_, before, now) = _spectral(three, scale)
    gain = np.linalg.solve(predicted.own + measured.own + surplus, predicted.own).T
    rest = np.eye(6) - gain
    innovation = se3.difference(measured.pose, predicted.pose, model.centroid)
    own = rest @ predicted.own @ rest.T + gain @ measured.own @ gain.T
    unitless = gain * scale / scale[:, None]
    mixed = (np.eye(6) - unitless) @ before + unitless @ now
    shared = mixed @ mixed.T * scale * scale[:, None]
    pose = se3.perturb(predicted.pose, gain @ innovation, model.centroid)
    return Belief(pose, 0.5 * (own + own.T), 0.5 * (shared + shared.T), measured.hidden)


def after_slip(model: ObjectModel, predicted: Belief, measured: Measurement) -> Belief:
    """As `update`, of an object that has slipped: what was believed of the hold is worth no more than how far it was
    off.
    """
    step = se3.difference(measured.pose, predicted.pose, model.centroid)
    return update(model, replace(predicted, own=predicted.own + np.outer(step, step)), measured)


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
