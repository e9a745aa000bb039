"""Closing a hand on an object: a grasp without interpenetration whose fingertips touch the surface exactly.

Many placements are closed at once with sparse samples and the object's lattice; the best are closed again with dense
samples, the tips' exact shapes, the object's own points against the links, and exact closest points.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from scenes.errors import InputError
from scenes.geometry import poses
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Contacts
from scenes.robot.fingers import Clearance, close, closing_hand, find_fingers
from scenes.robot.hands import Hand
from scenes.synthesis.grasping.closing import ExactClosing
from scenes.synthesis.grasping.driven import close_driven, is_driven
from scenes.synthesis.grasping.placement import (
    PlacementSettings,
    across_palm,
    between_tips,
    facing_pairs,
    is_gripper,
    pinch_table,
    principal_axes,
)

Array = NDArray[np.float64]

KINDS = ("power", "tripod", "pinch")
# Speeds of a finger's closing joints, from the root outwards: which joint leads decides which link touches first.
SPEEDS = ((1.0, 0.35, 0.15), (1.0, 1.0, 1.0), (0.45, 1.0, 1.0), (1.0, 0.0, 0.0))
# A gripper whose tips come as near as this (m) can hold anything thin.
CLOSED = 0.006


@dataclass(frozen=True)
class GraspSearchSettings:
    """How hard to look, and what counts. Values by judgement."""

    # Placements closed at once, and how often to draw again before giving up.
    batch: int = 14
    rounds: int = 8
    # Rounds after which a grasp without force closure, or with fewer fingertips than wanted, is good enough.
    patience: int = 2
    # Spacing of hand samples (m) while choosing, and while closing exactly.
    coarse_spacing: float = 0.007
    fine_spacing: float = 0.003
    # Grasps closed exactly in each round, the most promising first.
    finalists: int = 5
    # Friction coefficient (no unit) for the force-closure test: rubber on plastic.
    friction: float = 0.6
    # Thumb or palm must push against some fingertip: cosine between their contact normals at most this (over 107
    # degrees), or the hand only leans on the object, as on the edge of a crate.
    opposition: float = -0.3
    # Links of the hand may overlap one another by this much (m): skin, not the object.
    self_overlap: float = 1.0e-3
    placement: PlacementSettings = field(default_factory=PlacementSettings)


@dataclass(frozen=True)
class Grasp:
    """joints: name -> rad; hand_from_object (4, 4); contacts in the hand frame, one for each touching fingertip, with
    the sensor's name, the point on the surface and the outward normal; kind "power", "tripod" or "pinch";
    force_closure: whether friction (see settings) can balance any small push.
    """

    joints: dict[str, float]
    hand_from_object: Array
    contacts: Contacts
    kind: str
    force_closure: bool


def plan_grasp(
    hand: Hand, model: ObjectModel, seed: int = 0, kind: str = "power", settings: GraspSearchSettings | None = None
) -> Grasp:
    """A random grasp of the object; the same seed gives the same grasp.

    kind: "power" (object across the palm, wanted 4 fingertips or more, at least 3), "tripod" (thumb, index, middle) or
    "pinch" (thumb, index). A power grasp across the palm is for hands whose frame follows `synthesis.hands`: z out of
    the palm, x along the fingers; other hands and grippers hold the object between all their tips. Tips need sensors
    with a surface. Raises InputError for another kind, a hand without such tips, or an object that the hand cannot
    hold, with its true size and the hand's.
    """
    settings = settings or GraspSearchSettings()
    if kind not in KINDS:
        raise InputError(f"grasp: expected kind {', '.join(KINDS)}, got {kind!r}")
    given, (hand, signs) = hand, closing_hand(hand)
    sensors = _sensors_of(hand, kind)
    gripper = is_gripper(find_fingers(hand))
    least, wanted = (min(3, len(sensors)), min(4, len(sensors))) if kind == "power" else (len(sensors), len(sensors))
    placement = settings.placement
    if gripper:  # what fits between the tips is what there is to hold
        opening = float(pinch_table(hand, sensors).gap.max(initial=0.0))
        placement = replace(placement, pinch_width=max(placement.pinch_width, opening))
        _check_width(hand, model, sensors, opening, placement)
    rng = np.random.default_rng(seed)
    coarse = Clearance(hand, model, settings.coarse_spacing)
    fingers = Clearance(hand, model, settings.coarse_spacing, only_fingers=True)
    exact = ExactClosing(hand, model, settings.fine_spacing, settings.self_overlap)
    best: Grasp | None = None
    for attempt in range(settings.rounds):
        # another's hand may have its palm elsewhere than ours: then what is between its tips is found all the same
        if kind == "power" and not gripper and (best is not None or 2 * attempt < settings.rounds):
            placed, q = across_palm(coarse, settings.batch, rng, placement)
        else:
            placed, q = between_tips(coarse, sensors, 2 * settings.batch, rng, placement)
        if len(placed) == 0:
            continue
        for grasp in _closed(exact, fingers, placed, q, sensors, least, kind, rng, settings):
            if len(grasp.contacts) >= wanted and grasp.force_closure and sensors[0] in grasp.contacts.sensors:
                return _as_given(grasp, given, signs)
            if best is None or _rank(grasp, sensors[0]) > _rank(best, sensors[0]):
                best = grasp
        if best is not None and attempt + 1 >= settings.patience:
            return _as_given(best, given, signs)
    if best is None:
        raise InputError(_refusal(hand, model, kind))
    return _as_given(best, given, signs)


def _closed(
    exact: ExactClosing,
    fingers: Clearance,
    placed: Array,
    q: Array,
    sensors: tuple[str, ...],
    least: int,
    kind: str,
    rng: np.random.Generator,
    settings: GraspSearchSettings,
) -> Iterator[Grasp]:
    """The grasps that placements (n, 4, 4) with open configurations (n, j) close to."""
    found: Grasp | None
    if is_driven(exact.fingers):
        for pose, start in zip(placed[: 2 * settings.finalists], q):
            driven = close_driven(exact, pose, start)
            if driven is not None:
                found = _finish(exact, *driven, kind, sensors[0], settings)
                if found is not None:
                    yield found
        return
    for pose, start, speed, near in _promising(fingers, placed, q, sensors, least, rng, settings):
        closed = exact.close(pose, start, speed, near, sensors, least)
        if closed is not None:
            found = _finish(exact, pose, *closed, kind, sensors[0], settings)
            if found is not None:
                yield found


def _as_given(grasp: Grasp, hand: Hand, signs: Array) -> Grasp:
    """The grasp with joint values as the hand itself measures them; couplings within their limits."""
    values = signs * np.array([grasp.joints[name] for name in hand.joint_names])
    return replace(grasp, joints=dict(zip(hand.joint_names, (float(x) for x in values))))


def _rank(grasp: Grasp, thumb: str) -> tuple[bool, bool, int]:
    return grasp.force_closure, thumb in grasp.contacts.sensors, len(grasp.contacts)


def _sensors_of(hand: Hand, kind: str) -> tuple[str, ...]:
    """The tips that take part, the opposing one first."""
    fingers = find_fingers(hand)
    thumb = next(f.sensor for f in fingers if f.is_thumb)
    others = [f.sensor for f in fingers if not f.is_thumb]
    count = {"power": len(others), "tripod": 2, "pinch": 1}[kind]
    if is_driven(fingers):
        count = len(others)  # one drive moves them all
    if len(others) < count:
        raise InputError(f"hand {hand.name!r}: expected three fingers for a {kind}, got {len(fingers)}")
    return (thumb, *others[:count])


def _check_width(
    hand: Hand, model: ObjectModel, sensors: tuple[str, ...], opening: float, placement: PlacementSettings
) -> None:
    """Raise InputError when no two sides of the object fit between the open tips, with both lengths."""
    if opening <= 0:
        raise InputError(
            f"hand {hand.name!r}: expected tips that face each other somewhere, {', '.join(sensors)} never do"
        )
    first, second = facing_pairs(model, np.random.default_rng(0), replace(placement, pinch_width=2 * model.diameter))
    widths = np.linalg.norm(second - first, axis=1)
    closest = float(pinch_table(hand, sensors).gap.min())
    if len(widths) and closest > CLOSED and (widths < closest).all():
        raise InputError(
            f"grasp: expected an object of more than {1e3 * closest:.0f} mm for hand {hand.name!r}, whose tips close no"
            f" further, got {model.name!r} with {1e3 * widths.max():.0f} mm where it is widest"
        )
    room = opening - 2 * placement.pinch_room
    if not (widths < room).any():
        narrowest = (
            f"{1e3 * widths.min():.0f} mm where it is narrowest" if len(widths) else "no two sides that face away"
        )
        raise InputError(
            f"grasp: expected an object of less than {1e3 * room:.0f} mm for hand {hand.name!r}, whose tips open"
            f" {1e3 * opening:.0f} mm wide, got {model.name!r} with {narrowest}"
        )


def _promising(
    coarse: Clearance,
    placed: Array,
    q: Array,
    sensors: tuple[str, ...],
    least: int,
    rng: np.random.Generator,
    settings: GraspSearchSettings,
) -> list[tuple[Array, Array, Array, Array]]:
    """Close every placement in every way at once; pose, start, speeds, end of those worth closing exactly."""
    hand, fingers = coarse.hand, coarse.fingers
    ways = len(SPEEDS)
    speed = np.zeros((ways, q.shape[1]))
    for finger in fingers:
        if finger.sensor in sensors:
            for place, j in enumerate(finger.closing):
                speed[:, j] = [s[min(place, len(s) - 1)] for s in SPEEDS]
    n = len(placed)
    poses_all, starts = np.repeat(placed, ways, axis=0), np.repeat(q, ways, axis=0)
    speeds = np.tile(speed, (n, 1))
    # a gripper's tips go straight at the object: the bound on a step is no more than what they do
    ends, _, tips = close(coarse, poses_all, starts, speeds, haste=1.0 if is_gripper(fingers) else 1.5)
    touching = (np.abs(tips) < 4e-4).reshape(n, ways, -1)
    centres = coarse.tip_centres(hand.link_poses(ends)).reshape(n, ways, -1, 3)
    choices, quality = [], np.zeros(n)
    for i in range(n):
        chosen, near = np.zeros(q.shape[1]), q[i].copy()
        points: list[Array] = []
        thumb_normal, normals = None, []
        for f, finger in enumerate(fingers):
            if finger.sensor not in sensors:
                continue
            ways_that_touch = np.nonzero(touching[i, :, f])[0]
            way = int(rng.choice(ways_that_touch)) if len(ways_that_touch) else 1
            own = list(finger.closing)
            chosen[own] = speed[way, own]
            near[own] = ends[i * ways + way, own]
            if len(ways_that_touch):
                centre = poses.apply(poses.inverse(placed[i]), centres[i, way, f][None])
                points.append(centre[0])
                normal = coarse.model.field.distance_and_gradient(centre)[1][0]
                if finger.is_thumb:
                    thumb_normal = normal
                else:
                    normals.append(normal)
        choices.append((placed[i], q[i], chosen, near))
        # a thumb that pushes against the others is worth two more contacts
        facing = float((np.array(normals) @ thumb_normal).min()) if thumb_normal is not None and normals else None
        if len(points) >= least:
            quality[i] = len(points) + 2.0 * (facing is not None and facing < settings.opposition)
    order = np.argsort(-quality, kind="stable")
    return [choices[i] for i in order[: settings.finalists] if quality[i] >= least]


def _finish(
    exact: ExactClosing,
    hand_from_object: Array,
    q: Array,
    touching: dict[str, tuple[Array, Array]],
    kind: str,
    thumb: str,
    settings: GraspSearchSettings,
) -> Grasp | None:
    """Contacts of the touching tips, moved from the object frame to the hand's; None when the hand only leans on."""
    points = np.array([point for point, _ in touching.values()])
    normals = np.array([normal for _, normal in touching.values()])
    contacts = Contacts(points, normals, sensors=list(touching)).moved(hand_from_object)
    fingers = np.array([normal for name, (_, normal) in touching.items() if name != thumb]).reshape(-1, 3)
    against = np.array([normal for name, (_, normal) in touching.items() if name == thumb]).reshape(-1, 3)
    if kind == "power":  # palm and inner links hold too
        more_points, more_normals = exact.supports(q, hand_from_object, settings.placement.gap[1] + 1e-3)
        points, normals = np.concatenate([points, more_points]), np.concatenate([normals, more_normals])
        against = np.concatenate([against, more_normals])
    if (fingers @ against.T).min(initial=1.0) > settings.opposition:
        return None
    closure = has_force_closure(points, normals, exact.model, settings.friction)
    joints = dict(zip(exact.hand.joint_names, (float(x) for x in q)))
    return Grasp(joints, hand_from_object, contacts, kind, closure)


def has_force_closure(points: Array, normals: Array, model: ObjectModel, friction: float) -> bool:
    """Whether contacts (n, 3) with outward normals (n, 3), object frame, can push and twist to balance.

    The origin must be a strictly positive combination of the friction cones' edges (8 a cone) as wrenches about the
    centroid, torques scaled by the object's radius (Ferrari and Canny 1992). Two contacts cannot resist a twist about
    their line: there each contact also gets the soft-finger's torsion.
    """
    from scipy.optimize import nnls

    angles = np.arange(8) * np.pi / 4
    columns = []
    for point, normal in zip(points - model.centroid, normals):
        length = float(np.linalg.norm(normal))
        if length < 1e-6:
            continue
        inward = -normal / length
        side = np.cross(inward, np.eye(3)[np.argmin(np.abs(inward))])
        side /= np.linalg.norm(side)
        up = np.cross(inward, side)
        edges = inward + friction * (np.cos(angles)[:, None] * side + np.sin(angles)[:, None] * up)
        torques = np.cross(point, edges) / model.radius
        columns.append(np.concatenate([edges, torques], axis=1))
        if len(points) == 2:
            twist = np.concatenate([inward, np.cross(point, inward) / model.radius])
            # a soft finger of 5 mm contact radius
            torsion = np.concatenate([np.zeros(3), friction * 0.005 / model.radius * inward])
            columns.append(np.stack([twist + torsion, twist - torsion]))
    if not columns:
        return False
    wrenches = np.concatenate(columns).T
    if np.linalg.matrix_rank(wrenches, tol=1e-6) < 6:
        return False
    # every edge takes part with weight 1 + something: strictly positive, hence the whole space is spanned
    _, residual = nnls(wrenches, -wrenches.sum(axis=1))
    return bool(residual < 1e-6)


def _refusal(hand: Hand, model: ObjectModel, kind: str) -> str:
    points, _ = model.sample_surface(2000, seed=0)
    extent = np.sort(np.ptp(points @ principal_axes(points), axis=0)) * 1e3
    span = 1e3 * float(pinch_table(hand, _sensors_of(hand, "pinch")).gap.max(initial=0.0))
    if kind == "power" and extent[1] < 20.0:
        hint = ": too thin to wrap, try a tripod or pinch"
    elif span <= 0:
        hint = ": its tips never face each other"
    elif extent[0] < span:
        hint = ": it fits, but palm or fingers were in the way of every try"
    else:
        hint = ": too wide on every side"
    size = " x ".join(f"{side:.0f}" for side in extent)
    return (
        f"grasp: expected an object that hand {hand.name!r} can hold in a {kind} grasp"
        f" (its tips face each other up to {span:.0f} mm apart), got {model.name!r} of {size} mm{hint}"
    )
