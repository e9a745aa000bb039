"""The last tenths of a millimetre of a grasp: each finger closed until it touches, by exact distances.

Object frame for surfaces, hand frame for poses; metres.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from scenes.geometry import poses
from scenes.geometry.objects import ObjectModel
from scenes.robot import clearance_kernels as kernels
from scenes.robot.fingers import Finger, find_fingers, reach_bounds
from scenes.robot.hands import Hand
from scenes.robot.tips import FINE, nearest

Array = NDArray[np.float64]

# A tip touches when it is this near the surface (m): a fifth of what the contact must be exact to.
TOUCH = 2.0e-5
# Room around a finger in which the object's points are watched while it moves (m).
REACH = 0.015
# Within this of the surface the lattice's rounding matters and exact distances are asked for (m).
EXACT_BELOW = 1.5e-3
# Tips farther than this (m) from the object are not asked for their exact nearest point.
NEAR_TIP = 4.0e-3


class ExactClosing:
    """Closes one placement of one object in one hand."""

    def __init__(self, hand: Hand, model: ObjectModel, spacing: float, self_overlap: float) -> None:
        """spacing: of samples on the links (m); self_overlap: how far links may enter one another (m)."""
        self.hand, self.model, self.self_overlap = hand, model, self_overlap
        self.fingers = find_fingers(hand)
        self._cores = {f.sensor: f.tip.samples(FINE) for f in self.fingers}
        self._points, _, self._link = hand.surface_samples(spacing)
        self._pieces = [self._points[self._link == row] for row in range(len(hand.link_names))]
        self._starts = np.cumsum([0, *map(len, self._pieces)])
        self._sorted = np.concatenate(self._pieces)
        count = len(self._sorted)
        self._room = np.zeros(count), np.zeros((count, 3)), np.zeros(count, dtype=np.int64)
        surface, _ = model.sample_surface(3000, seed=0)
        # every corner of the mesh counts; beyond 40,000 they are nearer to one another than any tolerance
        corners = model.vertices[:: len(model.vertices) // 40_000 + 1]
        self.object_points = np.concatenate([surface, corners])
        moved = {i for f in self.fingers for i in f.links}
        self._still = tuple(i for i in range(len(hand.link_names)) if i not in moved)

    def close(
        self,
        hand_from_object: Array,
        start: Array,
        speed: Array,
        near: Array,
        sensors: tuple[str, ...],
        least: int = 0,
    ) -> tuple[Array, dict[str, tuple[Array, Array]]] | None:
        """Close from `near` (j,), found with sparse samples on the way from `start` with `speed`.

        Joint values (j,) and, for each touching tip of `sensors`, the point and outward normal, object frame.

        None when the object or the hand itself is in the way before the fingers have closed, and as soon as fewer
        than `least` tips can touch.
        """
        q = near
        object_in_hand = poses.apply(hand_from_object, self.object_points)
        if self._still and self._links_clearance(q, hand_from_object, object_in_hand, self._still) < 0:
            return None
        touching: dict[str, tuple[Array, Array]] = {}
        misses = 0
        for finger in sorted(self.fingers, key=lambda f: f.is_thumb):  # the thumb last: it gives way to the fingers
            if finger.sensor in sensors:
                around = self._around(finger, q, object_in_hand)
                q = self._close_finger(finger, q, start, speed, hand_from_object, around)
            if self.clearance(finger, q, hand_from_object, object_in_hand) < 0:
                return None
            point, normal, gap = self.tip_contact(finger, q, hand_from_object)
            if finger.sensor not in sensors:
                continue
            if gap < 2 * TOUCH:
                touching[finger.sensor] = (point, normal)
            else:
                misses += 1
            if len(sensors) - misses < least:
                return None
        if self._overlap(q) > self.self_overlap:
            return None
        return q, touching

    def is_blocked(self, q: Array, hand_from_object: Array) -> bool:
        """Whether a link that no finger moves is in the object, or the hand in itself."""
        object_in_hand = poses.apply(hand_from_object, self.object_points)
        if self._still and self._links_clearance(q, hand_from_object, object_in_hand, self._still) < 0:
            return True
        return self._overlap(q) > self.self_overlap

    def _around(self, finger: Finger, q: Array, points: Array) -> Array:
        """Those of points (n, 3) that the finger can meet in a little motion; the rest is checked once, at the end."""
        hand_from_link = self.hand.link_poses(q)
        reach = np.concatenate([poses.apply(hand_from_link[row], self._pieces[row]) for row in finger.links])
        low, high = reach.min(axis=0) - REACH, reach.max(axis=0) + REACH
        near = np.zeros(points.shape)
        return near[: kernels.in_box(points, low, high, near)]

    def _close_finger(
        self, finger: Finger, q: Array, start: Array, speed: Array, hand_from_object: Array, object_in_hand: Array
    ) -> Array:
        """Move the finger along its speeds until a link touches, then go on with the joints beyond that link."""
        own = list(finger.closing)
        limits = self.hand.limits
        direction = np.zeros_like(q)
        direction[own] = speed[own]
        # the sparse closing may have gone a little too far for the dense samples: open until free
        back = 0.01
        while self.clearance(finger, q, hand_from_object, object_in_hand) < 0 and back < 2.0:
            q = q.copy()
            q[own] = np.maximum(q[own] - back * np.maximum(speed[own], 0.2), start[own])
            back *= 2
        for _ in range(len(own) + 1):
            q = self._advance(finger, q, direction, hand_from_object, object_in_hand)
            blocked = np.zeros(len(q), dtype=bool)
            for row in finger.links:
                if self._links_clearance(q, hand_from_object, object_in_hand, (row,), finger) < 2 * TOUCH:
                    blocked |= self.hand.moved_by[row]
            direction[blocked | (q > limits[:, 1] - 1e-6)] = 0.0
            if not direction.any():
                break
        return q

    def _advance(
        self, finger: Finger, q: Array, direction: Array, hand_from_object: Array, object_in_hand: Array
    ) -> Array:
        """The farthest q + s * direction that stays free, up to the first limit: clearance at the end below TOUCH."""
        bound = float((np.abs(direction) @ reach_bounds(self.hand).T)[list(finger.links)].max())
        if bound <= 0:
            return q
        closing = direction > 0
        end = float(((self.hand.limits[:, 1] - q)[closing] / direction[closing]).min())

        def clearance(s: float) -> float:
            return self.clearance(finger, q + s * direction, hand_from_object, object_in_hand)

        return q + self.advance(clearance, bound, end) * direction

    def advance(self, clearance: Callable[[float], float], bound: float, end: float) -> float:
        """The farthest s up to `end` that stays free; clearance(s) there is below TOUCH unless `end` came first.

        bound: how fast the clearance can fall at most, metres a unit of s.
        """
        low, low_value, slope = 0.0, clearance(0.0), bound
        for _ in range(60):
            if low_value < TOUCH or low >= end:
                break
            # safe steps while far; near contact the slope seen so far predicts the touch
            sure = low + low_value / bound
            guess = low + (low_value - 0.5 * TOUCH) / slope if low_value < 1e-3 else sure
            trial = min(max(sure, guess), end)
            value = clearance(trial)
            if value < 0:
                return self._bisect(clearance, low, low_value, trial, value)
            slope = max((low_value - value) / max(trial - low, 1e-12), 0.05 * bound)
            low, low_value = trial, value
        return low

    @staticmethod
    def _bisect(
        clearance: Callable[[float], float], low: float, low_value: float, high: float, high_value: float
    ) -> float:
        """A free value between free `low` and blocked `high`, clearance below TOUCH, by secants kept well inside."""
        for _ in range(40):
            if low_value < TOUCH or high - low < 1e-9:
                break
            share = (low_value - 0.5 * TOUCH) / max(low_value - high_value, 1e-15)
            middle = low + min(max(share, 0.05), 0.95) * (high - low)
            value = clearance(middle)
            if value >= 0:
                low, low_value = middle, value
            else:
                high, high_value = middle, value
        return low

    def supports(self, q: Array, hand_from_object: Array, palm_gap: float) -> tuple[Array, Array]:
        """Where links other than tips back the object: points (k, 3) and outward normals (k, 3), object frame.

        One for each link nearer than 1 mm, or `palm_gap` for links that no finger moves: a power grasp pulls the
        object into the palm.
        """
        hand_from_link = self.hand.link_poses(q)
        object_from_hand = poses.inverse(hand_from_object)
        frames = object_from_hand @ hand_from_link
        samples = np.einsum("nij,nj->ni", frames[self._link][:, :3, :3], self._points) + frames[self._link][:, :3, 3]
        distance, gradient = self.model.field.distance_and_gradient(samples)
        tips = {f.tip_link for f in self.fingers}
        rows = []
        for link in range(len(self.hand.link_names)):
            own = np.nonzero(self._link == link)[0]
            if link in tips or len(own) == 0:
                continue
            nearest = own[np.argmin(distance[own])]
            if distance[nearest] < (palm_gap if link in self._still else 1e-3):
                rows.append(nearest)
        return samples[rows] - distance[rows, None] * gradient[rows], gradient[rows]

    def clearance(self, finger: Finger, q: Array, hand_from_object: Array, object_in_hand: Array) -> float:
        """Smallest distance (m) between a finger and the object, whose points (n, 3) are in the hand frame."""
        return self._links_clearance(q, hand_from_object, object_in_hand, finger.links, finger)

    def _links_clearance(
        self,
        q: Array,
        hand_from_object: Array,
        object_in_hand: Array,
        rows: tuple[int, ...],
        finger: Finger | None = None,
    ) -> float:
        """Smallest distance between these links and the object, both ways; negative when one is inside the other."""
        hand_from_link = self.hand.link_poses(q)
        object_from_hand = poses.inverse(hand_from_object)
        smallest = self._sample_clearance(object_from_hand @ hand_from_link, rows)
        if finger is not None and finger.tip_link in rows:
            smallest = min(smallest, self._tip_gap(finger, object_from_hand @ hand_from_link[finger.tip_link])[1])
        smallest = _points_to_links(self.hand, rows, hand_from_link, object_in_hand, smallest)
        if finger is not None and finger.is_thumb:
            smallest = min(smallest, self._thumb_to_fingers(finger, hand_from_link, rows))
        return smallest

    def _sample_clearance(self, object_from_link: Array, rows: tuple[int, ...]) -> float:
        """Least distance (m) of the samples of these links, of object_from_link (l, 4, 4), from the object."""
        field = self.model.field
        given = object_from_link, np.array(rows), self._sorted, self._starts, field.blocks
        samples = self._room[1][: kernels.may_be_near(*given, EXACT_BELOW, *self._room)]
        rough = field.distance(samples)
        near = np.abs(rough) < EXACT_BELOW
        smallest = float(rough[~near].min(initial=np.inf))
        if near.any():
            distance, _, _ = self.model.surface.closest(samples[near])
            # across a sharp edge the nearest triangle's side misleads: the lattice knows inside from outside there
            sure = np.abs(rough[near]) > 3e-4
            distance = np.where(sure, np.copysign(distance, rough[near]), distance)
            smallest = min(smallest, float(distance.min()))
        return smallest

    def _core_distance(self, points: Array) -> Array:
        """Signed distances (n,) of points of a core, which lie well outside the object when the tip does."""
        distance, _, _ = self.model.surface.closest(points)
        return np.copysign(distance, self.model.field.distance(points))

    def _tip_gap(self, finger: Finger, object_from_link: Array) -> tuple[Array, float]:
        """The tip's core's point (3,) nearest to the object, object frame, and the gap between tip and object (m)."""
        object_from_tip, tip = object_from_link @ finger.link_from_tip, finger.tip
        core = poses.apply(object_from_tip, self._cores[finger.sensor])
        rough = self.model.field.distance(core)
        start = int(np.argmin(rough))
        if len(core) > 1 and rough[start] > NEAR_TIP:
            return core[start], float(rough[start]) - tip.rounding

        def distance(points: Array) -> Array:
            return self._core_distance(poses.apply(object_from_tip, points))

        point, smallest = nearest(tip, distance, self._cores[finger.sensor][start])
        return poses.apply(object_from_tip, point[None])[0], smallest - tip.rounding

    def tip_contact(self, finger: Finger, q: Array, hand_from_object: Array) -> tuple[Array, Array, float]:
        """Closest surface point to the tip, its outward normal, and the gap between them."""
        frame = poses.inverse(hand_from_object) @ self.hand.link_poses(q)[finger.tip_link]
        core, gap = self._tip_gap(finger, frame)
        _, _, foot = self.model.surface.closest(core[None])
        # the core is outside: the direction to it is the outward normal, on edges and corners too
        away = core - foot[0]
        return foot[0], away / max(float(np.linalg.norm(away)), 1e-12), gap

    def _thumb_to_fingers(self, thumb: Finger, hand_from_link: Array, rows: tuple[int, ...]) -> float:
        """Distance from the thumb's samples to the other fingers' links, the allowed overlap added."""
        points = np.concatenate([poses.apply(hand_from_link[row], self._pieces[row]) for row in rows])
        others = {i for f in self.fingers if f is not thumb for i in f.links}
        return _points_to_links(self.hand, tuple(others), hand_from_link, points) + self.self_overlap

    def _overlap(self, q: Array) -> float:
        """How deep links of one finger lie inside links of another (m), 0 when they do not."""
        hand_from_link = self.hand.link_poses(q)
        deepest = 0.0
        for finger in self.fingers:
            chunks = [poses.apply(hand_from_link[r], self._pieces[r]) for r in finger.links]
            points = np.concatenate(chunks)
            for other in self.fingers:
                if other is not finger:
                    # knuckles sit in the palm beside one another
                    deepest = max(deepest, -_points_to_links(self.hand, other.links[1:], hand_from_link, points))
        return deepest


# Convex pieces of all links: outward normals (p, 3), offsets (p,), of each piece a box a little larger, low and high
# (k, 3), where its planes begin (k + 1,), where the pieces of each link do (l + 1,), and balls about a link's boxes
# (l, 4), middle and radius.
Pieces = tuple[Array, Array, Array, Array, NDArray[np.int64], NDArray[np.int64], Array]


@lru_cache(maxsize=16)
def _convex_pieces(hand: Hand) -> Pieces:
    """The convex pieces of each link."""
    import trimesh

    normals, offsets, boxes, links = [np.zeros((0, 3))], [np.zeros(0)], [np.zeros((0, 2, 3))], [0]
    balls = np.zeros((len(hand.link_names), 4))
    for row, shapes in enumerate(hand.robot.links.values()):
        for shape in shapes:
            mesh = trimesh.Trimesh(shape.vertices, shape.faces, process=False)
            if not mesh.is_convex:
                continue  # only its samples are held against the object
            normals.append(np.array(mesh.face_normals))
            offsets.append(np.einsum("ij,ij->i", normals[-1], np.array(mesh.triangles_center)))
            boxes.append(np.array([[shape.vertices.min(axis=0) - 0.002, shape.vertices.max(axis=0) + 0.002]]))
        links.append(len(boxes) - 1)
        if links[-1] > links[-2]:
            own = np.concatenate(boxes[1 + links[-2] :])
            low, high = own[:, 0].min(axis=0), own[:, 1].max(axis=0)
            balls[row] = (*(low + high) / 2, np.linalg.norm(high - low) / 2 + kernels.SLACK)
    box, starts = np.concatenate(boxes), np.cumsum([len(planes) for planes in normals])
    ends = np.ascontiguousarray(box[:, 0]), np.ascontiguousarray(box[:, 1])
    return np.concatenate(normals), np.concatenate(offsets), *ends, starts, np.array(links), balls


def _points_to_links(
    hand: Hand, rows: tuple[int, ...], hand_from_link: Array, points: Array, smallest: float = np.inf
) -> float:
    """Least of `smallest` and the distances (m) from points (n, 3), hand frame, to these links' convex pieces, of each
    those in its box; negative inside. hand_from_link (l, 4, 4).
    """
    pieces = _convex_pieces(hand)
    normals, offsets, low, _, starts, links, _ = pieces
    seen, first = np.zeros(len(low), dtype=np.int64), np.zeros((len(low), 3))
    given = hand_from_link, np.array(rows, dtype=np.int64), pieces
    smallest, alone = kernels.least_to_pieces(points, *given, smallest, np.zeros(3), seen, first)
    if alone:
        for row in rows:
            for k in range(links[row], links[row + 1]):
                if seen[k] == 1:
                    own = slice(starts[k], starts[k + 1])
                    smallest = min(smallest, float((first[k : k + 1] @ normals[own].T - offsets[own]).max()))
    return float(smallest)
