"""How an object comes to lie otherwise in a hand: fingers that close anew, that stand still while it slides, or open.

Hand frame, metres, radians. Grasps here are of a hand whose closing joints rise as they close (closing_hand).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scenes.geometry import poses
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Contacts
from scenes.robot.hands import Hand
from scenes.synthesis.grasping.closing import ExactClosing
from scenes.synthesis.grasping.grasps import Grasp, GraspSearchSettings, has_force_closure

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ReholdSettings:
    """What fingers allow an object. By judgement."""

    # Fingers are opened by this much (rad) before they close anew on an object that has slipped.
    reopen: float = 0.15
    # A soft fingertip gives way, or follows, by so much (m) while the object slides under fingers that stand still.
    soft: float = 0.0012
    # Draws of a motion before giving up; most are blocked.
    draws: int = 60
    # Turn (rad) and displacement (m) of a slide, and of a new grasp in the hand.
    slide_angle: tuple[float, float] = (float(np.deg2rad(3.0)), float(np.deg2rad(16.0)))
    slide_distance: tuple[float, float] = (0.001, 0.009)
    regrasp_angle: tuple[float, float] = (float(np.deg2rad(6.0)), float(np.deg2rad(22.0)))
    regrasp_distance: tuple[float, float] = (0.002, 0.010)
    # How far fingers open (rad a joint) when they let go.
    opened: float = 0.45


def hold_anew(exact: ExactClosing, grasp: Grasp, delta: Array, reopen: float) -> Grasp | None:
    """The same fingers closed on the object moved by delta (6,) in the hand (see poses.perturb); None when blocked.

    At least two of the fingertips that touched must touch again.
    """
    hand, model = exact.hand, exact.model
    moved = poses.perturb(grasp.hand_from_object, delta, model.centroid)
    q = hand.configuration(grasp.joints)
    speed, start = np.zeros(len(q)), q.copy()
    for finger in exact.fingers:
        if finger.sensor in grasp.contacts.sensors:
            own = list(finger.closing)
            speed[own] = 1.0
            start[own] = np.maximum(q[own] - 4 * reopen, hand.limits[own, 0])
    near = np.maximum(q - reopen * speed, start)
    closed = exact.close(moved, start, speed, near, tuple(grasp.contacts.sensors), least=2)
    if closed is None or len(closed[1]) < 2:
        return None
    values, touching = closed
    points = np.array([point for point, _ in touching.values()])
    normals = np.array([normal for _, normal in touching.values()])
    contacts = Contacts(points, normals, sensors=list(touching)).moved(moved)
    closure = has_force_closure(points, normals, model, GraspSearchSettings().friction)
    joints = dict(zip(hand.joint_names, (float(x) for x in values)))
    return Grasp(joints, moved, contacts, grasp.kind, closure)


def slid(grasp: Grasp, model: ObjectModel, delta: Array, soft: float) -> Grasp | None:
    """The object moved by delta (6,) under fingers that stand still; None when one enters it, or loses it, by more than
    it is soft (m).
    """
    moved = poses.perturb(grasp.hand_from_object, delta, model.centroid)
    local = poses.apply(poses.inverse(moved), grasp.contacts.points)
    distance, gradient = model.field.distance_and_gradient(local)
    if (np.abs(distance) > soft).any():
        return None
    points = local - distance[:, None] * gradient
    normals = model.field.normals(points)
    contacts = Contacts(points, normals, sensors=list(grasp.contacts.sensors)).moved(moved)
    return replace(grasp, hand_from_object=moved, contacts=contacts)


def slide(grasp: Grasp, model: ObjectModel, rng: np.random.Generator, settings: ReholdSettings) -> Array | None:
    """The farthest (6,) of some random motions that fingers which stand still allow all the way; None for none."""
    best, farthest = None, 0.0
    for _ in range(settings.draws):
        axis, way = poses.random_unit_vectors(2, rng)
        angle, distance = rng.uniform(*settings.slide_angle), rng.uniform(*settings.slide_distance)
        # one of the two, or both: a thing slips along its length, or turns between two fingertips
        use = [(1.0, 1.0), (1.0, 0.0), (0.0, 1.0)][int(rng.integers(3))]
        delta = np.concatenate([use[0] * angle * axis, use[1] * distance * way])
        far = use[0] * angle * model.radius + use[1] * distance
        if far > farthest and all(slid(grasp, model, share * delta, settings.soft) for share in (0.33, 0.67, 1.0)):
            best, farthest = delta, far
    return best


def regrasp(exact: ExactClosing, grasp: Grasp, rng: np.random.Generator, settings: ReholdSettings) -> Grasp | None:
    """The same fingers closed on the object somewhere else in the hand; None when all draws are blocked."""
    for _ in range(settings.draws // 4):
        axis, way = poses.random_unit_vectors(2, rng)
        angle, distance = rng.uniform(*settings.regrasp_angle), rng.uniform(*settings.regrasp_distance)
        found = hold_anew(exact, grasp, np.concatenate([angle * axis, distance * way]), settings.reopen)
        if found is not None:
            return found
    return None


def let_go(grasp: Grasp, hand: Hand, exact: ExactClosing, share: float, opened: float) -> Grasp:
    """The grasp with its fingers opened by a share of `opened` (rad): nothing touches."""
    q = hand.configuration(grasp.joints)
    for finger in exact.fingers:
        own = list(finger.closing)
        q[own] = np.maximum(q[own] - share * opened, hand.limits[own, 0])
    joints = dict(zip(hand.joint_names, (float(x) for x in q)))
    return replace(grasp, joints=joints, contacts=Contacts(np.zeros((0, 3)), sensors=[]), force_closure=False)
