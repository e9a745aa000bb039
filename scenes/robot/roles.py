"""What the joints and fingers of any hand are for, from its geometry: which joints close, which way, and who opposes.

Grippers, three-finger and five-finger hands differ in how many joints a finger has, whether they turn or slide, whether
one drive moves several fingers, and in the sign that closes. Tips tell: closing brings them towards one another, and
the finger that works against the others moves against them. Postures are drawn over the joints' ranges, with a seed.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from scenes.geometry import poses
from scenes.robot.hands import Hand
from scenes.robot.urdf import Joint, Mimic, Robot

Array = NDArray[np.float64]

# Names of joints that spread or place fingers. A hand that uses such words tells which joints do not close.
POSTURE_WORDS = ("abduction", "opposition", "spread", "rotation", "yaw", "wrist")
# Postures at which tips are looked at, and the step (rad or m) of their differences.
POSTURES = 256
STEP = 1e-4
# A joint that changes distances between tips by less than this (m per rad or per m) drives nothing.
LEAST_DRIVE = 1e-3
# Share of the postures in which a way must bring a tip nearer to the others; below, the joints' ranges decide.
SURE = 0.9
# Joints of a finger bend together when their axes are parallel within 45 degrees.
PARALLEL = float(np.cos(np.pi / 4))


def ranges(hand: Hand) -> Array:
    """(j, 2) limits (rad, m) of the driven joints; a turn each way for those without."""
    return np.clip(hand.limits, -np.pi, np.pi)


@lru_cache(maxsize=16)
def postures(hand: Hand) -> Array:
    """(POSTURES, j) configurations spread over the ranges, the same every time."""
    low, high = ranges(hand).T
    return np.random.default_rng(0).uniform(low, high, size=(POSTURES, len(low)))


def tip_places(hand: Hand, tips: list[tuple[int, Array]], q: Array) -> Array:
    """(n, t, 3) places, hand frame, of tips (row of the link, point (3,) in it) at configurations (n, j)."""
    frames = hand.link_poses(q)
    return np.stack([frames[:, row, :3, :3] @ point + frames[:, row, :3, 3] for row, point in tips], axis=1)


def shared_joints(hand: Hand, rows: set[int]) -> NDArray[np.bool_]:
    """(j,) which joints move more than one of these links."""
    return np.asarray(np.sum([hand.moved_by[row] for row in sorted(rows)], axis=0) > 1)


def bending(hand: Hand, row: int, own: NDArray[np.bool_]) -> tuple[tuple[int, ...], tuple[float, ...]]:
    """The joints among `own` (j,) that bend the finger which ends in link `row`, root first; and for each the sign (+1,
    -1) in which it turns or slides with the outermost one.

    A hand whose names tell (POSTURE_WORDS) is believed; in others those bend whose axes are parallel to the outermost.
    """
    names = hand.joint_names
    by_name = told(hand)
    axes = _axes(hand, row)
    columns = [int(j) for j in np.nonzero(own)[0]]
    if by_name:
        columns = [j for j in columns if not any(word in names[j].lower() for word in POSTURE_WORDS)]
    if not columns:
        return (), ()
    outermost = max(columns, key=lambda j: axes[j][1])
    kind, _, axis = axes[outermost]
    if not by_name:
        columns = [j for j in columns if axes[j][0] == kind and abs(axes[j][2] @ axis) > PARALLEL]
    signs = tuple(-1.0 if axes[j][0] == kind and axes[j][2] @ axis < -PARALLEL else 1.0 for j in columns)
    return tuple(columns), signs


def _axes(hand: Hand, row: int) -> dict[int, tuple[bool, int, Array]]:
    """By column of joint_names that moves link `row`: whether it slides, its depth, its axis (3,) at zero, hand frame.

    Of several joints that one column drives on the way, the outermost counts.
    """
    frames = hand.link_poses(np.zeros(len(hand.joint_names)))
    parent = {joint.child: joint for joint in hand.robot.joints}
    chain: list[Joint] = []
    link = hand.link_names[row]
    while link in parent:
        chain.append(parent[link])
        link = parent[link].parent
    found: dict[int, tuple[bool, int, Array]] = {}
    for depth, joint in enumerate(reversed(chain)):
        coupling = hand.coupling_of(joint.name)
        for column in np.nonzero(coupling)[0]:
            axis = frames[hand.link_names.index(joint.child)][:3, :3] @ joint.axis * np.sign(coupling[column])
            found[int(column)] = (joint.kind == "prismatic", depth, axis)
    return found


def drives(hand: Hand, tips: list[tuple[int, Array]], column: int) -> float:
    """Mean change of the distances between tips with this joint (m per rad or per m); 0 when it moves all as one."""
    q = postures(hand)
    step = np.zeros(q.shape[1])
    step[column] = STEP
    before, after = (_spread(tip_places(hand, tips, q + s * step)) for s in (-1.0, 1.0))
    return float(np.mean(after - before) / (2 * STEP))


def way(hand: Hand, tips: list[tuple[int, Array]], finger: int, columns: tuple[int, ...], signs: Array) -> float:
    """+1 or -1: the way along `signs` of these joints in which the finger closes: its tip comes nearer to the others;
    where that changes on the way, the joints go farther from zero.
    """
    q = postures(hand)
    step = np.zeros(q.shape[1])
    step[list(columns)] = STEP * signs

    def away(configuration: Array) -> Array:
        places = tip_places(hand, tips, configuration)
        others = np.delete(places, finger, axis=1)
        return np.asarray(np.linalg.norm(others - places[:, finger, None], axis=2).mean(axis=1))

    nearer = float(np.mean(away(q + step) < away(q - step))) if len(tips) > 1 else 0.5
    if max(nearer, 1.0 - nearer) > SURE:
        return 1.0 if nearer > 0.5 else -1.0
    # long fingers pass one another: made straight at zero, they bend farther to the side of the palm
    low, high = ranges(hand)[list(columns)].T
    reach = float(np.sum(np.where(signs > 0, high + low, -high - low)))
    return 1.0 if reach >= 0 else -1.0


def opposing(hand: Hand, tips: list[tuple[int, Array]], closing: list[Array]) -> int:
    """The tip that can move most against all others when each closes along its `closing` (j,)."""
    return int(np.argmax(np.round(opposition(hand, tips, closing).max(axis=0), 6)))


def opposition(hand: Hand, tips: list[tuple[int, Array]], closing: list[Array]) -> Array:
    """(POSTURES, t) how much each tip moves against all others, -1 to 1: minus the largest cosine between motions."""
    q = postures(hand)
    here = tip_places(hand, tips, q)
    motion = np.zeros_like(here)
    for i, direction in enumerate(closing):
        moved = tip_places(hand, [tips[i]], q + STEP * direction)[:, 0] - here[:, i]
        motion[:, i] = moved / np.maximum(np.linalg.norm(moved, axis=1, keepdims=True), 1e-12)
    against = -np.einsum("nik,njk->nij", motion, motion)
    against[:, np.arange(len(tips)), np.arange(len(tips))] = np.inf
    return np.asarray(against.min(axis=2))


def told(hand: Hand) -> bool:
    """Whether the names of the hand's joints say which of them spread or place fingers."""
    return any(word in name.lower() for name in hand.joint_names for word in POSTURE_WORDS)


def _spread(places: Array) -> Array:
    """(n,) sum of the distances between the tips (n, t, 3)."""
    first, second = np.triu_indices(places.shape[1], 1)
    return np.asarray(np.linalg.norm(places[:, first] - places[:, second], axis=2).sum(axis=1))


def turned_round(hand: Hand, columns: tuple[int, ...]) -> Hand:
    """The same hand with these driven joints measured the other way: their value is minus what it was."""
    flipped = {hand.joint_names[j] for j in columns}
    if not flipped:
        return hand
    joints = []
    for joint in hand.robot.joints:
        axis, low, high, mimic = joint.axis, joint.lower, joint.upper, joint.mimic
        if joint.name in flipped:
            axis, low, high = -axis, -high, -low
        if mimic is not None and mimic.joint in flipped:
            mimic = Mimic(mimic.joint, -mimic.multiplier, mimic.offset)
        joints.append(
            Joint(joint.name, joint.kind, joint.parent, joint.child, joint.parent_from_joint, axis, low, high, mimic)
        )
    robot = hand.robot
    return Hand(Robot(robot.name, robot.root, robot.links, tuple(joints)), hand.sensors)


def branch_links(hand: Hand, tip_rows: list[int], column: int) -> list[tuple[int, ...]]:
    """For each tip's link the links that this shared joint moves on that tip's side: its own chain, what hangs on it,
    and loose rods that are nearest to it.
    """
    names = hand.link_names
    parent = {i + 1: names.index(joint.parent) for i, joint in enumerate(hand.robot.joints)}

    def chain(row: int) -> list[int]:
        out = [row]
        while out[-1]:
            out.append(parent[out[-1]])
        return out

    moved = [int(i) for i in np.nonzero(hand.moved_by[:, column])[0]]
    owners = [{i for i in chain(row) if i in moved} for row in tip_rows]
    frames = hand.link_poses(ranges(hand).mean(axis=1))
    sides: list[list[int]] = [[] for _ in tip_rows]
    for row in moved:
        side = next((s for i in chain(row) for s, own in enumerate(owners) if i in own), None)
        if side is None:
            middle = _middle(hand, row, frames[row])
            side = int(np.argmin([np.linalg.norm(_middle(hand, tip, frames[tip]) - middle) for tip in tip_rows]))
        sides[side].append(row)
    return [tuple(side) for side in sides]


def _middle(hand: Hand, row: int, hand_from_link: Array) -> Array:
    """(3,) middle of a link's geometry, its origin when it has none; hand frame."""
    shapes = hand.robot.links[hand.link_names[row]]
    points = np.concatenate([shape.vertices for shape in shapes]) if shapes else np.zeros((1, 3))
    return poses.apply(hand_from_link, points.mean(axis=0)[None])[0]
