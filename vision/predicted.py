"""What a camera would have to see if the object were at a pose, held against what it saw.

A row of evidence says what a pixel would like; only the predicted image says what must be seen. Rays through pixels of
the object's own outline are cast against its mesh, and each predicted pixel is seen at that depth, hidden by something
in front, seen past (the camera looks through where the object should be), or explained by the robot's own hand. What
lies outside the outline owes nothing, but a surface that runs on smoothly across it speaks against it: that is another
thing, of which a part is covered. Camera frame, metres.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenes.geometry.cameras import Camera
from scenes.geometry.objects import ObjectModel
from scenes.recordings.beliefs import DepthModel
from scenes.recordings.frames import Frame
from vision import predicted_kernels as kernels
from vision.aspects import sums_of
from vision.look.hand import HandView
from vision.look.pixels import Pixels
from vision.predicted_hand import hand_depth, widened
from vision.shown_kernels import shown_rays

Array = NDArray[np.float64]

# So many poses, or fewer, are asked for again: those that are solved together, before and after.
_FEW = 8
# Stands for an image that is not there.
_NO_IMAGE = np.zeros((0, 0))
_NO_PIECES = np.zeros((0, 0), dtype=np.int64)


@dataclass(frozen=True)
class PredictionSettings:
    """How a predicted image is scored. By judgement, on generated captures and on nine recorded frames, which are
    therefore no independent test of it.
    """

    # Rays along each side of the box around the outline: some six in ten of their square meet the object.
    side: int = 16
    # The same where pixels are wanted as rows of evidence: first, and where that shows fewer than so many pixels.
    sides_rows: tuple[int, int] = (40, 64)
    enough_rows: int = 450
    # Things of which less than this share of what is seen is off the edge are thin: then edges count, too.
    thin_share: float = 0.4
    # Depths (m) beyond where a ray that is seen past meets the object, at which it must be empty; the distance kept
    # from what is seen, sigma (m) and gate (sigmas) of these rows.
    empty_depths: tuple[float, ...] = (0.002, 0.006, 0.014)
    empty_clearance: float = 0.006
    empty_sigma: float = 0.003
    empty_gate: float = 3.0
    # Points of the surface whose projections bound the outline.
    bounding: int = 200
    # Independent cells that a whole outline amounts to: neighbours share what is in front of them. With 100 the
    # few that are seen at 90 % hidden outvoted touch (tuning family `d435`); with 50 nothing else changed there.
    cells: float = 50.0
    # Pixels (px^2) that a cell has at least: a camera smears its noise over as many. And the least share of all cells
    # that a small outline amounts to: a bottle seen from its end, an object far away.
    cell: float = 25.0
    least_cells: float = 0.2
    # Nats that one cell earns when it is seen where it must be, costs when the camera sees past it, and costs when
    # something unknown is in front: of a right pose few cells are seen past, and what hides it is somewhere by chance.
    seen: float = 2.0
    past: float = 4.0
    hidden: float = 0.6
    # Where what hides the object is unknown, something in front is no wonder; and the most nats that one connected
    # piece of the image earns: six parameters laid over a surface fit it wherever it is.
    hidden_by_unknown: float = 0.2
    most_of_piece: float = 30.0
    piece_step: int = 3
    # Nats that it loses of these for each cell of it beyond the outline, where it is of one colour, too; and the share
    # of it that may be beside the outline for how edges are smeared and colours lie beside depth.
    beyond: float = 1.0
    beside: float = 0.15
    # A pixel that is seen past counts this share beside the edge of something that is as near as the object.
    past_beside: float = 0.25
    # Of what gives no reading this share is left out of the count.
    unread: float = 0.7
    # A cell's depth agrees within so many sigmas (noise, smooth bias and scale); seen fades with so many (no scale).
    tolerance: float = 2.5
    fading: float = 1.5
    # Nats of a whole outline over which a surface runs on, and how far (m, and share of depth) the next pixel may be
    # from where the seen surface leads.
    runs_on: float = 60.0
    # Where what hides the object is unknown: nats of as many borders as a whole outline has, across which the surface
    # that agrees runs on to be what hides the object: it goes through another thing. And the most that they cost, since
    # a finger may lie against the object smoothly. Of right poses nine in ten have up to 0.07, half of the wrong ones
    # 0.17 and more (`stranger`, `borrowed`); 60 to 240 nats, and a most of 10 or none, are alike.
    runs_on_within: float = 120.0
    most_within: float = 15.0
    smooth: float = 0.003
    smooth_share: float = 0.004
    # A mask is right to so many pixels: what is seen outside of it is not the object.
    mask_margin: int = 6
    # The hand is drawn at every so many pixels; a reading this near (m) to it is the hand's.
    hand_step: int = 3
    hand_margin: float = 0.006
    # A reading this near (m, and sigmas of its noise on top, as far as it scatters) to the table or wall, or behind it,
    # is the table's or wall's.
    plane_margin: float = 0.004
    plane_sigmas: float = 2.0


@dataclass(frozen=True)
class Prediction:
    """Shares (n,) of the predicted pixels, for n poses; those outside the image are hidden.

    seen: at the depth predicted, falling off smoothly with the difference; beyond: of these, on what goes on beyond the
    outline in one colour, as far as it does; agree: within the tolerance; past: seen through, or under a table; hidden:
    behind something that is not the robot's hand; behind_hand: the hand explains it; outline: of the border, where the
    seen surface runs on smoothly beyond it; within: borders, beside as many as the outline has, across which it runs on
    within the outline to be what hides the object. count: rays that met the object inside the image. area: of the
    outline (px^2) that they tell of, what the image's border cuts off included. shares (n, SUMS): in the columns of
    predicted_kernels.
    """

    shares: Array
    beyond: Array
    area: Array

    @property
    def seen(self) -> Array:
        """(n,)."""
        return self.shares[:, kernels.SEEN]

    @property
    def agree(self) -> Array:
        """(n,)."""
        return self.shares[:, kernels.AGREE]

    @property
    def past(self) -> Array:
        """(n,)."""
        return self.shares[:, kernels.PAST]

    @property
    def hidden(self) -> Array:
        """(n,)."""
        return self.shares[:, kernels.BEHIND]

    @property
    def behind_hand(self) -> Array:
        """(n,)."""
        return self.shares[:, kernels.BEHIND_HAND]

    @property
    def outline(self) -> Array:
        """(n,)."""
        return self.shares[:, kernels.OUTLINE]

    @property
    def within(self) -> Array:
        """(n,)."""
        return self.shares[:, kernels.WITHIN]

    @property
    def count(self) -> Array:
        """(n,)."""
        return self.shares[:, kernels.HITS]


@dataclass(frozen=True)
class View:
    """The rays of n poses, side^2 each: pixels u, v (n, side) along each side; expected, seen (n, side^2): depth (m) at
    which a ray meets the object, and what is read, 0 for none; state: bits of predicted_kernels; past: how much of a
    ray is seen past; fade: how well one at the predicted depth agrees; inside (n,): share of the object in the image.
    """

    u: NDArray[np.int64]
    v: NDArray[np.int64]
    expected: Array
    seen: Array
    state: NDArray[np.uint8]
    past: Array
    fade: Array
    inside: Array

    @property
    def side(self) -> int:
        """Rays along each side."""
        return self.u.shape[1]

    def has(self, bit: int) -> NDArray[np.bool_]:
        """(n, side^2) whether rays are as a bit says."""
        return np.asarray((self.state & bit) > 0)

    def at(self, place: NDArray[np.intp]) -> NDArray[np.int64]:
        """(k, 2) pixels (u, v) of rays (k,) of the first pose."""
        return np.stack([self.u[0, place % self.side], self.v[0, place // self.side]], axis=1)


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
        whole: NDArray[np.int64] | None = None,
    ) -> None:
        """hand: the robot's own as seen in this frame; what it hides is no wonder. planes (k, 6): of table and walls,
        see vision.look.mask.find_plane.

        pieces (h, w) at every settings.piece_step pixels, from 0, -1 for none: connected surfaces of the image, given
        where nobody has a model of what hides the object, so that what is seen may be that. One piece is
        then one thing, whose word is bounded however many pixels it has, and something in front is no wonder. Those
        with numbers below `parts` are of one colour, too: one that goes on beyond the outline is no part of the object.
        whole (k,): the surface that each of the numbers is of, where colour parted them; its word is bounded.
        """
        self._planes = np.zeros((0, 6)) if planes is None else np.ascontiguousarray(planes)
        self._pieces = pieces
        self.settings = settings or PredictionSettings()
        self._whole: NDArray[np.int64] = np.zeros(0, dtype=np.int64)
        self._sizes: Array = np.zeros(0)
        if pieces is not None:
            # none of them, and each piece: its own surface, or that of which it is a part
            self._whole = np.arange(int(pieces.max(initial=-1)) + 2)
        if pieces is not None and parts and whole is not None:
            self._whole = np.concatenate([np.zeros(1, dtype=np.int64), whole + 1])
            self._sizes = np.asarray(np.bincount(pieces[pieces >= 0])[:parts] * float(self.settings.piece_step**2))
        self._mask = None if frame.mask is None else widened(frame.mask, self.settings.mask_margin)
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
    def told_apart(self) -> bool:
        """Whether somebody says what hides the object: a mask, or the hand's model."""
        return self._pieces is None

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
        return self._cost_of(candidates, self.predict(candidates, side))

    def rough_costs(self, candidates: Array) -> Array:
        """As `costs`, by points that the object shows to cameras nearly there (vision.aspects): without a ray, in a
        fifth of the time, and off by a few nats.
        """
        if not self.sees or not len(candidates):
            return np.zeros(len(candidates))
        return self._cost_of(candidates, self.sketch(candidates))

    def sketch(self, candidates: Array) -> Prediction:
        """As `predict`, by the object's aspects: nothing is kept."""
        s = self.settings
        running = s.smooth, s.smooth_share, self.reach, s.unread
        pieces = _NO_PIECES if self._pieces is None else self._pieces
        parts = pieces, s.piece_step, self._whole, self._sizes, self._bounds
        return Prediction(*sums_of(self.model, candidates, *self.known, self._limits, running, parts))

    def _cost_of(self, candidates: Array, p: Prediction) -> Array:
        assert self.camera is not None
        s, out = self.settings, np.zeros(len(candidates))
        hidden, within = (s.hidden, 0.0) if self.told_apart else (s.hidden_by_unknown, s.runs_on_within)
        usual = self.model.mean_outline * self.camera.fx * self.camera.fy
        nats, cells = (s.seen, s.past, hidden, s.runs_on, within, s.most_within), (s.cells, s.cell, s.least_cells)
        centroid = self.model.centroid
        kernels.cost_of_shares(
            np.ascontiguousarray(candidates), centroid, p.shares, p.beyond, p.area, usual, nats, cells, out
        )
        return out

    def predict(self, candidates: Array, side: int | None = None) -> Prediction:
        """What becomes of the predicted pixels of each pose (n, 4, 4); side: rays along the outline's box."""
        side = self.settings.side if side is None else side
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
        s, sums = self.settings, np.zeros((len(candidates), kernels.SUMS))
        flat = view.seen.ravel(), view.state.ravel(), view.past.ravel(), view.fade.ravel()
        limits = s.smooth, s.smooth_share, self.reach, s.plane_margin, s.plane_sigmas
        kernels.sum_up(view.u, view.v, *self.known, limits, *flat, sums)
        total, area, beyond = np.zeros((3, len(candidates)))
        kernels.share_out(view.u, view.v, view.inside, s.unread, sums, total, area)
        if self._pieces is not None:
            sums[:, kernels.SEEN], beyond = self._bounded(view, self._pieces, total)
        return Prediction(sums, beyond, area)

    def _bounded(self, view: View, pieces: NDArray[np.int64], total: Array) -> tuple[Array, Array]:
        """(n,) share seen, of each piece no more than what bounds its word; and how much of that is of pieces of one
        colour that go on beyond the outline.
        """
        s = self.settings
        seen, lost = np.zeros((2, len(view.u)))
        rays = view.u, view.v, view.fade.ravel(), view.state.ravel(), total
        kernels.bound_pieces(pieces, s.piece_step, self._whole, self._sizes, *rays, self._bounds, seen, lost)
        return seen, lost

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
        u, v = np.zeros((2, count, side), dtype=np.int64)
        rays, index = np.zeros((count * side**2, 6), np.float32), np.zeros(count * side**2, dtype=np.int64)
        inside, across = np.zeros(count), np.zeros(side)
        middle, poses = self.model.surface.middle, np.ascontiguousarray(candidates)
        bounding, out = (self._points, self._outer), (u, v, across, rays, index, inside)
        k = kernels.outline_rays(*bounding, poses, self.known[1], middle, *out)
        met = self.model.surface.cast_local(rays[:k])
        shape = count, side**2
        expected, seen, past, fade = np.zeros((4, count * side**2))
        state = np.zeros(count * side**2, dtype=np.uint8)
        kernels.compare_pixels(
            met,
            index[:k],
            u,
            v,
            *self.known,
            self._limits,
            *(expected, seen, state, past, fade),
        )
        expected, seen, past, fade = (values.reshape(shape) for values in (expected, seen, past, fade))
        return View(u, v, expected, seen, state.reshape(shape), past, fade, inside)

    @cached_property
    def _limits(self) -> tuple[float, ...]:
        """Of compare_pixels."""
        s, edge = self.settings, self.belief.edge_pixels
        hand, plane = (s.hand_step, s.hand_margin), (s.plane_margin, s.plane_sigmas)
        return s.tolerance, s.fading, s.past_beside, edge, *hand, *plane

    @property
    def _bounds(self) -> tuple[float, ...]:
        """Limits of bound_pieces."""
        s = self.settings
        return s.most_of_piece / (s.cells * s.seen), s.beside, s.beyond / (s.cells * s.seen), s.cells

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
        area = float(np.ptp(view.u[0]) * np.ptp(view.v[0])) / side**2
        return Pixels(uv, self._rays(uv) * view.seen[0, chosen, None], max(area, 1.0))

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
        smooth = np.hypot(self.belief.independent_sigma(beyond), self.belief.bias_sigma)
        tolerance = s.tolerance * np.hypot(smooth, self.belief.scale_sigma * beyond)
        out = np.zeros(len(places), dtype=bool)
        size, hand = (c.width, c.height), (s.hand_step, s.hand_margin)
        kernels.hides(np.ascontiguousarray(places), beyond, tolerance, self._depth, self._hand[0], size, hand, out)
        return out
