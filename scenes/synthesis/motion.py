"""A hand that picks an object up, carries, turns, shakes and puts it down, loses its hold; a camera that moves.

Poses are camera_from_hand and hand_from_object (4, 4); metres, radians, seconds.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenes.errors import InputError, unknown
from scenes.geometry import poses
from scenes.geometry.cameras import Camera
from scenes.geometry.objects import ObjectModel
from scenes.robot.fingers import closing_hand
from scenes.robot.hands import Hand
from scenes.synthesis.grasping.closing import ExactClosing
from scenes.synthesis.grasping.grasps import Grasp, GraspSearchSettings
from scenes.synthesis.grasping.rehold import ReholdSettings, hold_anew, let_go, regrasp, slid, slide

Array = NDArray[np.float64]

KINDS = ("carry", "turn", "slip", "slide", "regrasp", "leave", "close", "shake", "camera", "pick", "put")


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
    # How the hold changes: fingers that close anew, stand still or let go.
    rehold: ReholdSettings = field(default_factory=ReholdSettings)
    # Frames in which fingers open, or close; a new grasp takes three times as many.
    fingers: int = 6
    # How far the hand comes from to pick a thing up, and goes when it has put it down (m), and the frames of that way.
    away: float = 0.12
    reach: int = 12
    # A shake: its frequency (Hz), amplitude (m), swing (rad), and the camera's exposure (s), while which things smear.
    shake_rate: float = 4.0
    shake: float = 0.025
    shake_swing: float = float(np.deg2rad(6.0))
    exposure: float = 0.010
    # The object's centre stays this share of the image's half size inside the border, but for "leave".
    margin: float = 0.6


@dataclass(frozen=True)
class MotionStep:
    """One instant: where the hand is, how it holds the object, whether the object is slipping; camera_from_world
    (4, 4); smear (4, 4): motion of hand and object, camera frame, while the camera exposes; None without.
    """

    camera_from_hand: Array
    grasp: Grasp
    slipping: bool
    camera_from_world: Array = field(default_factory=lambda: np.eye(4))
    smear: Array | None = None


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
    """Steps from a grasp seen at a pose, and notes: kind, rate, slips (first and last frame, degrees, millimetres), and
    loose, the frames (first, last) in which the fingers do not hold the object.

    kind: "carry" (to and fro), "turn" (about an axis through the object), "slip" (carried, and slipping in the hand,
    whose fingers close anew), "slide" (the same under fingers that stand still), "regrasp" (let go while something
    else holds it, and taken otherwise), "leave" (out of the image and back), "close" (the hand closes around an object
    at rest, then carries it), "shake" (fast, so that the image smears), "camera" (the camera moves, hand and object
    rest), "pick" (the hand comes, closes and carries) or "put" (it carries, opens and goes; the object rests). Raises
    InputError for another kind, and where no other grasp is found.
    """
    settings = settings or MotionSettings()
    if kind not in KINDS:
        raise unknown("motion", kind, KINDS)
    centre = poses.apply(camera_from_hand @ grasp.hand_from_object, model.centroid[None])[0]
    path = _path(kind, frames, centre, model.radius, camera, rng, settings)
    grasps: list[Grasp] = [grasp] * frames
    slips: list[dict[str, float]] = []
    loose: list[int] = []
    if kind in ("slip", "slide"):
        grasps, slips = _slips(kind, frames, grasp, hand, model, rng, settings)
    elif kind == "regrasp":
        grasps, loose = _regrasped(frames, grasp, hand, model, rng, settings)
    elif kind == "close":
        grasps, loose = _closing(frames, grasp, hand, model, settings)
    elif kind in ("pick", "put"):
        grasps, loose = _reaching(kind, frames, grasp, hand, model, settings)
    sliding = {i for slip in slips for i in range(int(slip["first"]), int(slip["last"]) + 1)}
    motions = []
    for delta in path:
        # about the object's centre at the start, which is where the hand holds
        turn = poses.exp_rotation(delta[:3])
        motions.append(poses.make_pose(turn, centre + delta[3:] - turn @ centre))
    steps = []
    for i, (motion, held) in enumerate(zip(motions, grasps)):
        hand_pose = motion @ camera_from_hand
        if kind in ("regrasp", "pick", "put"):  # the object goes on as it went, and the hand goes about it
            hand_pose = hand_pose @ grasp.hand_from_object @ poses.inverse(held.hand_from_object)
        world = motion if kind == "camera" else np.eye(4)
        smear = None
        if kind == "shake":
            step = motions[min(i + 1, frames - 1)] @ poses.inverse(motions[min(i, frames - 2)])
            smear = _share(step, settings.exposure * settings.rate, centre)
        steps.append(MotionStep(hand_pose, held, i in sliding, world, smear))
    return steps, {"kind": kind, "rate_hz": settings.rate, "slips": slips, "loose": loose}


def _share(motion: Array, share: float, centre: Array) -> Array:
    """A share of a small rigid motion (4, 4) about a point (3,)."""
    return poses.perturb(np.eye(4), share * poses.difference(motion, np.eye(4), centre), centre)


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
    if kind == "put":  # and falls to rest again
        carried = _phases(kind, frames, settings)[0]
        eased = carried * _smooth(n / carried)
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
    if kind in ("close", "pick"):
        wait = 2 * settings.fingers if kind == "close" else sum(_phases(kind, frames, settings)[1:])
        out = np.concatenate([np.zeros((min(wait, frames), 6)), out])[:frames]
    if kind == "shake":
        beat = np.sin(2 * np.pi * settings.shake_rate * eased / settings.rate)
        out *= 0.3
        out[:, 3:] += settings.shake * beat[:, None] * aside
        out[:, :3] += settings.shake_swing * beat[:, None] * directions[1]
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
    kind: str,
    frames: int,
    grasp: Grasp,
    hand: Hand,
    model: ObjectModel,
    rng: np.random.Generator,
    settings: MotionSettings,
) -> tuple[list[Grasp], list[dict[str, float]]]:
    """The grasp of every frame and the slips: fingers close anew around an object that moves inside them, or, of a
    "slide", stand still.
    """
    hand, signs, exact = _exact(hand, model)
    grasp = _measured(grasp, signs, hand)
    held_anew = settings.rehold
    grasps, slips = [grasp] * frames, []
    first = int(rng.integers(5, 5 + settings.slip_every))
    while first + settings.slip_frames < frames:
        held = grasps[first]
        share = np.linspace(0, 1, settings.slip_frames + 1)[1:]
        eased = _smooth(share)
        delta, moved = None, []
        if kind == "slide":
            delta = slide(held, model, rng, held_anew)
            moved = [] if delta is None else [slid(held, model, delta * e, 2 * held_anew.soft) for e in eased[::-1]]
        else:
            for _ in range(settings.slip_draws):
                axis, way = poses.random_unit_vectors(2, rng)
                angle, distance = rng.uniform(*settings.slip_angle), rng.uniform(*settings.slip_distance)
                delta = np.concatenate([angle * axis, distance * way])
                moved = [hold_anew(exact, held, delta * e, held_anew.reopen) for e in eased[::-1]]
                if moved[0] is not None:
                    break
        if delta is not None and moved[0] is not None:
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
                    "rotation_deg": float(np.rad2deg(np.linalg.norm(delta[:3]))),
                    "translation_mm": 1e3 * float(np.linalg.norm(delta[3:])),
                }
            )
        first += settings.slip_frames + settings.slip_every
    return [_measured(held, signs, hand) for held in grasps], slips


def _exact(hand: Hand, model: ObjectModel) -> tuple[Hand, Array, ExactClosing]:
    """The hand whose joints rise as they close, the signs of its joints, and what closes it."""
    closing = GraspSearchSettings()
    hand, signs = closing_hand(hand)
    return hand, signs, ExactClosing(hand, model, closing.fine_spacing, closing.self_overlap)


def _opening(grasp: Grasp, hand: Hand, exact: ExactClosing, settings: MotionSettings) -> Callable[[float], Grasp]:
    return lambda share: let_go(grasp, hand, exact, share, settings.rehold.opened)


def _regrasped(
    frames: int, grasp: Grasp, hand: Hand, model: ObjectModel, rng: np.random.Generator, settings: MotionSettings
) -> tuple[list[Grasp], list[int]]:
    """The grasp of every frame, opened in the middle, moved and closed again; and the frames of it."""
    hand, signs, exact = _exact(hand, model)
    grasp = _measured(grasp, signs, hand)
    other = regrasp(exact, grasp, rng, settings.rehold)
    if other is None:
        raise InputError("motion: expected another grasp of the object nearby for 'regrasp', got none")
    each = max(1, min(settings.fingers, frames // 6))
    first = max(1, frames // 2 - each)
    before, after = _opening(grasp, hand, exact, settings), _opening(other, hand, exact, settings)
    shift = poses.difference(other.hand_from_object, grasp.hand_from_object, model.centroid)
    held = [grasp] * first + [before((i + 1) / each) for i in range(each)]
    for i in range(each):
        share = (i + 1) / (each + 1)
        moved = poses.perturb(grasp.hand_from_object, share * shift, model.centroid)
        q0, q1 = hand.configuration(before(1.0).joints), hand.configuration(after(1.0).joints)
        joints = dict(zip(hand.joint_names, (float(x) for x in (1 - share) * q0 + share * q1)))
        held.append(replace(before(1.0), joints=joints, hand_from_object=moved))
    held += [after(1.0 - (i + 1) / each) for i in range(each - 1)]
    loose = [first, len(held) - 1]
    held += [other] * max(0, frames - len(held))
    return [_measured(one, signs, hand) for one in held[:frames]], loose


def _phases(kind: str, frames: int, settings: MotionSettings) -> tuple[int, int, int]:
    """Frames in which the hand of a "pick" or "put" carries the object, its fingers move, and it comes or goes."""
    fingers = max(1, min(settings.fingers, frames // 6))
    reach = max(1, min(settings.reach, frames // 2))
    if kind == "pick":
        return max(0, frames - fingers - reach), fingers, reach
    return max(1, frames // 3), fingers, reach


def _reaching(
    kind: str, frames: int, grasp: Grasp, hand: Hand, model: ObjectModel, settings: MotionSettings
) -> tuple[list[Grasp], list[int]]:
    """The grasp of every frame of a "pick" or a "put", and the frames in which nothing holds the object: the hand
    stands off it the way that leads from the object's middle to the hand's origin.
    """
    hand, signs, exact = _exact(hand, model)
    grasp = _measured(grasp, signs, hand)
    opening = _opening(grasp, hand, exact, settings)
    carried, fingers, reach = _phases(kind, frames, settings)
    middle = poses.apply(grasp.hand_from_object, model.centroid[None])[0]
    size = float(np.linalg.norm(middle))
    way = middle / size if size > 1e-9 else np.array([0.0, 0.0, 1.0])
    opened = opening(1.0)

    def off(share: float) -> Grasp:
        shift = poses.make_pose(np.eye(3), settings.away * share * way)
        return replace(opened, hand_from_object=shift @ grasp.hand_from_object)

    leaving = [opening((i + 1) / fingers) for i in range(fingers)]
    leaving += [off(float(_smooth(np.array((i + 1) / reach)))) for i in range(reach)]
    if kind == "pick":
        held = [*leaving[::-1], *[grasp] * carried]
        loose = [0, len(leaving) - 1]
    else:
        held = [*[grasp] * carried, *leaving, *[leaving[-1]] * frames]
        loose = [carried, frames - 1]
    return [_measured(one, signs, hand) for one in held[:frames]], loose


def _smooth(share: Array) -> Array:
    """A way from 0 to 1 that begins and ends at rest; what is beyond stays there."""
    inside = np.clip(share, 0.0, 1.0)
    return np.asarray(inside**2 * (3 - 2 * inside))


def _closing(
    frames: int, grasp: Grasp, hand: Hand, model: ObjectModel, settings: MotionSettings
) -> tuple[list[Grasp], list[int]]:
    """The grasp of every frame, open at first, then closing; and the frames of it."""
    hand, signs, exact = _exact(hand, model)
    grasp = _measured(grasp, signs, hand)
    opening = _opening(grasp, hand, exact, settings)
    each = max(1, min(settings.fingers, frames // 4))
    held = [opening(1.0)] * each + [opening(1.0 - (i + 1) / (each + 1)) for i in range(each)]
    loose = [0, len(held) - 1]
    held += [grasp] * max(0, frames - len(held))
    return [_measured(one, signs, hand) for one in held[:frames]], loose


def _measured(grasp: Grasp, signs: Array, hand: Hand) -> Grasp:
    """The grasp with joints measured the other way where the sign is -1; the same one when nowhere."""
    if (signs > 0).all():
        return grasp
    values = {name: float(sign * grasp.joints[name]) for name, sign in zip(hand.joint_names, signs)}
    return replace(grasp, joints=values)
