"""Whether the object goes with the hand that the robot tells of, as images show it.

A hand that is told need not hold anything: it reaches for what lies on a table, has put it down, or has handed it over.
Where it has moved since an image showed the object, the object is either where the hand would have carried it or where
it was; of what only one of the two would show, the depth image tells which.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Frame

Array = NDArray[np.float64]

# The hand has moved so far from what it may hold (m, of the object's middle) that an image may tell: twice what depth
# is believed to differ by; and so far that what was shown before is out of date where it has not told.
APART, LEFT = 0.010, 0.050
# What agrees with a depth image lies so near its readings (m): what cameras differ by from place to place.
NEAR = 0.006
# Share of what only one of the two places would show that is seen there, and at most at the other.
SHOWN, ELSEWHERE = 0.6, 0.3
# Or so many points are, and at the other no more than this share of them: in two sequences of another generator, looked
# at frame by frame, 247 to 777 are at the right place and 0 to 103 at the other. By judgement.
MANY, FEWER = 100, 0.25
# Points of the surface that are looked at, of which the half that faces the camera counts; fewest that tell.
POINTS, FEWEST = 2000, 20
# An object moves by itself that is so far (m) from where it was beside a hand that has hardly moved (m).
MOVED, STILL = 0.004, 0.003
# Whose middle has not moved by that, its ends may be so far off (m) for what a look has it turned by mistake: a banana
# that lies, 3 degrees off, seemed to lag behind a hand by two frames.
TURNED = 0.010


@dataclass(frozen=True)
class Instant:
    """When frame `index` was: (4, 4) camera_from_world, and camera_from_hand as the robot reports it."""

    index: int
    world: Array
    hand: Array


@dataclass(frozen=True)
class Held:
    """stays: images have shown that the object does not go with the hand; last: the last frame with a hand; pose (4, 4)
    camera_from_object at the instant `since`, from which the hand is followed; None before. told: by the last image,
    which another has to bear out: a camera that is bumped has hand and object elsewhere in one.
    """

    stays: bool = False
    last: Instant | None = None
    pose: Array | None = None
    since: Instant | None = None
    told: str = ""

    @property
    def said(self) -> tuple[str, ...]:
        """A note, while it stays."""
        return ("the hand moves without the object: it is not held",) if self.stays else ()

    def rests(self, model: ObjectModel, pose: Array) -> bool:
        """Whether an object at a pose (4, 4) in the last frame has not moved since it was shown first: then it does not
        go with the hand, or the image has not heard of that yet.
        """
        if self.pose is None or self.last is None:
            return False
        stayed = self._places(self.last, None)[0]
        middle = np.linalg.norm(se3.difference(stayed, pose, model.centroid)[3:])
        return bool(middle <= MOVED and shift(model, stayed, pose) <= TURNED)

    @property
    def bumped(self) -> Held:
        """When the camera was found to have been bumped: what it showed before is elsewhere."""
        return Held(self.stays)

    @property
    def touching(self) -> Held:
        """When fingers feel it where it is: they hold it, until images show otherwise."""
        return Held(False, self.last) if self.stays else self

    def followed(
        self,
        model: ObjectModel,
        frame: Frame,
        now: Instant,
        pose: Array | None,
        correction: Array | None,
        seen_from: Array | None = None,
    ) -> tuple[Held, Array | None]:
        """With a frame that has depth, before it is looked at; and where the object is (4, 4) when it turns out that
        the hand has moved without it. pose (4, 4): where the last frame showed it, None where it showed nothing.
        correction (4, 4): camera_from_camera of what the robot reports, None where nothing has told it.
        seen_from (4, 4): takes a pose to where images show it, None for there.
        """
        held = replace(self._begun(model, pose, correction), last=now)
        if held.pose is None:
            return held, None
        stayed, carried = held._places(now, correction)
        apart = shift(model, stayed, carried)
        seen = np.eye(4) if seen_from is None else seen_from
        told = which(model, frame, seen @ stayed, seen @ carried) if apart >= APART else ""
        if not told or told != self.told:
            gone = apart > LEFT and not told
            return (
                replace(held, pose=None, since=None, told="") if gone else replace(held, told=told or self.told)
            ), None
        stays = told == "stayed"
        return Held(stays, now), stayed if stays and not self.stays else None

    def _begun(self, model: ObjectModel, pose: Array | None, correction: Array | None) -> Held:
        """With what the last frame showed, where nothing was shown before, or the object has moved by itself since."""
        if pose is None or self.last is None:
            return self
        if self.pose is not None:
            stayed, carried = self._places(self.last, correction)
            if shift(model, stayed, carried) >= STILL or shift(model, stayed, pose) <= MOVED:
                return self
        return replace(self, pose=pose, since=self.last)

    def _places(self, now: Instant, correction: Array | None) -> tuple[Array, Array]:
        """camera_from_object (4, 4) at another instant of what has stayed in the world, and gone with the hand."""
        assert self.pose is not None
        assert self.since is not None
        motion = now.hand @ se3.inverse(self.since.hand)
        if correction is not None:
            motion = correction @ motion @ se3.inverse(correction)
        return now.world @ se3.inverse(self.since.world) @ self.pose, motion @ self.pose


def which(model: ObjectModel, frame: Frame, stayed: Array, carried: Array) -> str:
    """Which of two poses (4, 4) a depth image shows, "stayed" or "carried"; "" where it does not tell.

    It shows the one whose surface is seen where it must be, where hardly any of the other's is, or hardly as much: a
    pose that would be in the table shows only what stands out of it.
    """
    here, there = _seen(model, frame, stayed, carried), _seen(model, frame, carried, stayed)
    if here.shows and there.hardly(here):
        return "stayed"
    return "carried" if there.shows and here.hardly(there) else ""


@dataclass(frozen=True)
class _Seen:
    """Of the points at a pose that only it would show: how many may be seen, nothing being nearer, and are seen."""

    open: int
    there: int

    @property
    def share(self) -> float:
        """NaN where little may be seen."""
        return self.there / self.open if self.open >= FEWEST else float("nan")

    @property
    def shows(self) -> bool:
        return self.share >= SHOWN

    def hardly(self, other: _Seen) -> bool:
        """Whether hardly anything of it is seen beside another pose that is shown."""
        few = other.there >= MANY and self.there <= FEWER * other.there
        return self.share <= ELSEWHERE or few


def shown(model: ObjectModel, frame: Frame, pose: Array, other: Array | None = None) -> float:
    """Share of the surface at a pose (4, 4) that a depth image has where it is, of what faces the camera, is not hidden
    by something nearer and, if there is an `other` pose (4, 4), is not on the surface there; NaN where that is little.
    """
    return _seen(model, frame, pose, other).share


def _seen(model: ObjectModel, frame: Frame, pose: Array, other: Array | None) -> _Seen:
    camera, depth = frame.camera, frame.depth
    if camera is None or depth is None:
        return _Seen(0, 0)
    points, normals = model.sample_surface(POINTS)
    points, normals = se3.apply(pose, points), normals @ pose[:3, :3].T
    points = points[np.einsum("ij,ij->i", normals, points) < 0.0]
    if other is not None:
        points = points[np.abs(model.field.distance(se3.apply(se3.inverse(other), points))) > NEAR]
    uv, z = camera.project(points)
    inside = (z > 0) & (uv[:, 0] > -0.5) & (uv[:, 0] < camera.width - 0.5)
    inside &= (uv[:, 1] > -0.5) & (uv[:, 1] < camera.height - 0.5)
    column, row = np.rint(uv[inside]).astype(int).T
    read, z = depth[row, column].astype(np.float64), z[inside]
    beyond = (read - z)[(read > 0) & np.isfinite(read)]
    beyond = beyond[beyond > -NEAR]
    return _Seen(len(beyond), int((beyond < NEAR).sum()))


def shift(model: ObjectModel, pose: Array, other: Array) -> float:
    """How far (m) two poses (4, 4) have the object's surface apart, at most: its middle, and its ends by the turn."""
    delta = se3.difference(pose, other, model.centroid)
    return float(np.linalg.norm(delta[3:]) + np.linalg.norm(delta[:3]) * model.radius)
