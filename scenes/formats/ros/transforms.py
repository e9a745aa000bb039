"""Transforms as TF publishes them: a tree of frames over time. Metres; stamps in nanoseconds.

tf2's conventions: a message gives parent_from_child; quaternions are x y z w.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenes.errors import CaptureError
from scenes.geometry import poses

Array = NDArray[np.float64]

# A quaternion off unit length by more than this is no rounding error.
LENGTH_TOLERANCE = 1e-3


class TransformTree:
    """Every transform of a bag; `lookup` gives the one between two frames at a time.

    Between two samples of a moving joint the transform is interpolated when they are no more than two tolerances
    apart; otherwise the nearest sample counts when it is within one tolerance.
    """

    def __init__(self, tolerance_ns: int) -> None:
        self.tolerance_ns = tolerance_ns
        self._parents: dict[str, str] = {}
        self._static: dict[str, Array] = {}
        self._moving: dict[str, dict[int, Array]] = {}
        self._sorted: dict[str, tuple[NDArray[np.int64], list[Array]]] = {}

    def add(self, message: Any, static: bool, where: str) -> None:
        """Keep the transforms of a TFMessage; raises CaptureError for one that is no rigid transform."""
        for row in message.transforms:
            parent, child = row.header.frame_id.lstrip("/"), row.child_frame_id.lstrip("/")
            pose = _pose(row.transform, f"{where}, {parent} to {child}")
            if self._parents.setdefault(child, parent) != parent:
                raise CaptureError(f"{where}: expected one parent of {child}, got {self._parents[child]} and {parent}")
            if static:
                self._static[child] = pose
            else:
                stamp = int(row.header.stamp.sec) * 1_000_000_000 + int(row.header.stamp.nanosec)
                self._moving.setdefault(child, {})[stamp] = pose
                self._sorted.pop(child, None)

    def fix(self, parent: str, child: str, pose: Array, where: str) -> None:
        """Keep a transform that no message tells; raises CaptureError when the child has another parent."""
        if self._parents.setdefault(child, parent) != parent:
            raise CaptureError(f"{where}: expected one parent of {child}, got {self._parents[child]} and {parent}")
        self._static[child] = pose

    @property
    def frames(self) -> list[str]:
        """Names of all frames."""
        return sorted({*self._parents, *self._parents.values()})

    def lookup(self, target: str, source: str, stamp: int) -> Array | None:
        """target_from_source (4, 4) at that time, None when a sample is missing; raises CaptureError when they are not
        connected at all.
        """
        up, down = self._chain(source), self._chain(target)
        common = next((frame for frame in up if frame in down), None)
        if common is None:
            unknown = [name for name in (target, source) if name not in self.frames]
            known = ", ".join(self.frames) or "none"
            if unknown:
                raise CaptureError(f"TF: expected the frame {unknown[0]}, got {known}")
            raise CaptureError(f"TF: expected a way from {source} to {target}, they are in separate trees of {known}")
        legs = []
        for chain in (down, up):
            leg: Array | None = np.eye(4)
            for frame in chain[: chain.index(common)]:
                step = self._at(frame, stamp)
                leg = None if leg is None or step is None else step @ leg
            legs.append(leg)
        if legs[0] is None or legs[1] is None:
            return None
        return legs[1] if target == common else poses.inverse(legs[0]) @ legs[1]

    def _chain(self, frame: str) -> list[str]:
        chain = [frame]
        while chain[-1] in self._parents:
            parent = self._parents[chain[-1]]
            if parent in chain:
                raise CaptureError(f"TF: expected a tree, got a circle through {parent}")
            chain.append(parent)
        return chain

    def _at(self, child: str, stamp: int) -> Array | None:
        """parent_from_child at that time."""
        if child in self._static:
            return self._static[child]
        if child not in self._sorted:
            samples = self._moving[child]
            order = sorted(samples)
            self._sorted[child] = np.array(order, dtype=np.int64), [samples[s] for s in order]
        stamps, places = self._sorted[child]
        after = int(np.searchsorted(stamps, stamp))
        if after < len(stamps) and stamps[after] == stamp:
            return places[after]
        before = after - 1
        if before >= 0 and after < len(stamps):
            gap = int(stamps[after] - stamps[before])
            if gap <= 2 * self.tolerance_ns:
                return _between(places[before], places[after], (stamp - int(stamps[before])) / gap)
        near = [i for i in (before, after) if 0 <= i < len(stamps)]
        best = min(near, key=lambda i: abs(int(stamps[i]) - stamp))
        return places[best] if abs(int(stamps[best]) - stamp) <= self.tolerance_ns else None


def _between(first: Array, second: Array, share: float) -> Array:
    """Rotation along the shortest arc, translation along the line."""
    turn = poses.log_rotation(first[:3, :3].T @ second[:3, :3])
    moved = (1.0 - share) * first[:3, 3] + share * second[:3, 3]
    return poses.make_pose(first[:3, :3] @ poses.exp_rotation(share * turn), moved)


def _pose(transform: Any, where: str) -> Array:
    q, t = transform.rotation, transform.translation
    quaternion = np.array([q.w, q.x, q.y, q.z], dtype=np.float64)
    shift = np.array([t.x, t.y, t.z], dtype=np.float64)
    if not (np.isfinite(quaternion).all() and np.isfinite(shift).all()):
        raise CaptureError(
            f"{where}: expected finite numbers, got rotation {quaternion[[1, 2, 3, 0]]} translation {shift}"
        )
    if abs(np.linalg.norm(quaternion) - 1.0) > LENGTH_TOLERANCE:
        raise CaptureError(f"{where}: expected a unit quaternion, got length {np.linalg.norm(quaternion):.4g}")
    return poses.make_pose(poses.from_quaternion(quaternion), shift)
