"""Where an object may sit in an open hand before the fingers close: across the palm, or between fingertips.

Poses are hand_from_object (4, 4), hand frame as in `scenes.synthesis.hands`: x along the fingers, z out of the palm.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from scenes.errors import InputError
from scenes.geometry import poses
from scenes.geometry.objects import ObjectModel
from scenes.robot import roles
from scenes.robot.fingers import Clearance, Finger, find_fingers
from scenes.robot.hands import Hand

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True)
class PlacementSettings:
    """Ranges of what is drawn at random. Values by judgement, for the five-finger hand."""

    # Edge of the object's part towards the wrist, along the fingers (m): just in front of the lifted thumb; a thin
    # part's middle goes at least to the hollow of the palm.
    edge: tuple[float, float] = (0.036, 0.056)
    hollow: float = 0.062
    # Standard deviation across the palm (m).
    across: float = 0.008
    # Standard deviation of the angle between the object's axis and the line across the palm (rad).
    tilt: float = np.deg2rad(12.0)
    # Gap between palm and object before closing (m).
    gap: tuple[float, float] = (0.0007, 0.006)
    # Thumb opposition of power grasps (rad): against index to against ring finger.
    opposition: tuple[float, float] = (np.deg2rad(70.0), np.deg2rad(112.0))
    # Spread of the fingers (rad, standard deviation): small, so that neighbours do not meet.
    abduction: float = np.deg2rad(3.0)
    # A pinch holds parts up to this thick (m), its surfaces facing away from each other within this angle (rad).
    pinch_width: float = 0.075
    pinch_angle: float = np.deg2rad(25.0)
    # Room left between an open fingertip and the part, each side (m).
    pinch_room: float = 0.004


# Hands of fewer fingers than this are grippers: they hold things between their tips, whatever frame they are drawn in.
LEAST_OF_A_HAND = 4
# Classes of width of which a gripper's table holds as many postures each.
WIDTHS = 20


def is_gripper(fingers: tuple[Finger, ...]) -> bool:
    """Whether the hand has too few fingers to wrap them around a thing."""
    return len(fingers) < LEAST_OF_A_HAND


def open_hand(hand: Hand, count: int, rng: np.random.Generator, settings: PlacementSettings) -> Array:
    """(count, j) open configurations: closing joints at their lower limits, posture joints drawn."""
    q = np.zeros((count, len(hand.joint_names)))
    for finger in find_fingers(hand):
        own = list(finger.closing)
        q[:, own] = np.where(np.isfinite(hand.limits[own, 0]), hand.limits[own, 0], 0.0)
    for column, name in enumerate(hand.joint_names):
        if "opposition" in name.lower():
            q[:, column] = rng.uniform(*settings.opposition, size=count)
        elif "abduction" in name.lower() or "spread" in name.lower():
            q[:, column] = rng.normal(0.0, settings.abduction, size=count)
    fingers = find_fingers(hand)
    if not roles.told(hand) and not is_gripper(fingers):  # names say nothing: where the thumb opposes the others most
        thumb = next(finger for finger in fingers if finger.is_thumb)
        good, placing = thumb_postures(hand), _placing(hand, thumb)
        q[:, placing] = good[rng.integers(len(good), size=count)][:, placing]
    return np.clip(q, hand.limits[:, 0], hand.limits[:, 1])


def _placing(hand: Hand, finger: Finger) -> Indices:
    """Columns of hand.joint_names that move this finger and do not close it."""
    moving = np.nonzero(hand.moved_by[finger.tip_link])[0]
    return np.array([j for j in moving if j not in finger.closing], dtype=np.int64)


@lru_cache(maxsize=16)
def thumb_postures(hand: Hand) -> Array:
    """(k, j) those of the postures of `roles` in which the thumb moves most against the other fingers."""
    fingers = find_fingers(hand)
    directions = np.zeros((len(fingers), len(hand.joint_names)))
    for row, finger in zip(directions, fingers):
        row[list(finger.closing)] = finger.ways
    against = roles.opposition(hand, [(f.tip_link, f.centre) for f in fingers], list(directions))
    thumb = next(i for i, finger in enumerate(fingers) if finger.is_thumb)
    best = np.argsort(-against[:, thumb], kind="stable")[: roles.POSTURES // 10]
    return np.asarray(roles.postures(hand)[best])


def principal_axes(points: Array) -> Array:
    """(3, 3) rotation whose columns are the directions of largest, middle and smallest spread of points (n, 3)."""
    _, vectors = np.linalg.eigh(np.cov(points.T))
    axes = vectors[:, ::-1].copy()
    axes[:, 2] = np.cross(axes[:, 0], axes[:, 1])
    return axes


def across_palm(
    clearance: Clearance, count: int, rng: np.random.Generator, settings: PlacementSettings
) -> tuple[Array, Array]:
    """Lay the object's long axis across the palm, roll it, and lower it until it nearly touches.

    Returns hand_from_object (count, 4, 4) and open configurations (count, j).
    """
    model, hand = clearance.model, clearance.hand
    points, _ = model.sample_surface(1500, seed=0)
    axes = principal_axes(points)
    placed = np.zeros((count, 4, 4))
    for i in range(count):
        first = rng.choice(3, p=(0.8, 0.15, 0.05))
        along = axes[:, first] * rng.choice((-1.0, 1.0))
        other = axes[:, (first + 1) % 3]
        object_axes = np.stack([other, along, np.cross(other, along)], axis=1)
        tilt = poses.exp_rotation(rng.normal(0.0, settings.tilt, size=3) * (1.0, 0.0, 1.0))
        roll = poses.exp_rotation((0.0, rng.uniform(-np.pi, np.pi), 0.0))
        rotation = tilt @ roll @ object_axes.T
        turned = points @ rotation.T
        # the part that comes to lie in the hand: a random place along the axis
        low, high = turned[:, 1].min(), turned[:, 1].max()
        place = rng.uniform(low + 0.15 * (high - low), high - 0.15 * (high - low))
        part = turned[np.abs(turned[:, 1] - place) < max(0.02, 0.05 * (high - low))]
        part = part if len(part) > 5 else turned
        half = 0.5 * float(np.ptp(part[:, 0]))
        edge = rng.uniform(*settings.edge)
        x = max(edge + half, settings.hollow + edge - settings.edge[0]) - 0.5 * (part[:, 0].min() + part[:, 0].max())
        y = rng.normal(0.0, settings.across) - place
        placed[i] = poses.make_pose(rotation, (x, y, 0.3 - turned[:, 2].min()))
    q = open_hand(hand, count, rng, settings)
    # straight down the palm's normal: clearance is how far it may move at least; what does not move stays where it is
    hand_from_link, move, rows = hand.link_poses(q), np.zeros(count), np.arange(count)
    for _ in range(30):
        move[rows] = clearance.least(hand_from_link[rows], placed[rows]) - settings.gap[0]
        placed[:, 2, 3] -= np.maximum(move, 0.0)
        if move.max() < 4e-4:
            break
        rows = rows[move[rows] > 0.0]
    placed[:, 2, 3] += rng.uniform(0.0, settings.gap[1] - settings.gap[0], size=count)
    return placed, q


def facing_pairs(
    model: ObjectModel, rng: np.random.Generator, settings: PlacementSettings, samples: int = 500
) -> tuple[Array, Array]:
    """Pairs of surface points (k, 3), (k, 3) whose normals point away from each other along the line between them."""
    points, normals = model.sample_surface(samples, seed=int(rng.integers(2**31)))
    line = points[None] - points[:, None]
    width = np.linalg.norm(line, axis=2)
    with np.errstate(invalid="ignore", divide="ignore"):
        unit = line / width[..., None]
    cosine = np.cos(settings.pinch_angle)
    good = (width > 1e-3) & (width < settings.pinch_width)
    good &= np.einsum("ik,ijk->ij", normals, unit) < -cosine
    good &= np.einsum("jk,ijk->ij", normals, unit) > cosine
    first, second = np.nonzero(good)
    return points[first], points[second]


@dataclass(frozen=True)
class PinchTable:
    """Configurations in which the thumb faces other tips: q (k, j), gap (k,) between the balls in metres, thumb
    (k, 3) and others (k, 3) the two sides' centres in the hand frame; best facing first.
    """

    q: Array
    gap: Array
    thumb: Array
    others: Array


@lru_cache(maxsize=16)
def pinch_table(hand: Hand, sensors: tuple[str, ...], count: int = 6000, keep: int = 400) -> PinchTable:
    """Search postures in which the tips `sensors` (the thumb's among them) move towards each other when closing."""
    fingers = [f for f in find_fingers(hand) if f.sensor in sensors]
    thumb = [f for f in fingers if f.is_thumb]
    others = [f for f in fingers if not f.is_thumb]
    if not thumb or not others:
        raise InputError(f"hand {hand.name!r}: expected tips {', '.join(sensors)}, got {len(fingers)} of them")
    gripper = is_gripper(find_fingers(hand))
    farthest = 1.0 if gripper else 0.75  # a hand's fingers meet long before they are fully bent
    rng = np.random.default_rng(20)
    q = open_hand(hand, count, rng, PlacementSettings(opposition=(0.8, 2.2)))
    for group in (thumb, others):
        for column in range(max(len(f.closing) for f in group)):
            share = rng.uniform(0.0, farthest, size=count)  # the same for all fingers of a side
            for finger in group:
                if column < len(finger.closing):
                    j = finger.closing[column]
                    low, high = np.clip(hand.limits[j], -np.pi, np.pi)
                    q[:, j] = low + share * (high - low)
    a, a_motion = _tips_and_motion(hand, thumb, q)
    b, b_motion = _tips_and_motion(hand, others, q)
    line = b - a
    width = np.linalg.norm(line, axis=1)
    line = line / np.maximum(width, 1e-9)[:, None]
    facing = np.minimum(np.einsum("ni,ni->n", a_motion, line), -np.einsum("ni,ni->n", b_motion, line))
    gap = width - thumb[0].radius - np.mean([f.radius for f in others])
    usable = np.nonzero((facing > np.cos(np.deg2rad(40.0))) & (gap > 0.004))[0]
    best = usable[np.argsort(-facing[usable], kind="stable")]
    if gripper:  # the best facing of every width, not only those of the width at which tips face best
        width_class = np.digitize(gap[best], np.linspace(0.0, gap[best].max(initial=0.0), WIDTHS + 1))
        best = np.concatenate([best[width_class == i][: keep // WIDTHS] for i in np.unique(width_class)] or [best])
    else:
        best = best[:keep]
    return PinchTable(q[best], gap[best], a[best], b[best])


def _tips_and_motion(hand: Hand, fingers: list[Finger], q: Array) -> tuple[Array, Array]:
    """Mean centre (n, 3) of the tips, and the unit direction (n, 3) in which it moves when the fingers close."""
    step = np.zeros(q.shape[1])
    for finger in fingers:
        step[list(finger.closing)] = 1e-4

    def centre(configuration: Array) -> Array:
        frames = hand.link_poses(configuration)
        tips = [frames[:, f.tip_link, :3, :3] @ f.centre + frames[:, f.tip_link, :3, 3] for f in fingers]
        return np.mean(tips, axis=0)

    here = centre(q)
    motion = centre(q + step) - here
    return here, motion / np.maximum(np.linalg.norm(motion, axis=1, keepdims=True), 1e-12)


def between_tips(
    clearance: Clearance, sensors: tuple[str, ...], count: int, rng: np.random.Generator, settings: PlacementSettings
) -> tuple[Array, Array]:
    """Put two facing spots of the object between the thumb and other tips, turned at random about their line.

    Returns hand_from_object (k, 4, 4) and configurations (k, j) in which nothing touches, k at most `count`.
    """
    hand, model = clearance.hand, clearance.model
    table = pinch_table(hand, sensors)
    first, second = facing_pairs(model, rng, settings)
    if len(first) == 0 or len(table.q) == 0:
        return np.zeros((0, 4, 4)), np.zeros((0, len(hand.joint_names)))
    tries = 4 * count
    pair = rng.integers(len(first), size=tries)
    width = np.linalg.norm(second[pair] - first[pair], axis=1)
    # the best facing postures among those that open a little wider than the part
    room = table.gap[None] - width[:, None] - 2 * settings.pinch_room
    fits = (room > 0) & (room < 0.02)
    chosen = np.array([rng.choice(np.nonzero(row)[0][:40]) if row.any() else -1 for row in fits])
    pair, chosen, width = pair[chosen >= 0], chosen[chosen >= 0], width[chosen >= 0]
    placed = np.zeros((len(pair), 4, 4))
    for i, (p, c) in enumerate(zip(pair, chosen)):
        line_object = (second[p] - first[p]) / width[i]
        line_hand = table.others[c] - table.thumb[c]
        line_hand = line_hand / np.linalg.norm(line_hand)
        rotation = _between(line_object, line_hand)
        rotation = poses.exp_rotation(line_hand * rng.uniform(-np.pi, np.pi)) @ rotation
        middle = 0.5 * (table.thumb[c] + table.others[c])
        placed[i] = poses.make_pose(rotation, middle - rotation @ (0.5 * (first[p] + second[p])))
    q = table.q[chosen].copy()
    for finger in find_fingers(hand):
        if finger.sensor not in sensors:  # out of the way: stretched, or curled loosely
            curl = rng.choice((0.15, 0.5), size=len(q))
            for j in finger.closing:
                low, high = np.clip(hand.limits[j], -np.pi, np.pi)
                q[:, j] = low + curl * (high - low)
    if len(q) == 0:
        return placed, q
    free = np.nonzero(clearance.least(hand.link_poses(q), placed) > 1e-3)[0][:count]
    return placed[free], q[free]


def _between(source: Array, target: Array) -> Array:
    """(3, 3) rotation that takes the unit vector `source` to `target`."""
    axis = np.cross(source, target)
    sine, cosine = float(np.linalg.norm(axis)), float(source @ target)
    if sine < 1e-9:
        if cosine > 0:
            return np.eye(3)
        axis, sine = np.cross(source, np.eye(3)[np.argmin(np.abs(source))]), 0.0
        axis = axis / np.linalg.norm(axis)
        return poses.exp_rotation(axis * np.pi)
    return poses.exp_rotation(axis / sine * np.arctan2(sine, cosine))
