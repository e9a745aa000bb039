"""Looking again: the pixels of the object in a frame whose predecessor was understood. Camera frame, metres.

A first look searches the whole image for the hand and takes five passes to align it (vision.look.hand). From frame to
frame neither the robot's calibration nor the shape of a closed hand changes, so a second look begins where the last
one ended: one pass over few pixels, and the hand's mesh is laid out anew only when its joints have moved.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.beliefs import Beliefs
from scenes.recordings.frames import Frame
from scenes.robot.posed import PosedHand
from vision.look.hand.hand import HandTold, HandView, camera_from_hand, fit_hand, view_hand, where_seen_better
from vision.look.look import LookSettings, large_planes, look
from vision.look.looked import Looked, no_pixels, no_planes, nothing_seen
from vision.look.mask.planes import on_planes
from vision.look.pixels import Pixels, Region, read_pixels

Array = NDArray[np.float64]


@dataclass(frozen=True)
class WarmLookSettings:
    """What is looked at near a predicted pose. Values by judgement, on generated sequences."""

    # Pixels farther than this from the predicted surface are not the object's (m): a frame's motion against the
    # prediction and the prediction's own error, two sigmas of either.
    slack: float = 0.015
    # Pixels of the box around the object (for free space), and of those near the object the ones that are told apart
    # from the hand: a closest-point query each.
    most: int = 12_000
    most_near: int = 500
    # Pixels among which the hand is looked for, and of those that show it the ones it is aligned to.
    most_hand: int = 600
    most_aligned: int = 250
    # A hand pixel farther than this from the hand where it was last seen is something else (m), pass after pass.
    gates: tuple[float, ...] = (0.007, 0.005)
    # Object pixels that become rows.
    most_rows: int = 250
    # Free space: rays, and points a ray. Fewer than a first look needs: the pose is nearly known.
    free_rays: int = 60
    free_steps: int = 3


class Looker:
    """Segments one frame after another; remembers the hand's mesh, how far the calibration is off, and the table."""

    def __init__(
        self,
        model: ObjectModel,
        settings: WarmLookSettings | None = None,
        first: LookSettings | None = None,
        beliefs: Beliefs | None = None,
    ) -> None:
        """first: how a frame is looked at of which nothing is known, as for `vision.look.look`."""
        self.model = model
        self.settings = settings or WarmLookSettings()
        first = first or LookSettings()
        s = self.settings
        rows = replace(first.rows, most=s.most_rows, free_rays=s.free_rays, free_steps=s.free_steps)
        self.first = replace(first, slack=s.slack, most_others=s.free_rays, rows=rows)
        self.beliefs = beliefs or Beliefs()
        self.told: HandTold | None = None
        self.planes = no_planes()
        self._surface: PosedHand | None = None
        self._joints: tuple[tuple[str, float], ...] = ()

    @property
    def correction(self) -> Array | None:
        """(4, 4) camera_from_camera of what the robot reports, as the last look that found the hand has it."""
        return None if self.told is None else self.told.correction

    def look(self, frame: Frame, predicted: Array, share: float | None = None) -> Looked:
        """Sort the frame's pixels near `predicted` (4, 4) camera_from_object; clouds are cut out as they are.

        share: of the pixels, where a glance is enough: the hand is taken to be where it was last seen.
        """
        if frame.depth is None or frame.camera is None:
            return look(frame, self.model, self.beliefs, predicted, self.first)
        centre = predicted[:3, :3] @ self.model.centroid + predicted[:3, 3]
        region = Region(centre, self.model.radius + self.settings.slack)
        box = region.box(frame.camera)
        hand_view = self.view_hand(frame) if share is None else self._as_last_seen(frame)
        many = 1.0 if share is None else share
        if box is None:
            return nothing_seen(region, "region outside the image", hand_view)
        pixels = read_pixels(frame.depth, frame.camera, box, int(many * self.settings.most))
        near = np.linalg.norm(pixels.points - centre, axis=1) < region.radius
        near[near] = self._near_surface(pixels.points[near], predicted)
        bare = frame.mask is None and hand_view is None and self.first.tidy
        if share is None:  # where nothing else tells what is not the object's
            about = self.model, self.beliefs, self.first, predicted
            self.planes = large_planes(frame, *about) if bare else no_planes()
        near[near] = ~on_planes(pixels.points[near], self.planes, self.beliefs.depth, self.first.mask)
        if frame.mask is not None:
            near &= frame.mask[pixels.uv[:, 1], pixels.uv[:, 0]]
        mine = pixels.take(near).thinned(int(many * self.settings.most_near))
        others = pixels.take(~near).thinned(self.settings.free_rays)
        of_hand = np.zeros(len(mine), dtype=bool)
        if hand_view is not None and len(mine):
            of_hand = hand_view.nearer(mine.points, self.first.hand.margin)
        told_apart = frame.mask is not None or hand_view is not None
        dropped = {"hand pixels": int(of_hand.sum())} if hand_view is not None else {}
        return Looked(
            mine.take(~of_hand), mine.take(of_hand), others, region, hand_view, dropped, told_apart=told_apart,
            planes=self.planes,
        )  # fmt: skip

    def _near_surface(self, points: Array, predicted: Array) -> NDArray[np.bool_]:
        local = se3.apply(se3.inverse(predicted), points)
        return np.asarray(np.abs(self.model.field.distance(local)) < self.settings.slack)

    def view_hand(self, frame: Frame) -> HandView | None:
        """The frame's hand aligned to its pixels, from where the last frame left it; None without hand and depth."""
        measured = camera_from_hand(frame)
        if frame.hand is None or frame.joints is None or measured is None:
            return None
        if frame.depth is None or frame.camera is None:
            return None
        if self.correction is None:
            full = (0, 0, frame.camera.width, frame.camera.height)
            wide = read_pixels(frame.depth, frame.camera, full, self.first.most_hand)
            found = view_hand(frame, wide, self.beliefs, self.first.hand)
        else:
            again = partial(self._view_again, frame, measured, self._hand_surface(frame))
            found = where_seen_better(frame, again(self.correction), again, self.first.hand.search)
        if found is not None and len(found.points) >= self.first.hand.fewest:
            self.told = HandTold(found.correct(), found.centre, found.information, found.pull)
        return found

    def _as_last_seen(self, frame: Frame) -> HandView | None:
        """The hand with the last correction, and none of its pixels; None where that was never found."""
        measured = camera_from_hand(frame)
        if frame.hand is None or frame.joints is None or measured is None or self.correction is None:
            return None
        aligned, none = self.correction @ measured, np.zeros((0, 3))
        surface = self._hand_surface(frame)
        return HandView(measured, aligned, measured[:3, 3], np.zeros(6), none, np.zeros(0), none, surface)

    def _hand_surface(self, frame: Frame) -> PosedHand:
        assert frame.hand is not None
        assert frame.joints is not None
        joints = tuple(sorted(frame.joints.items()))
        if self._surface is None or joints != self._joints:
            self._surface, self._joints = PosedHand(frame.hand, frame.joints), joints
        return self._surface

    def _view_again(self, frame: Frame, measured: Array, surface: PosedHand, correction: Array) -> HandView:
        """Gauss-Newton on the hand's pixels as in `view_hand`, from the last correction (4, 4) camera_from_camera."""
        aligned = correction @ measured
        pixels = self._hand_pixels(frame, surface, aligned)
        keep = surface.is_within(se3.apply(se3.inverse(aligned), pixels.points), self.settings.gates[0])
        step = max(1, int(keep.sum()) // self.settings.most_aligned)
        points = pixels.points[keep][::step]
        centre = points.mean(axis=0) if len(points) else aligned[:3, 3]
        xi = se3.difference(correction, np.eye(4), centre)
        if len(points) < self.first.hand.fewest:
            return HandView(measured, aligned, centre, xi, points[:0], np.zeros(0), points[:0], surface)
        pixel, gates = pixels.area * step, self.settings.gates
        return fit_hand(surface, measured, xi, centre, points, pixel, self.beliefs, gates)

    def _hand_pixels(self, frame: Frame, surface: PosedHand, aligned: Array) -> Pixels:
        """Pixels of the box around the hand's mesh at `aligned` (4, 4) camera_from_hand."""
        assert frame.camera is not None
        assert frame.depth is not None
        corners = se3.apply(aligned, surface.vertices)
        corners = corners[corners[:, 2] > 1e-3]
        if not len(corners):
            return no_pixels()
        uv, _ = frame.camera.project(corners)
        low = np.clip(np.floor(uv.min(axis=0)), 0, [frame.camera.width, frame.camera.height]).astype(int)
        high = np.clip(np.ceil(uv.max(axis=0)) + 1, 0, [frame.camera.width, frame.camera.height]).astype(int)
        if (high <= low).any():
            return no_pixels()
        box = (int(low[0]), int(low[1]), int(high[0]), int(high[1]))
        pixels = read_pixels(frame.depth, frame.camera, box, 2 * self.settings.most_hand)
        centre, reach = corners.mean(axis=0), np.linalg.norm(corners - corners.mean(axis=0), axis=1).max()
        near = np.linalg.norm(pixels.points - centre, axis=1) < reach + self.settings.gates[0]
        return pixels.take(near).thinned(self.settings.most_hand)
