"""A hand that carries, turns and loses its hold of an object: smooth paths, with slips inside the hand.

Poses are camera_from_hand and hand_from_object (4, 4); metres, radians, seconds.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenes.errors import unknown
from scenes.geometry import poses
from scenes.geometry.cameras import Camera
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Contacts
from scenes.robot.fingers import closing_hand
from scenes.robot.hands import Hand
from scenes.synthesis.grasping.closing import ExactClosing
from scenes.synthesis.grasping.grasps import Grasp, GraspSearchSettings, has_force_closure

Array = NDArray[np.float64]

KINDS = ("carry", "turn", "slip", "leave")


@dataclass(frozen=True)
class MotionSettings:
    """How fast and how far. A person moves a tool at about 0.2 m/s and 1 rad/s. Values by judgement."""

    # Frames per second, and duration of one swing to and fro (s).
    rate: float = 30.0
    period: float = 4.0
    # Amplitudes of carrying: across and along the viewing direction (m), and of the turning that goes with it (rad).
    across: float = 0.08
    along: float = 0.04
    swing: float = float(np.deg2rad(20.0))
    # Amplitude of turning (rad), and of the carrying that goes with it (share of the above).
    turn: float = float(np.deg2rad(70.0))
    turn_carry: float = 0.25
    # Frames over which speed rises from rest.
    start: int = 10
    # A slip: frames that it takes, turn (rad) and displacement (m) of the object in the hand, and frames between slips.
    slip_frames: int = 6
    slip_angle: tuple[float, float] = (float(np.deg2rad(4.0)), float(np.deg2rad(14.0)))
    slip_distance: tuple[float, float] = (0.001, 0.005)
    slip_every: int = 25
    # Slips drawn before giving up, most fingers block most of them.
    slip_draws: int = 12
    # Fingers are opened by this much (rad) before they close anew on a slipped object.
    reopen: float = 0.15
    # The object's centre stays this share of the image's half size inside the border, but for "leave".
    margin: float = 0.6


@dataclass(frozen=True)
class MotionStep:
    """One instant: where the hand is, how it holds the object, whether the object is slipping."""

    camera_from_hand: Array
    grasp: Grasp
    slipping: bool


def plan_motion(
    kind: str,
    frames: int,
    grasp: Grasp,
    camera_from_hand: Array,
    hand: Hand,
    model: ObjectModel,
    camera: Camera,
    rng: np.random.Generator,
    settings: MotionSettings | None = None,
) -> tuple[list[MotionStep], dict[str, Any]]:
    """Steps from a grasp seen at a pose, and notes: kind, rate and slips (first and last frame, degrees, millimetres).

    kind: "carry" (to and fro), "turn" (about an axis through the object), "slip" (carried, and slipping in the hand) or
    "leave" (out of the image and back). Raises InputError for another kind.
    """
    settings = settings or MotionSettings()
    if kind not in KINDS:
        raise unknown("motion", kind, KINDS)
    centre = poses.apply(camera_from_hand @ grasp.hand_from_object, model.centroid[None])[0]
    path = _path(kind, frames, centre, model.radius, camera, rng, settings)
    grasps: list[Grasp] = [grasp] * frames
    slips: list[dict[str, float]] = []
    if kind == "slip":
        grasps, slips = _slips(frames, grasp, hand, model, rng, settings)
    sliding = {i for slip in slips for i in range(int(slip["first"]), int(slip["last"]) + 1)}
    steps = []
    for i, delta in enumerate(path):
        # about the object's centre at the start, which is where the hand holds
        turn = poses.exp_rotation(delta[:3])
        motion = poses.make_pose(turn, centre + delta[3:] - turn @ centre)
        steps.append(MotionStep(motion @ camera_from_hand, grasps[i], i in sliding))
    return steps, {"kind": kind, "rate_hz": settings.rate, "slips": slips}


def _path(
    kind: str,
    frames: int,
    centre: Array,
    radius: float,
    camera: Camera,
    rng: np.random.Generator,
    settings: MotionSettings,
) -> Array:
    """(frames, 6) rotation vector and displacement of each frame from the first."""
    n = np.arange(frames)
    # phase rises from rest like a parabola, then evenly: speed is continuous
    eased = np.where(n < settings.start, n**2 / (2.0 * settings.start), n - settings.start / 2.0)
    phase = 2 * np.pi * eased / (settings.rate * settings.period)
    directions = poses.random_unit_vectors(2, rng)
    angle = rng.uniform(0, 2 * np.pi)
    aside = np.array([np.cos(angle), np.sin(angle), 0.0])
    other = np.array([-aside[1], aside[0], 0.0])
    out = np.zeros((frames, 6))
    carry = settings.turn_carry if kind == "turn" else 1.0
    swing = settings.turn if kind == "turn" else settings.swing
    out[:, :3] = swing * np.sin(phase)[:, None] * directions[0]
    out[:, :3] += 0.3 * swing * (1 - np.cos(phase))[:, None] * directions[1]
    across = np.sin(phase)[:, None] * aside + 0.5 * (1 - np.cos(phase))[:, None] * other
    out[:, 3:] = carry * (settings.across * across)
    out[:, 5] += carry * settings.along * 0.5 * (1 - np.cos(1.3 * phase))
    if kind != "leave":
        out[:, 3:5] *= _inside(centre, out[:, 3:], camera, settings.margin)
        return out
    half = np.array([camera.width / camera.fx, camera.height / camera.fy]) / 2 * centre[2]
    border = float(np.min((half + np.abs(centre[:2])) / np.maximum(np.abs(aside[:2]), 1e-9)))
    away = np.sin(np.pi * n / max(frames - 1, 1)) ** 2
    out[:, 3:] = (border + 1.3 * radius) * away[:, None] * aside
    return out


def _inside(centre: Array, displacement: Array, camera: Camera, margin: float) -> float:
    """The share of the sideways displacement (n, 3) at which the centre stays inside the image; 1 when it all does."""
    half = np.array([camera.width, camera.height]) / 2
    for share in np.linspace(1.0, 0.0, 21):
        points = centre + displacement * [share, share, 1.0]
        pixels, _ = camera.project(points)
        allowed = np.maximum(margin, np.abs(pixels[0] - half) / half + 0.02)
        if (np.abs(pixels - half) <= allowed * half).all():
            return float(share)
    return 0.0


def _slips(
    frames: int, grasp: Grasp, hand: Hand, model: ObjectModel, rng: np.random.Generator, settings: MotionSettings
) -> tuple[list[Grasp], list[dict[str, float]]]:
    """The grasp of every frame, fingers closed anew around an object that moves inside them, and the slips."""
    closing = GraspSearchSettings()
    hand, signs = closing_hand(hand)
    grasp = _measured(grasp, signs, hand)
    exact = ExactClosing(hand, model, closing.fine_spacing, closing.self_overlap)
    grasps, slips = [grasp] * frames, []
    first = int(rng.integers(5, 5 + settings.slip_every))
    while first + settings.slip_frames < frames:
        held = grasps[first]
        for _ in range(settings.slip_draws):
            axis, way = poses.random_unit_vectors(2, rng)
            angle, distance = rng.uniform(*settings.slip_angle), rng.uniform(*settings.slip_distance)
            delta = np.concatenate([angle * axis, distance * way])
            share = np.linspace(0, 1, settings.slip_frames + 1)[1:]
            eased = share**2 * (3 - 2 * share)
            moved = [hold_anew(exact, held, delta * e, settings.reopen) for e in eased[::-1]]
            if moved[0] is None:
                continue
            seen: list[Grasp] = []
            for new in moved[::-1]:  # a blocked instant: the object sticks, then jumps
                seen.append(new or (seen[-1] if seen else held))
            grasps[first + 1 : first + 1 + len(seen)] = seen
            last = first + len(seen)
            grasps[last:] = [seen[-1]] * (frames - last)
            slips.append(
                {
                    "first": first + 1,
                    "last": last,
                    "rotation_deg": float(np.rad2deg(angle)),
                    "translation_mm": 1e3 * float(distance),
                }
            )
            break
        first += settings.slip_frames + settings.slip_every
    return [_measured(held, signs, hand) for held in grasps], slips


def _measured(grasp: Grasp, signs: Array, hand: Hand) -> Grasp:
    """The grasp with joints measured the other way where the sign is -1; the same one when nowhere."""
    if (signs > 0).all():
        return grasp
    values = {name: float(sign * grasp.joints[name]) for name, sign in zip(hand.joint_names, signs)}
    return replace(grasp, joints=values)


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
