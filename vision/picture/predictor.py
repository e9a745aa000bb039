"""What a camera would have to see if the object were at a pose, held against what it saw.

A row of evidence says what a pixel would like; only the predicted image says what must be seen. Rays through pixels of
the object's own outline are cast against its mesh, and each predicted pixel is seen at that depth, hidden by something
in front, seen past (the camera looks through where the object should be), or explained by the robot's own hand. What
lies outside the outline owes nothing, but a surface that runs on smoothly across it speaks against it: that is another
thing, of which a part is covered. Camera frame, metres.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenes.evidence.table import Evidence, empty
from scenes.geometry.cameras import Camera
from scenes.geometry.objects import ObjectModel
from scenes.recordings.beliefs import DepthModel
from scenes.recordings.frames import Frame
from vision.look.hand.hand import HandView
from vision.look.pixels import Pixels
from vision.picture import columns, kernels, scoring_kernels
from vision.picture.aspects import aspects_of, finer, glimpsed, sums_of
from vision.picture.floor import beneath
from vision.picture.glimpse_kernels import draw_small
from vision.picture.hand import hand_depth, widened
from vision.picture.masked import core_of, covering_rows, uncovered
from vision.picture.prediction import Prediction, View
from vision.picture.settings import PictureScore, PredictionSettings
from vision.picture.shown_kernels import shown_rays

Array = NDArray[np.float64]

# So many poses, or fewer, are asked for again: those that are solved together, before and after; twelve or so at most.
_FEW = 16
# Stands for an image that is not there.
_NO_IMAGE = np.zeros((0, 0))
_NO_PIECES = np.zeros((0, 0), dtype=np.int64)


class Predictor:
    """Scores poses against one frame's depth image; without one every pose costs nothing."""

    def __init__(
        self,
        frame: Frame,
        model: ObjectModel,
        depth: DepthModel,
        hand: HandView | None = None,
        settings: PredictionSettings | None = None,
        planes: Array | None = None,
        pieces: NDArray[np.int64] | None = None,
        parts: int = 0,
        floors: Array | None = None,
    ) -> None:
        """hand: the robot's own as seen in this frame; what it hides is no wonder. planes (k, 6): of table and walls,
        see vision.look.mask.planes.find_plane; floors (m, 6): those behind which nothing is, whatever is read there.

        pieces (h, w) at every settings.piece_step pixels, from 0, -1 for none: connected surfaces of the image, given
        where neither a mask nor a model of the hand tells what hides the object, so that what is seen may be that.
        Those with numbers below `parts` are of one colour, too: one that goes on beyond the outline is no part of the
        object.
        """
        self._planes = np.zeros((0, 6)) if planes is None else np.ascontiguousarray(planes)
        self._floors = np.zeros((0, 6)) if floors is None else floors
        self._pieces = pieces
        self.settings = settings or PredictionSettings()
        self._sizes: Array = np.zeros(0)
        if pieces is not None and parts:
            self._sizes = np.asarray(np.bincount(pieces[pieces >= 0])[:parts] * float(self.settings.piece_step**2))
        self._mask = None if frame.mask is None else widened(frame.mask, self.settings.mask_margin)
        self._masked = frame.mask
        self.model = model
        self.camera: Camera | None = frame.camera
        seeing = frame.depth is not None and frame.camera is not None
        self._depth = np.ascontiguousarray(frame.depth, np.float32) if seeing else None
        self.belief = depth
        self._points, self._outer = model.bounding_points(self.settings.bounding)
        # of one pose at a time, and of few: what was asked of them is asked again
        self._views: dict[tuple[bytes, int], View] = {}
        self._predicted: dict[int, dict[bytes, tuple[Array, float, float]]] = {}
        self._hand = _NO_IMAGE, _NO_IMAGE
        if frame.camera is not None and self._depth is not None and hand is not None:
            self._hand = hand_depth(frame.camera, hand, self.settings.hand_step)

    @property
    def sees(self) -> bool:
        """Whether there is an image to compare with."""
        return self._depth is not None

    @property
    def image(self) -> tuple[NDArray[np.float32], Camera] | None:
        """The depth image (m) and its camera; None without one."""
        return None if self._depth is None or self.camera is None else (self._depth, self.camera)

    @cached_property
    def side(self) -> int:
        """Rays along each side of an outline's box where nobody asks for others: more of a thing that fills little of
        it.
        """
        return finer(self.settings.side, aspects_of(self.model).filling)

    @property
    def told_apart(self) -> bool:
        """Whether somebody says what hides the object: a mask, or the hand's model."""
        return self._pieces is None

    @property
    def knows_hand(self) -> bool:
        """Whether what hides the object is the robot's own hand, which is drawn."""
        return self.told_apart and self._hand[0].size > 0

    @property
    def score(self) -> PictureScore:
        """What a picture is worth: less surely the object's where nobody knows the hand, or what else is at it."""
        return self.settings.known_hand if self.knows_hand else self.settings.unknown_hand

    @property
    def reach(self) -> int:
        """Pixels beyond an outline that a smeared edge, or what a mask has too much, may still reach."""
        return max(self.belief.edge_pixels, 0 if self._mask is None else self.settings.mask_margin + 1)

    def costs(self, candidates: Array, side: int | None = None) -> Array:
        """(n,) nats for poses (n, 4, 4) camera_from_object, up to a constant: lower is likelier. side: rays along the
        outline's box.
        """
        if not self.sees or not len(candidates):
            return np.zeros(len(candidates))
        return self._cost_of(candidates, self.predict(candidates, side)) + self._uncovered_costs(candidates)

    def rough_costs(self, candidates: Array) -> Array:
        """As `costs`, by points that the object shows to cameras nearly there (see `aspects`): without a ray, in a
        fifth of the time, and off by a few nats.
        """
        if not self.sees or not len(candidates):
            return np.zeros(len(candidates))
        return self._cost_of(candidates, self.sketch(candidates))

    def glimpse(self, candidates: Array) -> Array:
        """(n,) nats of poses (n, 4, 4) by what is seen of a few of their points and seen past alone, to tell what is
        hopeless among thousands: lower is likelier.
        """
        if not self.sees or not len(candidates):
            return np.zeros(len(candidates))
        s = self.settings
        _, camera, noise = self.known
        shares = glimpsed(
            self.model, candidates, self._small, s.glimpse_step, camera, noise, s.tolerance, s.glimpse_points
        )
        nats = s.glimpse_past * shares[:, 1] - s.glimpse_seen * np.minimum(shares[:, 0], s.glimpse_most)
        return self._as_told(candidates, nats)

    @cached_property
    def _small(self) -> NDArray[np.float32]:
        """What may be the object at every few pixels; see `draw_small`."""
        images, camera, noise = self.known
        step, (height, width) = self.settings.glimpse_step, images[0].shape
        small = np.zeros((-(-height // step), -(-width // step)), np.float32)
        draw_small(images, camera, noise, self._limits, step, small)
        return small

    def sketch(self, candidates: Array) -> Prediction:
        """As `predict`, by the object's aspects: nothing is kept."""
        s = self.settings
        running = s.smooth, s.smooth_share, self.reach, s.unread
        pieces = _NO_PIECES if self._pieces is None else self._pieces
        parts = pieces, s.piece_step, self._sizes, s.beside
        return Prediction(*sums_of(self.model, candidates, *self.known, self._limits, running, parts))

    def _uncovered_costs(self, candidates: Array) -> Array:
        """Nats (n,) of poses (n, 4, 4) for what of the mask is outside their outlines; none without a mask."""
        pixels, told = self._core
        if not len(pixels) or self.camera is None:
            return np.zeros(len(candidates))
        return self.settings.uncovered * told * uncovered(self.model, self.camera, pixels, candidates)

    def covering(self, candidates: Array) -> list[Evidence]:
        """Rows that draw each of poses (n, 4, 4) over what of the mask it leaves bare; none without a mask."""
        pixels, told = self._core
        if not len(pixels) or self.camera is None:
            return [empty()] * len(candidates)
        return covering_rows(self.model, self.camera, pixels, candidates, self.settings.cover, told)

    @cached_property
    def _core(self) -> tuple[NDArray[np.int64], float]:
        """Pixels (k, 2) that the mask surely says are the object's, and what they amount to, as an outline's cells."""
        s = self.settings
        if self._masked is None:
            return np.zeros((0, 2), dtype=np.int64), 0.0
        cells = float(np.count_nonzero(self._masked)) / s.cell
        return core_of(self._masked, s.mask_margin, s.masked), min(1.0, cells / s.cells) ** self.score.by_size

    def _cost_of(self, candidates: Array, p: Prediction) -> Array:
        assert self.camera is not None
        s, score, out = self.settings, self.score, np.zeros(len(candidates))
        usual = self.model.mean_outline * self.camera.fx * self.camera.fy
        nats, cells = score.nats, (s.cells, s.cell, s.least_cells)
        centroid = self.model.centroid
        shares, poses = self._with_floors(candidates, p.shares), np.ascontiguousarray(candidates)
        scoring_kernels.cost_of_shares(poses, centroid, shares, p.beyond, p.area, usual, nats, cells, out)
        return self._as_told(candidates, out)

    def _with_floors(self, candidates: Array, shares: Array) -> Array:
        """Shares (n, SUMS) of poses (n, 4, 4), at least as much seen past as is under a floor."""
        if not len(self._floors):
            return shares
        s, shares = self.settings, shares.copy()
        under = beneath(self._points, self._floors, candidates, self.belief, s.plane_margin, s.plane_sigmas)
        shares[:, columns.PAST] = np.maximum(shares[:, columns.PAST], under)
        return shares

    def _as_told(self, candidates: Array, nats: Array) -> Array:
        """Nats (n,) of poses (n, 4, 4) as far as depth resolves the object at their distance, and what is believed of
        that distance; as they are where it is no farther than `resolved_to`.
        """
        s = self.settings
        z = candidates[:, 2, :3] @ self.model.centroid + candidates[:, 2, 3]
        if not (z > s.resolved_to).any():
            return nats
        beyond = np.maximum(z, s.resolved_to)
        told = np.log1p(self.model.radius / self._tolerance(beyond)) / self._told_near
        return np.asarray(told * nats + s.places * np.log(beyond / s.resolved_to))

    @cached_property
    def _told_near(self) -> float:
        near = self._tolerance(np.array(self.settings.resolved_to))
        return float(np.log1p(self.model.radius / near))

    def _tolerance(self, z: Array) -> Array:
        """How far off (m) a reading at depth z (n,) m may be and agree, as in `compare_pixels`."""
        m = self.belief
        squares = np.square(m.independent_sigma(z)) + m.bias_sigma**2 + np.square(m.scale_sigma * z)
        return self.settings.tolerance * np.sqrt(squares)

    def predict(self, candidates: Array, side: int | None = None) -> Prediction:
        """What becomes of the predicted pixels of each pose (n, 4, 4); side: rays along the outline's box."""
        side = self.side if side is None else side
        if len(candidates) > _FEW:
            return self._summed(candidates, side)
        known = self._predicted.setdefault(side, {})
        keys = [candidate.tobytes() for candidate in candidates]
        if fresh := [n for n, key in enumerate(keys) if key not in known]:
            told = self._summed(candidates if len(fresh) == len(keys) else candidates[fresh], side)
            for k, n in enumerate(fresh):
                known[keys[n]] = told.shares[k], told.beyond[k], told.area[k]
            if len(fresh) == len(keys):
                return told
        shares, beyond, area = zip(*(known[key] for key in keys))
        return Prediction(np.array(shares), np.array(beyond), np.array(area))

    def _summed(self, candidates: Array, side: int) -> Prediction:
        view = self.view(candidates, side)
        s, sums = self.settings, np.zeros((len(candidates), columns.SUMS))
        flat = view.expected.ravel(), view.seen.ravel(), view.state.ravel(), view.past.ravel(), view.fade.ravel()
        limits = s.smooth, s.smooth_share, self.reach, s.plane_margin, s.plane_sigmas
        kernels.sum_up(view.u, view.v, view.step, *self.known, limits, *flat, sums)
        total, area, beyond = np.zeros((3, len(candidates)))
        scoring_kernels.share_out(view.step, view.inside, s.unread, sums, total, area)
        if self._pieces is not None and len(self._sizes):
            rays = view.u, view.v, view.step, view.fade.ravel(), view.state.ravel(), total
            scoring_kernels.part_pieces(self._pieces, s.piece_step, self._sizes, *rays, s.beside, beyond)
        return Prediction(sums, beyond, area)

    def view(self, candidates: Array, side: int) -> View:
        """The predicted pixels of poses (n, 4, 4), side^2 rays each, and what each of them is."""
        if len(candidates) > 1:
            return self._cast(candidates, side)
        key = candidates.tobytes(), side
        if key not in self._views:
            self._views[key] = self._cast(candidates, side)
        return self._views[key]

    def _cast(self, candidates: Array, side: int) -> View:
        assert self.camera is not None
        assert self._depth is not None
        count = len(candidates)
        u, v = np.zeros((2, count, side**2), dtype=np.int64)
        rays, index = np.zeros((count * side**2, 6), np.float32), np.zeros(count * side**2, dtype=np.int64)
        inside, step, places = np.zeros(count), np.zeros((count, 4)), np.zeros((len(self._points), 2))
        middle, poses = self.model.surface.middle, np.ascontiguousarray(candidates)
        bounding, out = (self._points, self._outer), (u, v, step, places, rays, index, inside)
        k = kernels.outline_rays(*bounding, poses, self.known[1], middle, self.settings.slender, *out)
        met = self.model.surface.cast_local(rays[:k])
        shape = count, side**2
        expected, seen, past, fade = np.zeros((4, count * side**2))
        state = np.zeros(count * side**2, dtype=np.uint8)
        told = expected, seen, state, past, fade
        kernels.compare_pixels(met, index[:k], u.ravel(), v.ravel(), *self.known, self._limits, *told)
        expected, seen, past, fade = (values.reshape(shape) for values in (expected, seen, past, fade))
        return View(u, v, step, expected, seen, state.reshape(shape), past, fade, inside)

    @cached_property
    def _limits(self) -> tuple[float, ...]:
        """Of compare_pixels."""
        s, edge = self.settings, self.belief.edge_pixels
        hand, plane = (s.hand_step, s.hand_margin), (s.plane_margin, s.plane_sigmas)
        return s.tolerance, s.fading, s.past_beside, edge, *hand, *plane

    @cached_property
    def known(self) -> tuple[tuple[NDArray[Any], ...], tuple[float, ...], tuple[float, ...]]:
        """What the kernels are told of the frame: images and planes, the camera, and the noise of its depth."""
        assert self.camera is not None
        assert self._depth is not None
        c, m = self.camera, self.belief
        mask = np.zeros((0, 0), dtype=bool) if self._mask is None else self._mask
        return (
            (self._depth, mask, *self._hand, self._planes),
            (float(c.fx), float(c.fy), float(c.cx), float(c.cy), c.width, c.height),
            (m.axial_floor, m.axial_growth, m.axial_from, m.bias_sigma, m.scale_sigma),
        )

    def shown(self, pose: Array, side: int, inner: int = 1) -> Pixels:
        """The pixels that show the object at pose (4, 4): inside its outline by `inner` rays, where edges smear no
        depth, at the predicted depth, and not the hand's. side: rays along each side of the outline's box.
        """
        view = self.view(pose[None], side)
        chosen = np.zeros(side * side, dtype=np.int64)
        chosen = chosen[: shown_rays(view.state[0], side, inner, self.settings.thin_share, chosen)]
        uv = view.at(chosen)
        area = scoring_kernels.cell_of(view.step[0])
        return Pixels(uv, self._rays(uv) * view.seen[0, chosen, None], max(float(area), 1.0))

    def _rays(self, uv: NDArray[np.int64]) -> Array:
        """(n, 3) rays of depth 1 through pixels (n, 2)."""
        assert self.camera is not None
        c, out = self.camera, np.ones((len(uv), 3))
        out[:, 0], out[:, 1] = (uv[:, 0] - c.cx) / c.fx, (uv[:, 1] - c.cy) / c.fy
        return out

    def hides(self, places: Array, beyond: Array) -> NDArray[np.bool_]:
        """(n,) whether something is in front of depths `beyond` (n,) m at places (n, 2) of the image (px): a reading
        nearer than any error of it explains, or the robot's hand. Places outside the image are hidden.
        """
        assert self.camera is not None
        assert self._depth is not None
        s, c = self.settings, self.camera
        tolerance, out = self._tolerance(beyond), np.zeros(len(places), dtype=bool)
        size, hand = (c.width, c.height), (s.hand_step, s.hand_margin)
        kernels.hides(np.ascontiguousarray(places), beyond, tolerance, self._depth, self._hand[0], size, hand, out)
        return out
