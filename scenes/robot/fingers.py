"""The fingers of a hand as a grasp planner sees them, and how they close on an object.

A finger ends in a touch sensor with a surface: sphere, ellipsoid, cylinder or mesh (see `tips`). Its closing joints
bend or slide; its posture joints (abduction, opposition, spread) stay where the grasp puts them. Planning is done on
`closing_hand`, where every joint closes as it rises. Poses are hand_from_object; metres and radians.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from scenes.errors import InputError
from scenes.geometry import poses
from scenes.geometry.objects import ObjectModel
from scenes.robot import clearance_kernels as kernels
from scenes.robot import roles
from scenes.robot.hands import Hand
from scenes.robot.sensors import Sensor
from scenes.robot.tips import COARSE, Tip, tip_of

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True)
class Finger:
    """sensor: name of its touch sensor; tip_link and links: rows of hand.link_names; closing: columns of
    hand.joint_names, from the root outwards; ways: for each +1 or -1, the sign in which it closes; tip: its shape, in
    the sensor's frame; link_from_tip (4, 4); centre (3,) of the tip in the tip link and its mean radius; is_thumb:
    whether it is the finger that works against the others.
    """

    sensor: str
    tip_link: int
    links: tuple[int, ...]
    closing: tuple[int, ...]
    tip: Tip
    link_from_tip: Array
    centre: Array
    radius: float
    ways: tuple[float, ...] = ()
    is_thumb: bool = False


@lru_cache(maxsize=16)
def find_fingers(hand: Hand) -> tuple[Finger, ...]:
    """The hand's fingers, one for each sensor with a surface at the end of a chain of its own.

    What each joint is for, which way it closes and which finger opposes the others is found from geometry (see
    `roles`). A joint that several fingers share closes them when they have no other: a gripper with one drive. Raises
    InputError when there are not two fingers to hold something between, and says what is missing.
    """
    tips = [s for s in hand.sensors.values() if s.surface is not None]
    rows = {s.name: hand.link_names.index(s.link) for s in tips}
    shared = roles.shared_joints(hand, set(rows.values())) if tips else np.zeros(0, dtype=bool)
    chosen: list[tuple[Sensor, int]] = []
    for sensor in tips:  # one sensor a link
        if hand.moved_by[rows[sensor.name]].any() and all(rows[sensor.name] != row for _, row in chosen):
            chosen.append((sensor, rows[sensor.name]))
    own = {s.name: roles.bending(hand, row, hand.moved_by[row] & ~shared) for s, row in chosen}
    drive = _drive(hand, [(s, row) for s, row in chosen if not own[s.name][0]], shared)
    chosen = [(s, row) for s, row in chosen if own[s.name][0] or (drive is not None and hand.moved_by[row, drive])]
    if len(chosen) < 2:
        raise InputError(_no_fingers(hand, tips, [s.name for s, _ in chosen]))
    points = [(row, poses.apply(s.link_from_sensor, _tip(s).centre[None])[0]) for s, row in chosen]
    driven = [row for s, row in chosen if not own[s.name][0]]
    sides = dict(zip(driven, roles.branch_links(hand, driven, drive))) if drive is not None else {}
    fingers: list[Finger] = []
    directions: list[Array] = []
    for i, (sensor, row) in enumerate(chosen):
        closing, signs = own[sensor.name]
        if closing:
            ways = tuple(s * roles.way(hand, points, i, closing, np.array(signs)) for s in signs)
            moving = hand.moved_by & (hand.moved_by[row] & ~shared)
            links = tuple(int(k) for k in np.nonzero(moving.any(axis=1))[0])
        else:
            assert drive is not None
            closing, links = (drive,), sides[row]
            ways = (-float(np.sign(roles.drives(hand, [points[chosen.index(c)] for c in chosen], drive))),)
        direction = np.zeros(len(hand.joint_names))
        direction[list(closing)] = ways
        directions.append(direction)
        tip = _tip(sensor)
        centre = points[i][1]
        fingers.append(Finger(sensor.name, row, links, closing, tip, sensor.link_from_sensor, centre, tip.radius, ways))
    thumb = roles.opposing(hand, points, directions)
    return tuple(replace(finger, is_thumb=i == thumb) for i, finger in enumerate(fingers))


def _tip(sensor: Sensor) -> Tip:
    tip = tip_of(sensor)
    assert tip is not None
    return tip


def _drive(hand: Hand, idle: list[tuple[Sensor, int]], shared: NDArray[np.bool_]) -> int | None:
    """The joint that brings the tips without a joint of their own together; None when there is none."""
    if len(idle) < 2:
        return None
    points = [(row, poses.apply(s.link_from_sensor, _tip(s).centre[None])[0]) for s, row in idle]
    power = [abs(roles.drives(hand, points, int(j))) for j in np.nonzero(shared)[0]]
    if not power or max(power) < roles.LEAST_DRIVE:
        return None
    return int(np.nonzero(shared)[0][int(np.argmax(power))])


def _no_fingers(hand: Hand, tips: list[Sensor], found: list[str]) -> str:
    expected = f"hand {hand.name!r}: expected two or more fingers, each a joint that bends or slides and a tip sensor"
    if not hand.sensors:
        return f"{expected}, got a hand without sensors: describe its tips in sensors.json"
    bare = [name for name, sensor in hand.sensors.items() if sensor.surface is None]
    if not tips:
        return f"{expected} with a surface, got none: sensor {bare[0]!r} has no surface"
    if len(tips) > len(found):
        still = next(sensor.name for sensor in tips if sensor.name not in found)
        hint = f"sensor {still!r} has no joint that brings it towards another tip"
    else:
        hint = f"sensor {bare[0]!r} has no surface" if bare else "only one tip sensor"
    return f"{expected}, got {', '.join(found) or 'none'}: {hint}"


@lru_cache(maxsize=16)
def closing_hand(hand: Hand) -> tuple[Hand, Array]:
    """The hand with every closing joint measured so that it closes as it rises, and (j,) the signs between the two:
    values of the one are the signs times those of the other. The hand itself when all close so already.
    """
    signs = np.ones(len(hand.joint_names))
    for finger in find_fingers(hand):
        signs[list(finger.closing)] = finger.ways
    return roles.turned_round(hand, tuple(int(j) for j in np.nonzero(signs < 0)[0])), signs


class Clearance:
    """Distances between a hand's links and an object, over many configurations at once.

    Hand links are sampled; so are the cores of tips, which for a sphere is its centre.
    """

    def __init__(self, hand: Hand, model: ObjectModel, spacing: float, only_fingers: bool = False) -> None:
        """spacing: of the samples on the links, metres; only_fingers: leave out the links that no finger moves."""
        self.hand, self.model = hand, model
        self.fingers = find_fingers(hand)
        points, _, link = hand.surface_samples(spacing, corners=False)
        rows = {i for f in self.fingers for i in f.links} if only_fingers else set(link.tolist())
        order = [i for i in np.argsort(link, kind="stable") if link[i] in rows]
        points, link = points[order], link[order]
        self._links = np.unique(link)
        self._points = np.ascontiguousarray(points)
        self._starts = np.searchsorted(link, self._links, side="left")
        self._starts = np.append(self._starts, len(link))
        self._tip_rows = [f.tip_link for f in self.fingers]
        self._centres = np.array([f.centre for f in self.fingers])
        self._cores = [poses.apply(f.link_from_tip, f.tip.samples(COARSE)) for f in self.fingers]
        self._core_starts = np.concatenate([[0], np.cumsum([len(core) for core in self._cores])[:-1]])
        self._rounding = np.array([f.tip.rounding for f in self.fingers])

    def tip_centres(self, hand_from_link: Array) -> Array:
        """(n, f, 3) centres of the tips, hand frame."""
        tips = hand_from_link[:, self._tip_rows]
        return np.einsum("nfij,fj->nfi", tips[..., :3, :3], self._centres) + tips[..., :3, 3]

    def links_and_tips(
        self, configurations: Array, hand_from_object: Array, moved: NDArray[np.bool_] | None = None
    ) -> tuple[Array, Array]:
        """Clearance of each link (n, l), tips included, and of each tip (n, f); metres, by the lattice.

        configurations (n, j), hand_from_object (n, 4, 4); moved (n, l): links that are asked for, others may be told
        farther.
        """
        frames = poses.inverse(hand_from_object)[:, None] @ self.hand.link_poses(configurations)
        links = np.full((len(frames), len(self.hand.link_names)), np.inf)
        links[:, self._links] = self._nearest(frames, moved).reshape(len(frames), -1)
        tips = self._tips(frames)
        for f, finger in enumerate(self.fingers):
            links[:, finger.tip_link] = np.minimum(links[:, finger.tip_link], tips[:, f])
        return links, tips

    def least(self, hand_from_link: Array, hand_from_object: Array) -> Array:
        """Least clearance (n,) of the hand, tips included, of hand_from_link (n, l, 4, 4)."""
        frames = poses.inverse(hand_from_object)[:, None] @ hand_from_link
        return np.minimum(self._nearest(frames, None, together=True), self._tips(frames).min(axis=1))

    def _tips(self, frames: Array) -> Array:
        """Clearance (n, f) of each tip, of frames (n, l, 4, 4) object from link."""
        cores = [poses.apply(frames[:, row], core) for row, core in zip(self._tip_rows, self._cores)]
        distance = self.model.field.distance(np.concatenate(cores, axis=1).reshape(-1, 3)).reshape(len(frames), -1)
        return np.asarray(np.minimum.reduceat(distance, self._core_starts, axis=1) - self._rounding)

    def _nearest(self, frames: Array, moved: NDArray[np.bool_] | None, together: bool = False) -> Array:
        """(n * b,) least distance of each link that has samples, (n,) of all together; of frames (n, l, 4, 4)."""
        n, count, links = len(frames), len(self._points), len(self._links)
        wanted = np.ones((n, links), dtype=bool) if moved is None else moved[:, self._links]
        least = np.full(n if together else n * links, np.inf)
        near, group = np.zeros((n * count, 3)), np.zeros(n * count, dtype=np.int64)
        given = frames, wanted, self._links, self._points, self._starts, self.model.field.blocks, together
        found = kernels.may_be_least(*given, np.zeros(count), near, group)
        kernels.least_of_groups(self.model.field.distance(near[:found]), group, least)
        return least


@lru_cache(maxsize=16)
def reach_bounds(hand: Hand) -> Array:
    """(l, j) metres a radian: no point of link l moves faster than this when joint j turns, in any posture."""
    points, _, link = hand.surface_samples()
    joints = hand.robot.joints
    bounds = np.zeros((len(hand.link_names), len(hand.joint_names)))
    size = np.zeros(len(hand.link_names))
    np.maximum.at(size, link, np.linalg.norm(points, axis=1))
    for sensor in hand.sensors.values():
        row = hand.link_names.index(sensor.link)
        tip = tip_of(sensor)
        reach = 0.0 if tip is None else tip.extent
        size[row] = max(size[row], float(np.linalg.norm(sensor.link_from_sensor[:3, 3])) + reach)
    parent = {i + 1: hand.link_names.index(joint.parent) for i, joint in enumerate(joints)}
    for row in range(1, len(hand.link_names)):
        farthest, current = size[row], row
        while current:  # each joint on the way to the root turns all that is beyond it
            factor = hand.coupling_of(joints[current - 1].name)
            turning = joints[current - 1].kind != "prismatic"
            bounds[row] += np.abs(factor) * (farthest if turning else 1.0)
            farthest += float(np.linalg.norm(joints[current - 1].parent_from_joint[:3, 3]))
            if not turning:  # what slides out is farther from the joints before it
                farthest += float(np.abs([joints[current - 1].lower, joints[current - 1].upper]).max())
            current = parent[current]
    return bounds


def close(
    clearance: Clearance,
    hand_from_object: Array,
    start: Array,
    speed: Array,
    touch: float = 2.5e-4,
    haste: float = 1.5,
    steps: int = 60,
) -> tuple[Array, Array, Array]:
    """Close all fingers of many grasps until they touch, by conservative advancement (Mirtich 1996).

    hand_from_object (n, 4, 4); start (n, j) joint values; speed (n, j), 0 for joints that stay. A joint stops when a
    link beyond it touches (clearance below `touch` metres) or at its limit; joints farther out go on. With `haste` 1
    no step is longer than the clearance allows; a little more is faster and rarely goes in by a few tenths.
    Returns joint values (n, j), clearance of links (n, l) and of tips (n, f).
    """
    hand = clearance.hand
    bounds = reach_bounds(hand)
    q = start.copy()
    moving = speed > 0
    links, tips = clearance.links_and_tips(q, hand_from_object)
    rows = np.arange(len(q))
    for _ in range(steps):
        touching = links[rows] < touch
        moving[rows] &= ~((touching[:, :, None] & hand.moved_by).any(axis=1))
        moving[rows] &= q[rows] < hand.limits[:, 1] - 1e-9
        rows = rows[moving[rows].any(axis=1)]
        if len(rows) == 0:
            break
        velocity = np.where(moving[rows], speed[rows], 0.0)
        fastest = velocity @ bounds.T
        room = haste * np.maximum(links[rows], 0.5 * touch)
        allowed = np.where(fastest > 0, room / np.maximum(fastest, 1e-12), 1e9)
        before = q[rows]
        for finger in clearance.fingers:
            step = allowed[:, list(finger.links)].min(axis=1)
            own = list(finger.closing)
            here = np.ix_(rows, np.array(own))
            q[here] = np.minimum(q[here] + step[:, None] * velocity[:, own], hand.limits[own, 1])
        # links that none of these joints moves are where they were
        moved = (q[rows] != before) @ hand.moved_by.T
        found, tips[rows] = clearance.links_and_tips(q[rows], hand_from_object[rows], moved)
        links[rows] = np.where(moved, found, links[rows])
    return q, links, tips
