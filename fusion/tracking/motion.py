"""How an object in a hand moves from one frame to the next, predicted from the robot alone.

A held object moves with the palm. When fingers move, it moves with their tips too: contacts that stick carry the
object's surface along, J x = u with u the displacements of the fingertips' contact points and J the transpose of the
grasp matrix (Salisbury & Craig 1982; Murray, Li & Sastry 1994, section 5.2). Hand frame, metres, radians; x = (theta,
tau) is a poses.perturb about the object's centroid.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.beliefs import CalibrationModel
from scenes.recordings.frames import Contacts, Frame
from vision.look.hand.hand import camera_from_hand

Array = NDArray[np.float64]


@dataclass(frozen=True)
class HandMotionSettings:
    """What a hand's motion says of the object's. Values by judgement."""

    # How far a sticking contact may creep or roll in one frame (m), per axis: fingertips are balls, they roll by
    # about this much on a curved surface when the object turns by two degrees.
    creep: float = 0.0003
    # Width of what fingers may do to an object in one frame when contacts leave it open (rad, m).
    turn: float = float(np.deg2rad(3.0))
    move: float = 0.003
    # The same (rad, m) for the slip test: an object that turns in directions that no finger drives is not held.
    turn_held: float = float(np.deg2rad(0.5))
    move_held: float = 0.0005
    # Fingertips that moved less than this stand still (m): encoders of 0.05 degrees at 10 cm.
    still: float = 5e-5
    # Share of the predicted motion that is not believed.
    doubt: float = 0.3
    # What a held object does in one frame by itself, per axis (rad, m): vibration, soft fingertips.
    angle: float = float(np.deg2rad(0.08))
    distance: float = 0.00008
    # Shares (of a standard deviation, no unit) that are left of what a wrong calibration makes of the hand's turn and
    # displacement, once the hand has been seen and its motion is corrected. Of eight frames' way (`turn`) 0.3 and 0.1
    # are in `lab`, `d435` and `studio`, 0.7 and 0.35 in `rough`, 0.7 and 0.4 in `crude`; uncorrected 0.5 and 0.6, 0.9
    # and 0.9, 1.4 and 1.3.
    left_turn: float = 0.6
    left_move: float = 0.35

    def left(self, seen: bool) -> Array:
        """(6, 6) shares of a variance of what a wrong calibration makes of the hand's motion that are left; seen:
        whether an image has shown the hand.
        """
        each = np.repeat([self.left_turn, self.left_move] if seen else [1.0, 1.0], 3)
        return np.outer(each, each)


def grasp_transpose(points: Array, centre: Array) -> Array:
    """(3 n, 6): displacement of contact points (n, 3) of a body turned by theta about `centre` and moved by tau.

    The transpose of the grasp matrix of n point contacts with friction.
    """
    out = np.zeros((len(points), 3, 6))
    out[:, :, :3] = -se3.skew(points - centre)
    out[:, :, 3:] = np.eye(3)
    return out.reshape(-1, 6)


def carried_by_contacts(
    points: Array, displacements: Array, centre: Array, settings: HandMotionSettings | None = None
) -> tuple[Array, Array, float]:
    """Motion (6,) of a body whose contact points (n, 3) moved by displacements (n, 3), its covariance (6, 6) if they
    stick, and their misfit: the squared residual in units of the creep less its degrees of freedom, at least 0.

    Regularised least squares: what the contacts leave open stays zero, as wide as the settings say.
    """
    s = settings or HandMotionSettings()
    jacobian = grasp_transpose(points, centre)
    information = jacobian.T @ jacobian / s.creep**2
    information += np.diag(np.repeat([s.turn, s.move], 3) ** -2.0)
    motion = np.linalg.solve(information, jacobian.T @ displacements.ravel() / s.creep**2)
    residual = displacements.ravel() - jacobian @ motion
    misfit = max(0.0, float(residual @ residual) / s.creep**2 - max(0, residual.size - 6))
    return np.asarray(motion, dtype=np.float64), np.asarray(np.linalg.inv(information), dtype=np.float64), misfit


@dataclass(frozen=True)
class InHand:
    """A predicted motion in the hand: motion (6,); noise (6, 6) of what may happen instead, sliding contacts included;
    sticking (6, 6): the same if it is held and all contacts stick; still (6, 6): the same of an object that keeps its
    place in the palm; sliding: by how much (chi-square) the contacts' own motion says that some do not stick.
    """

    motion: Array
    noise: Array
    sticking: Array
    still: Array
    sliding: float = 0.0

    def turned(self, rotation: Array) -> InHand:
        """The same in axes turned by rotation (3, 3)."""
        turn = np.kron(np.eye(2), rotation)
        noise, sticking, still = (turn @ x @ turn.T for x in (self.noise, self.sticking, self.still))
        return InHand(turn @ self.motion, noise, sticking, still, self.sliding)


@dataclass(frozen=True)
class HandState:
    """A hand at one instant: camera_from_hand (4, 4) as reported, joints (rad, m), and its fingertips' contacts:
    sensors, names; points (n, 3) hand frame.
    """

    camera_from_hand: Array
    joints: dict[str, float] | None
    sensors: tuple[str, ...]
    points: Array

    @staticmethod
    def of(frame: Frame, contacts: Contacts) -> HandState | None:
        """From a frame and its contacts as felt (camera frame, uncorrected); None without a hand pose."""
        measured = camera_from_hand(frame)
        if measured is None:
            return None
        local = se3.apply(se3.inverse(measured), contacts.points)
        return HandState(measured, frame.joints, tuple(contacts.sensors), local)


def palm_motion(before: HandState, now: HandState, correction: Array | None) -> Array:
    """(4, 4) camera_from_camera: the motion of what the palm carries from one instant to another. correction (4, 4):
    of what the robot reports, None where nothing has told it. A calibration E makes of a motion D what is reported as
    E D E^-1: where E has been seen, it is undone.
    """
    motion = now.camera_from_hand @ se3.inverse(before.camera_from_hand)
    return motion if correction is None else correction @ motion @ se3.inverse(correction)


class HandMotion:
    """Predicts how the object moves in the hand frame between two frames of one hand."""

    def __init__(self, model: ObjectModel, settings: HandMotionSettings | None = None) -> None:
        """Cheap."""
        self.model = model
        self.settings = settings or HandMotionSettings()

    def in_hand(self, before: HandState, frame: Frame, hold: Array, steps: int) -> InHand:
        """Expected motion of the object at `hold` (4, 4) hand_from_object over `steps` frames, hand axes."""
        s = self.settings
        noise = np.diag(np.repeat([s.angle, s.distance], 3) ** 2) * steps
        still = InHand(np.zeros(6), noise, 0.1 * noise, 0.1 * noise)
        moved = fingertips(before, frame)
        if moved is None:
            return still
        points, displacements = moved
        if np.linalg.norm(displacements, axis=1).max() < s.still:
            return still
        centre = hold[:3, :3] @ self.model.centroid + hold[:3, 3]
        motion, covariance, misfit = carried_by_contacts(points, displacements, centre, s)
        # contacts that do not fit one rigid motion slide: their misfit widens the prediction
        worse = 1.0 + misfit / max(1, displacements.size - 6)
        wide = noise + worse * covariance + s.doubt**2 * np.outer(motion, motion)
        held = np.linalg.inv(covariance) + np.diag(np.repeat([s.turn_held, s.move_held], 3) ** -2.0)
        return InHand(motion, wide, 0.1 * noise + np.linalg.inv(held), 0.1 * noise, misfit)


def fingertips(before: HandState, frame: Frame) -> tuple[Array, Array] | None:
    """Contact points (n, 3) of the earlier frame, hand frame, and how far their links have moved them (n, 3); None
    where the fingers have not moved, or it is not known how.
    """
    if frame.hand is None or frame.joints is None or before.joints is None or before.joints == frame.joints:
        return None
    sensors = frame.hand.sensors
    rows = [i for i, name in enumerate(before.sensors) if name in sensors]
    if not rows or frame.hand.strangers(before.joints):
        return None  # joints of another hand: the tool was changed
    then, now = frame.hand.forward_kinematics(before.joints), frame.hand.forward_kinematics(frame.joints)
    points = before.points[rows]
    moved = np.zeros_like(points)
    for k, i in enumerate(rows):
        link = sensors[before.sensors[i]].link
        moved[k] = se3.apply(now[link] @ se3.inverse(then[link]), points[k : k + 1])[0] - points[k]
    return points, moved


def calibration_drift(before: Array, now: Array, centre: Array, calibration: CalibrationModel) -> Array:
    """(6, 6) covariance of what a wrong calibration makes of a motion from camera_from_hand `before` to `now`.

    A reported motion D is really E^-1 D E with E the calibration's error: off by the motion's turn times the error's
    displacement, and the other way round. centre (3,): of the object, camera frame.
    """
    motion = now @ se3.inverse(before)
    turn = float(se3.rotation_angle(motion[:3, :3]))
    move = float(np.linalg.norm(motion[:3, :3] @ centre + motion[:3, 3] - centre))
    # a turn of the calibration at the camera moves the object by its distance
    shift = np.hypot(calibration.translation_sigma, calibration.rotation_sigma * np.linalg.norm(centre))
    angle = turn * calibration.rotation_sigma
    distance = np.hypot(turn * shift, move * calibration.rotation_sigma)
    return np.diag(np.repeat([angle, distance], 3) ** 2)


def drift_since(seen: Array, before: Array, now: Array, centre: Array, calibration: CalibrationModel) -> Array:
    """(6, 6) covariance that the motion from camera_from_hand `before` to `now` adds to what a wrong calibration has
    made of the way since the hand was at `seen`; centre (3,): of the object, camera frame, now.

    One error acts on all steps of a way: what it makes of them adds up, and its variance is that of the whole way, not
    the sum of the steps'. On a way back nothing is taken off: it is another way.
    """
    begun = se3.apply(seen @ se3.inverse(now), centre[None])[0]
    whole = calibration_drift(seen, now, begun, calibration)
    return np.maximum(whole - calibration_drift(seen, before, begun, calibration), 0.0)
