"""What a camera would have to see if the object were at a pose, held against what it saw.

A row of evidence says what a pixel would like; only the predicted image says what must be seen. Rays through pixels of
the object's own outline are cast against its mesh, and each predicted pixel is seen at that depth, hidden by something
in front, seen past (the camera looks through where the object should be), or explained by the robot's own hand. What
lies outside the outline owes nothing, but a surface that runs on smoothly across it speaks against it: that is another
thing, of which a part is covered. Camera frame, metres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenes.evidence import table as tables
from scenes.evidence.table import VISION, Evidence
from scenes.geometry import poses as se3
from scenes.geometry.cameras import Camera, is_reading
from scenes.geometry.objects import ObjectModel
from scenes.recordings.beliefs import DepthModel
from scenes.recordings.frames import Frame
from vision.look.hand import HandView
from vision.look.pixels import Pixels

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PredictionSettings:
    """How a predicted image is scored. By judgement, on generated captures and on nine recorded frames, which are
    therefore no independent test of it.
    """

    # Rays along each side of the box around the outline: some six in ten of their square meet the object.
    side: int = 16
    # The same where pixels are wanted as rows of evidence.
    side_rows: int = 64
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
    # Nats that one cell earns when it is seen where it must be, costs when the camera sees past it, and costs when
    # something unknown is in front: of a right pose few cells are seen past, and what hides it is somewhere by chance.
    seen: float = 2.0
    past: float = 4.0
    hidden: float = 0.6
    # Where an unknown thing touches the object, something in front is no wonder; and the most nats that one connected
    # piece of the image earns: six parameters laid over a surface fit it wherever it is.
    hidden_by_unknown: float = 0.2
    most_of_piece: float = 30.0
    piece_step: int = 3
    # A pixel that is seen past counts this share where something within so many pixels is as near as the object.
    past_beside: float = 0.25
    edge_pixels: int = 4
    # Of what gives no reading this share is left out of the count.
    unread: float = 0.7
    # A cell's depth agrees within so many sigmas (noise, smooth bias and scale); seen fades with so many (no scale).
    tolerance: float = 2.5
    fading: float = 1.5
    # Nats of a whole outline over which a surface runs on, and how far (m, and share of depth) the next pixel may be
    # from where the seen surface leads.
    runs_on: float = 60.0
    smooth: float = 0.003
    smooth_share: float = 0.004
    # A mask is right to so many pixels: what is seen outside of it is not the object.
    mask_margin: int = 6
    # The hand is drawn at every so many pixels; a reading this near (m) to it is the hand's.
    hand_step: int = 3
    hand_margin: float = 0.006
    # A reading this near (m, and sigmas of its noise on top) to the table or wall is the table's or wall's.
    plane_margin: float = 0.004
    plane_sigmas: float = 2.0


@dataclass(frozen=True)
class Prediction:
    """Shares (n,) of the predicted pixels inside the image, for n poses.

    seen: at the depth predicted, falling off smoothly with the difference; agree: within the tolerance; past: seen
    through, or under a table; hidden: behind something that is not the robot's hand; behind_hand: the hand explains
    it; outline: of the border, where the seen surface runs on smoothly beyond it. count: rays that met the object
    inside the image.
    """

    seen: Array
    agree: Array
    past: Array
    hidden: Array
    behind_hand: Array
    outline: Array
    count: NDArray[np.int64]


@dataclass(frozen=True)
class _View:
    """Pixels u, v of the rays (n, k); whether each meets the object and at which depth (m), is read, and what is seen;
    which are at the predicted depth, seen past, hidden by something unknown or by the hand; fade: how well a near one
    agrees.
    """

    u: NDArray[np.int64]
    v: NDArray[np.int64]
    hit: NDArray[np.bool_]
    expected: Array
    read: NDArray[np.bool_]
    seen: Array
    near: NDArray[np.bool_]
    past: Array
    hidden: NDArray[np.bool_]
    by_hand: NDArray[np.bool_]
    fade: Array


class Predictor:
    """Scores poses against one frame's depth image; without one every pose costs nothing."""

    def __init__(
        self,
        frame: Frame,
        model: ObjectModel,
        depth: DepthModel,
        hand: HandView | None = None,
        settings: PredictionSettings | None = None,
        plane: Array | None = None,
        pieces: NDArray[np.int64] | None = None,
    ) -> None:
        """hand: the robot's own as seen in this frame; what it hides is no wonder. plane (4,): of the table or wall.

        pieces (h, w) at every settings.piece_step pixels, from 0, -1 for none: connected surfaces of the image, given
        where something touches the object that nobody has a model of, so that what is seen may be that. One piece is
        then one thing, whose word is bounded however many pixels it has, and something in front is no wonder.
        """
        self._plane, self._pieces = plane, pieces
        self.settings = settings or PredictionSettings()
        self._mask = None if frame.mask is None else _widened(frame.mask, self.settings.mask_margin)
        self.model = model
        self.camera: Camera | None = frame.camera
        self._depth = None if frame.camera is None else frame.depth
        self._belief = depth
        self._nearest = None if self._depth is None else _nearest_around(self._depth, self.settings.edge_pixels)
        self._points = model.sample_surface(self.settings.bounding)[0]
        self._hand = None if self._depth is None or hand is None else _hand_depth(self.camera, hand, self.settings)

    @property
    def sees(self) -> bool:
        """Whether there is an image to compare with."""
        return self._depth is not None

    def costs(self, candidates: Array) -> Array:
        """(n,) nats for poses (n, 4, 4) camera_from_object, up to a constant: lower is likelier."""
        s = self.settings
        if not self.sees or not len(candidates):
            return np.zeros(len(candidates))
        p = self.predict(candidates)
        hidden = s.hidden if self._pieces is None else s.hidden_by_unknown
        cost = s.cells * (s.past * p.past + hidden * p.hidden) - s.cells * s.seen * p.seen + s.runs_on * p.outline
        # an object that is nowhere in the image is hidden by the image's border
        return np.where(p.count > 0, cost, s.cells * s.hidden)

    def predict(self, candidates: Array, side: int | None = None) -> Prediction:
        """What becomes of the predicted pixels of each pose (n, 4, 4); side: rays along the outline's box."""
        side = self.settings.side if side is None else side
        view = self._view(candidates, side)
        # where nothing is read little is known: surfaces that give no reading are the object's or not
        unread = (view.hit & ~view.read).sum(axis=1)
        total = np.maximum(view.hit.sum(axis=1) - self.settings.unread * unread, 1.0)

        def share(which: NDArray) -> Array:
            return np.asarray(which.sum(axis=1) / total)

        seen = share(view.fade)
        if self._pieces is not None:
            seen = self._bounded(view, self._pieces, total)
        return Prediction(
            seen=seen,
            agree=share(view.near),
            past=share(view.past),
            hidden=share(view.hidden),
            behind_hand=share(view.by_hand),
            outline=self._runs_on(view, side),
            count=view.hit.sum(axis=1).astype(np.int64),
        )

    def _bounded(self, view: _View, pieces: NDArray[np.int64], total: Array) -> Array:
        """(n,) share seen, of each piece no more than what bounds its word."""
        s = self.settings
        count = int(pieces.max(initial=-1)) + 2
        row = np.clip(view.v // s.piece_step, 0, pieces.shape[0] - 1)
        column = np.clip(view.u // s.piece_step, 0, pieces.shape[1] - 1)
        label = pieces[row, column] + 1 + count * np.arange(len(view.u))[:, None]
        each = np.bincount(label.ravel(), view.fade.ravel(), minlength=count * len(view.u)).reshape(-1, count)
        bound = s.most_of_piece / (s.cells * s.seen)
        return np.asarray(np.minimum(each / total[:, None], bound).sum(axis=1))

    def _view(self, candidates: Array, side: int) -> _View:
        """The predicted pixels of poses (n, 4, 4), side^2 rays each, and what each of them is."""
        assert self.camera is not None
        assert self._depth is not None
        s, camera = self.settings, self.camera
        u, v, inside = self._grid(candidates, side)
        rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], axis=-1)
        inverse = np.array([se3.inverse(pose) for pose in candidates])
        local = np.einsum("nij,nkj->nki", inverse[:, :3, :3], rays)
        origins = np.broadcast_to(inverse[:, None, :3, 3], local.shape)
        expected = np.full(u.shape, np.inf)
        expected[inside] = self.model.surface.cast(origins[inside], local[inside])
        hit = np.isfinite(expected)
        z = np.where(hit, expected, 1.0)
        seen = np.where(inside, self._depth[np.where(inside, v, 0), np.where(inside, u, 0)].astype(np.float64), 0.0)
        read = is_reading(seen) & inside
        seen = np.where(read, seen, 0.0)
        smooth = np.hypot(self._belief.independent_sigma(z), self._belief.bias_sigma)
        tolerance = s.tolerance * np.hypot(smooth, self._belief.scale_sigma * z)
        known = read & hit
        off = np.where(known, seen - z, 0.0)
        by_hand = known & self._is_hand(u, v, seen, inside)
        plane = known & self._is_plane(rays, seen)
        # nothing is under the table or behind the wall; what is at its depth is the table, and hides the object at most
        past = known & ((off > tolerance) | (plane & (off < -tolerance)))
        # beside the edge of something near a camera often reads what is behind it: stereo's windows, mixed light
        assert self._nearest is not None
        beside = np.where(known, self._nearest[np.where(inside, v, 0), np.where(inside, u, 0)], np.inf) < z + tolerance
        past_share = np.where(past & beside & (off > 0), s.past_beside, 1.0) * past
        other = plane if self._mask is None else plane | ~self._mask[np.where(inside, v, 0), np.where(inside, u, 0)]
        near = known & ~by_hand & ~other & (np.abs(off) <= tolerance)
        hidden = known & ~by_hand & ~past & ~near
        fade = np.exp(-0.5 * np.square(off / (s.fading * smooth))) * near
        return _View(u, v, hit, expected, read, seen, near, past_share, hidden, by_hand & ~past, fade)

    def seen_pixels(self, pose: Array, side: int | None = None, inner: int = 1) -> Pixels:
        """The pixels that show the object at pose (4, 4): inside its outline by `inner` rays, where edges smear no
        depth, at the predicted depth, and not the hand's.
        """
        assert self.camera is not None
        s, camera = self.settings, self.camera
        side = s.side_rows if side is None else side
        view = self._view(pose[None], side)
        core = view.hit.reshape(side, side)
        for _ in range(inner):
            padded = np.pad(core, 1)
            core = core & padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2] & padded[1:-1, 2:]
        good = core.ravel() & view.near[0]
        if good.sum() < s.thin_share * view.near[0].sum():  # a thin thing is all edge
            good = view.near[0]
        uv = np.stack([view.u[0, good], view.v[0, good]], axis=1)
        rays = np.stack([(uv[:, 0] - camera.cx) / camera.fx, (uv[:, 1] - camera.cy) / camera.fy, np.ones(len(uv))], 1)
        area = float(np.ptp(view.u[0]) * np.ptp(view.v[0])) / side**2
        return Pixels(uv, rays * view.seen[0, good, None], max(area, 1.0))

    def empty_rows(self, pose: Array) -> Evidence:
        """OUTSIDE rows on the rays that see past the object at pose (4, 4): there it cannot be."""
        assert self.camera is not None
        s, camera = self.settings, self.camera
        view = self._view(pose[None], s.side)
        past = (view.past[0] == 1.0) & (view.seen[0] > view.expected[0])
        if not past.any():
            return tables.empty()
        u, v = view.u[0, past], view.v[0, past]
        rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(len(u))], axis=1)
        depth = view.expected[0, past, None] + np.array(s.empty_depths)
        free = depth < view.seen[0, past, None] - s.empty_clearance
        points = (rays[:, None] * depth[..., None])[free]
        rows = tables.outside(points, s.empty_sigma, VISION, gate=s.empty_gate)
        return rows.reweighted(s.cells / max(float(view.hit.sum()), 1.0) / len(s.empty_depths))

    def hides(self, places: Array, beyond: Array) -> NDArray[np.bool_]:
        """(n,) whether something is in front of depths `beyond` (n,) m at places (n, 2) of the image (px): a reading
        nearer than any error of it explains, or the robot's hand. Places outside the image are hidden.
        """
        assert self.camera is not None
        assert self._depth is not None
        s, c = self.settings, self.camera
        u, v = np.round(places[:, 0]).astype(np.int64), np.round(places[:, 1]).astype(np.int64)
        inside = (u >= 0) & (v >= 0) & (u < c.width) & (v < c.height)
        u, v = np.where(inside, u, 0), np.where(inside, v, 0)
        seen = self._depth[v, u].astype(np.float64)
        read = is_reading(seen)
        seen = np.where(read, seen, np.inf)
        smooth = np.hypot(self._belief.independent_sigma(beyond), self._belief.bias_sigma)
        tolerance = s.tolerance * np.hypot(smooth, self._belief.scale_sigma * beyond)
        hidden = read & (seen < beyond - tolerance)
        if self._hand is not None:
            hidden |= self._hand[0][v // s.hand_step, u // s.hand_step] < beyond + s.hand_margin
        return np.asarray(hidden | ~inside)

    def _grid(self, candidates: Array, side: int) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
        """Pixels u, v (n, side^2) over the box of each pose's outline, and which of them are in the image."""
        assert self.camera is not None
        c = self.camera
        points = np.einsum("nij,kj->nki", candidates[:, :3, :3], self._points) + candidates[:, None, :3, 3]
        z = points[..., 2]
        ahead = (z > 1e-3).all(axis=1)
        safe = np.where(ahead[:, None], z, 1.0)
        uv = np.stack([c.fx * points[..., 0] / safe + c.cx, c.fy * points[..., 1] / safe + c.cy], axis=-1)
        low, high = uv.min(axis=1) - 1.0, uv.max(axis=1) + 1.0
        # far outside the image nothing is asked
        low, high = np.clip(low, -c.width, 2 * c.width), np.clip(high, -c.width, 2 * c.width)
        steps = (np.arange(side) + 0.5) / side
        u = np.round(low[:, None, 0] + steps * (high - low)[:, None, 0]).astype(np.int64)
        v = np.round(low[:, None, 1] + steps * (high - low)[:, None, 1]).astype(np.int64)
        u = np.broadcast_to(u[:, None, :], (len(u), side, side)).reshape(len(u), -1)
        v = np.broadcast_to(v[:, :, None], (len(v), side, side)).reshape(len(v), -1)
        inside = (u >= 0) & (v >= 0) & (u < c.width) & (v < c.height) & ahead[:, None]
        return u, v, inside

    def _is_hand(
        self, u: NDArray[np.int64], v: NDArray[np.int64], seen: Array, inside: NDArray[np.bool_]
    ) -> NDArray[np.bool_]:
        """Whether each reading is the robot's hand, as far as it is known."""
        if self._hand is None:
            return np.zeros(u.shape, dtype=bool)
        step = self.settings.hand_step
        row = np.where(inside, v, 0) // step
        column = np.where(inside, u, 0) // step
        low, high = self._hand[0][row, column], self._hand[1][row, column]
        margin = self.settings.hand_margin
        return (seen > low - margin) & (seen < high + margin)

    def _is_plane(self, rays: Array, seen: Array) -> NDArray[np.bool_]:
        """Whether each reading is the table's or wall's."""
        if self._plane is None:
            return np.zeros(seen.shape, dtype=bool)
        s = self.settings
        room = s.plane_margin + s.plane_sigmas * self._belief.independent_sigma(seen)
        return np.asarray(np.abs(seen * (rays @ self._plane[:3]) + self._plane[3]) < room)

    def _runs_on(self, view: _View, side: int) -> Array:
        """(n,) share of the outline across which the surface that is seen inside goes on as it was."""
        s = self.settings
        shape = (len(view.hit), side, side)
        hit, near, read, seen = (x.reshape(shape) for x in (view.hit, view.near, view.read, view.seen))
        smooth, border = np.zeros(len(hit)), np.zeros(len(hit))
        for axis in (1, 2):
            for step in (1, -1):
                beyond = ~_shifted(hit, -step, axis)
                edge = near & _shifted(near, step, axis) & beyond & _shifted(read, -step, axis)
                lead = 2.0 * seen - _shifted(seen, step, axis)
                goes_on = np.abs(_shifted(seen, -step, axis) - lead) < s.smooth + s.smooth_share * seen
                smooth += (edge & goes_on).sum(axis=(1, 2))
                border += (hit & beyond).sum(axis=(1, 2))
        return np.asarray(smooth / np.maximum(border, 1.0))


def _widened(mask: NDArray[np.bool_], margin: int) -> NDArray[np.bool_]:
    """(h, w) the mask and what is within `margin` pixels of it along either axis."""
    import cv2

    return np.asarray(cv2.dilate(mask.astype(np.uint8), np.ones((2 * margin + 1,) * 2, np.uint8)) > 0)


def _nearest_around(depth: NDArray[np.float32], reach: int) -> NDArray[np.float32]:
    """(h, w) least depth (m) that is read within `reach` pixels along either axis; inf for none."""
    import cv2

    read = np.where(is_reading(depth), depth, np.float32(np.inf)).astype(np.float32)
    return np.asarray(cv2.erode(read, np.ones((2 * reach + 1,) * 2, np.uint8)), dtype=np.float32)


def _shifted(values: NDArray, step: int, axis: int) -> NDArray:
    """Values of the neighbour one further along an axis; zeros beyond the end."""
    out = np.zeros_like(values)
    to, source = [slice(None)] * values.ndim, [slice(None)] * values.ndim
    to[axis], source[axis] = (slice(None, -1), slice(1, None)) if step > 0 else (slice(1, None), slice(None, -1))
    out[tuple(to)] = values[tuple(source)]
    return out


def _hand_depth(camera: Camera | None, hand: HandView, settings: PredictionSettings) -> tuple[Array, Array]:
    """Least and largest depth (m) of the hand at and beside every so many pixels; +inf and -inf where it is not."""
    assert camera is not None
    step = settings.hand_step
    u = np.arange(0, camera.width, step)
    v = np.arange(0, camera.height, step)
    low = np.full((len(v), len(u)), np.inf)
    rays = np.stack(
        np.broadcast_arrays((u - camera.cx) / camera.fx, ((v - camera.cy) / camera.fy)[:, None], 1.0), axis=-1
    )
    inverse = se3.inverse(hand.aligned)
    flat = rays.reshape(-1, 3)
    depth = hand.surface.cast(np.broadcast_to(inverse[:3, 3], flat.shape), flat @ inverse[:3, :3].T)
    low = depth.reshape(len(v), len(u))
    high = np.where(np.isfinite(low), low, -np.inf)
    padded_low, padded_high = np.pad(low, 1, constant_values=np.inf), np.pad(high, 1, constant_values=-np.inf)
    rows, columns = low.shape
    around = [(i, j) for i in range(3) for j in range(3)]
    low = np.min([padded_low[i : i + rows, j : j + columns] for i, j in around], axis=0)
    high = np.max([padded_high[i : i + rows, j : j + columns] for i, j in around], axis=0)
    return low, high
