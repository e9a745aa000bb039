"""The object's own pixels in a full scene: table and wall, the robot's hand and things that stand about taken away.

Everything is decided in the image at full resolution, from depth, the hand's model and, where it tells the hand from
the object, colour; nothing is learned. Camera frame, metres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenes.geometry import poses
from scenes.geometry.cameras import Camera
from scenes.geometry.nearest import Nearest
from scenes.geometry.objects import ObjectModel
from scenes.recordings.beliefs import Beliefs, DepthModel
from scenes.recordings.frames import Frame
from vision.look import mask_kernels as kernels
from vision.look.hand import HandView, HandViewSettings, view_hand
from vision.look.piece_kernels import count_votes, mark_planes, number_pieces, runs_on_behind
from vision.look.pixels import Region, median, read_pixels
from vision.look.regions import find_region

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Points of a piece, about, from which its distances are told.
SAMPLES = 300


@dataclass(frozen=True)
class MaskSettings:
    """What is taken for table, hand and object. Tuned on generated captures."""

    # Room around a start's ball in which the object is looked for, metres: T1's coarse starts are 33 mm off.
    slack: float = 0.035
    # Pixels of the whole image among which the hand is looked for, where nobody has yet.
    most_hand: int = 8000
    # A plane holds this share of the readings, and fills this share of the image: table and wall fill 29 % and more in
    # all families and recordings, a hand and what it holds, alone in the image, 6 %. So many triples of points are
    # tried, on so many points, of which every so manieth has a vote on them.
    plane_share: float = 0.2
    plane_image: float = 0.12
    plane_tries: int = 200
    plane_points: int = 3000
    plane_voters: int = 3
    # Room over the plane (m) that is still the plane's: smooth bias and scale of depth at two sigmas; and sigmas of the
    # independent noise on top.
    plane_margin: float = 0.006
    plane_sigmas: float = 3.0
    # Table, wall and floor; of all readings a further plane holds this share: with half of that a hand and what it
    # holds were one (tuning family `stranger`).
    most_planes: int = 3
    next_plane_share: float = 0.2
    # Readings scatter about a plane less than so many times as far as is believed of the camera: else it is no plane.
    plane_most_scatter: float = 5.0
    # What goes on behind the first plane is cut by it: most of it, a share of its readings, in parts of the image of so
    # many points, up to so many times its room behind it. Those of tuning families have 0.02, of `passive` 0.07.
    plane_most_behind: float = 0.15
    plane_part: float = 8.0
    plane_behind: float = 6.0
    # What is asked for is no farther behind a table (m) than its start is off (T1's are 33 mm): else it is none.
    plane_hides: float = 0.035
    # Readings this near (m) to the rendered hand are the hand's: smooth bias at two sigmas, and the joints' errors.
    hand_margin: float = 0.006
    # The hand's outline is uncertain by this (m): joints wrong by 0.3 degrees over a finger, and the rest of the
    # calibration's error after alignment. Beside it depth alone does not tell hand from object.
    hand_outline: float = 0.001
    # With colour the uncertain strip is this much wider, because colour decides inside it (px).
    colour_strip: int = 6
    # Colour is asked when hand and object differ by this many standard deviations, each known from so many pixels, and
    # from no more than so many; a channel's share varies by at least `colour_floor` within one thing (shading, white
    # balance).
    colour_apart: float = 3.0
    colour_pixels: int = 60
    colour_most: int = 2000
    # The object's colour is looked for this near to the hand's outline (px): what is held is there, clutter rarely.
    colour_around: int = 25
    colour_floor: float = 0.012
    # The truth is no farther (m) from a coarse start than this, anywhere on the object (T1: 33 mm and 16 degrees).
    reach: float = 0.045
    # Neighbouring readings that differ by more (m, and as a share of depth) belong to different things.
    step: float = 0.008
    step_share: float = 0.01
    # Pieces smaller than this (px) are noise.
    smallest: int = 25
    # A held object's pieces are this near (m) to the hand, or to what the fingers felt; clutter is not.
    held: float = 0.015
    # A piece far from the hand counts when its middle is this near (m) to the object at the coarse start.
    explained: float = 0.015
    # The largest piece that the hand may be behind, or whose middle is no farther (m) from the object at the start than
    # starts are off, counts when it is this many times larger than all others together.
    larger: float = 1.0
    may_be: float = 0.033
    # Pieces that together are less than this share of what the object shows on average are rests of the hand, or what
    # nine tenths of hiding leave. Then the largest piece within the object's diameter of the hand counts when it alone
    # is more than that: the far end of a hammer that the hand holds from behind.
    fair_share: float = 0.1


def object_mask(
    frame: Frame,
    model: ObjectModel,
    beliefs: Beliefs | None = None,
    start: Array | None = None,
    settings: MaskSettings | None = None,
    colour: bool = True,
    view: HandView | None = None,
) -> Mask:
    """(h, w) pixels that show the object; all False for a frame without depth or with the object outside the image.

    start (4, 4) camera_from_object: a coarse one, or None. Without one the object is looked for around the contacts or
    between the hand's fingertips, and in the whole image when there are neither. A mask of the frame is not used.
    colour: whether the colour image, when there is one, may tell the hand from the object. view: the hand as it was
    seen in this frame before.
    """
    settings, beliefs = settings or MaskSettings(), beliefs or Beliefs()
    if frame.depth is None or frame.camera is None:
        return np.zeros((0, 0), dtype=bool)
    mask = np.zeros(frame.depth.shape, dtype=bool)
    region = find_region(frame, model, start, settings.slack)
    full = (0, 0, frame.camera.width, frame.camera.height)
    box = full if region is None else region.box(frame.camera)
    if box is None:
        return mask
    part = (slice(box[1], box[3]), slice(box[0], box[2]))
    z, candidates = _candidates(frame, model, start, region, box, settings, beliefs.depth)
    if view is None and frame.hand is not None and frame.joints is not None and frame.world_from_hand is not None:
        wide = read_pixels(frame.depth, frame.camera, full, settings.most_hand)
        view = view_hand(frame, wide, beliefs, HandViewSettings())
    if view is not None:
        rgb = frame.rgb[part] if colour and frame.rgb is not None else None
        candidates &= ~_hand_pixels(frame, view, box, z, candidates, rgb, settings)
    pieces = connected_pieces(z, candidates, settings)
    mask[part] = _chosen(pieces, z, (box[0], box[1]), frame, model, start, view, settings)
    return mask


def _candidates(
    frame: Frame,
    model: ObjectModel,
    start: Array | None,
    region: Region | None,
    box: tuple[int, int, int, int],
    settings: MaskSettings,
    depth_model: DepthModel,
) -> tuple[Array, Mask]:
    """Depths (h, w) of a box of pixels, 0 for no reading, and which may be the object's by where they are."""
    assert frame.depth is not None
    assert frame.camera is not None
    camera = frame.camera
    z, good = np.zeros((box[3] - box[1], box[2] - box[0])), np.zeros((box[3] - box[1], box[2] - box[0]), dtype=bool)
    points, each = _some_points(frame, settings)
    plane = find_plane(points, settings, depth_model, each=each)
    off = for_kernels(np.zeros((0, 6)) if plane is None else plane[None], depth_model, settings)
    ball = (0.0, 0.0, 0.0, np.inf) if region is None else (*(float(x) for x in region.centre), float(region.radius))
    lens = camera.fx, camera.fy, camera.cx, camera.cy
    kernels.candidates(np.ascontiguousarray(frame.depth), lens, box, ball, *off, z, good)
    if start is not None and good.any():
        row, column = np.nonzero(good)
        x, y = (column + box[0] - camera.cx) / camera.fx, (row + box[1] - camera.cy) / camera.fy
        points = np.stack([x, y, np.ones(len(row))], axis=1) * z[good][:, None]
        distance = model.field.distance(poses.apply(poses.inverse(start), points))
        good[good] = np.abs(distance) < settings.reach
    return z, good


def on_planes(points: Array, planes: Array, depth_model: DepthModel, settings: MaskSettings) -> Mask:
    """(...) whether points (..., 3) are on one of planes (k, 6), within what a camera makes of it, or behind the first.

    A plane: see `find_plane`.
    """
    on = np.zeros(points.shape[:-1], dtype=bool)
    if len(planes):
        flat = np.ascontiguousarray(points, np.float64).reshape(-1, 3)
        mark_planes(flat, *for_kernels(planes, depth_model, settings), on.reshape(-1))
    return on


def for_kernels(
    planes: Array, depth_model: DepthModel, settings: MaskSettings
) -> tuple[Array, tuple[float, float, float], tuple[float, float]]:
    """Planes (k, 6), a depth camera's noise and the margins of a plane, as compiled loops take them."""
    own = depth_model.axial_floor, depth_model.axial_growth, depth_model.axial_from
    return np.ascontiguousarray(planes, np.float64), own, (settings.plane_margin, settings.plane_sigmas)


def find_planes(
    frame: Frame, settings: MaskSettings, depth_model: DepthModel, extent: float, meant: Array | None = None
) -> Array:
    """(k, 6) table, wall and floor: planes that many readings lie on, most first, each of them larger than extent (m).

    A plane: see `find_plane`. Behind the first there is nothing; a further one may be a box's side, beside which more
    is seen. meant (3,): about where the object is, camera frame, behind none of them; None where nobody knows.
    """
    points, each = _some_points(frame, settings)
    found, left = np.zeros((0, 6)), points
    for k in range(settings.most_planes):
        share = settings.plane_share if not k else settings.next_plane_share * len(points) / max(len(left), 1)
        plane = find_plane(left, settings, depth_model, share, each, np.inf if k else settings.plane_most_behind)
        if plane is None:
            break
        in_front = meant is not None and plane[:3] @ meant + plane[3] < -settings.plane_hides
        plane[5] = 0.0 if k or in_front else np.inf
        on = on_planes(left, plane[None], depth_model, settings)
        low, high = np.percentile(left[on], [5, 95], axis=0)
        if not in_front and float(np.linalg.norm(high - low)) <= extent:
            break
        # in front is an arm's side
        found, left = found if in_front else np.concatenate([found, plane[None]]), left[~on]
    return found


def _some_points(frame: Frame, settings: MaskSettings) -> tuple[Array, float]:
    """(n, 3) points of the whole image, thinned, and the share of the image that each stands for."""
    assert frame.depth is not None
    assert frame.camera is not None
    box = (0, 0, frame.camera.width, frame.camera.height)
    read = read_pixels(frame.depth, frame.camera, box, settings.plane_points)
    return read.points, read.area / max(frame.camera.width * frame.camera.height, 1)


def find_plane(
    points: Array,
    settings: MaskSettings,
    depth_model: DepthModel,
    least_share: float | None = None,
    each: float = 1.0,
    most_behind: float = np.inf,
) -> Array | None:
    """(6,) the plane that most of the points (n, 3) lie on; None when there is no such plane, or when much is seen
    beyond it.

    A hand and what it holds are none: each, the share of the image that a point stands for, says how much of it the
    plane fills, and what scatters as far as a hand does is no camera's noise.

    Unit normal towards the camera and offset, height = n . p + o; how many times as far as is believed of the camera
    they scatter about it, 1 at least; and how far behind it (m) there is nothing else, inf. least_share: of the points;
    None for the settings'. most_behind: see `MaskSettings.plane_most_behind`.
    """
    if len(points) < 50:
        return None
    tolerance = settings.plane_margin + settings.plane_sigmas * depth_model.independent_sigma(points[:, 2])
    rng = np.random.default_rng(0)
    corners = points[rng.integers(len(points), size=(settings.plane_tries, 3))]
    normals = poses.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normals, axis=1)
    normals = normals[length > 1e-6] / length[length > 1e-6, None]
    offsets = -np.einsum("ni,ni->n", normals, corners[length > 1e-6][:, 0])
    if not len(normals):
        return None
    votes = np.zeros(len(normals), dtype=np.int64)
    count_votes(np.ascontiguousarray(points), tolerance, normals, offsets, settings.plane_voters, votes)
    best = int(votes.argmax())
    normal, offset = normals[best], offsets[best]
    chosen = np.abs(points @ normal + offset) < tolerance
    if chosen.sum() < 50:
        return None
    for _ in range(3):
        middle = points[chosen].mean(axis=0)
        _, _, axes = np.linalg.svd(points[chosen] - middle, full_matrices=False)
        normal = axes[2] * (1.0 if axes[2] @ middle <= 0 else -1.0)
        offset = -float(normal @ middle)
        chosen = np.abs(points @ normal + offset) < tolerance
        if chosen.sum() < 50:
            return None
    height = points @ normal + offset
    beyond = float((height < -2 * tolerance).mean())
    share = float(chosen.mean())
    if share <= (settings.plane_share if least_share is None else least_share) or beyond >= 0.5 * share:
        return None
    scatter = _scatter(height, tolerance, points[:, 2], depth_model, settings)
    if chosen.sum() * each < settings.plane_image or scatter >= settings.plane_most_scatter:
        return None
    if runs_on_behind(points, tolerance, normal, offset, settings.plane_part, settings.plane_behind) >= most_behind:
        return None
    return np.concatenate([normal, [offset, scatter, np.inf]])


def _scatter(height: Array, tolerance: Array, z: Array, depth_model: DepthModel, settings: MaskSettings) -> float:
    """How many times as far as is believed readings at depths z (n,) scatter about a plane, 1 at least.

    height (n,) above it, m. Nothing stands behind a table or wall: what is read there, as far as it may be the plane
    (four times the tolerance (n,)), is noise, and its median is 0.67 standard deviations.
    """
    behind = (height < 0.0) & (height > -4.0 * tolerance)
    if not behind.any():
        return 1.0
    sigma = np.hypot(depth_model.independent_sigma(z[behind]), settings.plane_margin / settings.plane_sigmas)
    seen = float(median(-height[behind] / sigma)) / 0.6745
    return float(max(seen, 1.0))


def _hand_pixels(
    frame: Frame,
    view: HandView,
    box: tuple[int, int, int, int],
    z: Array,
    candidates: Mask,
    rgb: NDArray[np.uint8] | None,
    settings: MaskSettings,
) -> Mask:
    """(h, w) pixels of the box that show the hand: where it is rendered at that depth, or uncertainly beside it."""
    import cv2

    assert frame.camera is not None
    nearest, farthest = np.zeros((2, *z.shape), dtype=np.float32)
    there, close = np.zeros(z.shape, dtype=np.uint8), np.zeros(z.shape, dtype=bool)
    kernels.lay_hand(view.depth(frame.camera, box), nearest, farthest, there)
    if not there.any():
        return np.asarray(close)
    outline = int(np.ceil(settings.hand_outline * frame.camera.fx / float(median(farthest[there > 0]))))
    margin = np.float32(settings.hand_margin)
    if rgb is not None:
        kernel = _square(outline + settings.colour_strip)
        near, far = cv2.erode(nearest, kernel), cv2.dilate(farthest, kernel)
        kernels.close_to(z, candidates, near, far, margin, close)
        inner, outer, uncertain = np.zeros((3, *z.shape), dtype=bool)
        whole, around = cv2.erode(there, kernel), cv2.dilate(there, _square(settings.colour_around))
        kernels.part(candidates, close, near, whole, around, inner, outer, uncertain)
        scores = _colour_scores(rgb, inner, outer, uncertain, settings)
        if scores is not None:
            inner[uncertain] = scores > 0
            return np.asarray(inner)
    kernel = _square(outline)
    kernels.close_to(z, candidates, cv2.erode(nearest, kernel), cv2.dilate(farthest, kernel), margin, close)
    return np.asarray(close)


def _square(reach: int) -> NDArray[np.uint8]:
    """What cv2 widens by so many pixels with."""
    return np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)


def _colour_scores(
    rgb: NDArray[np.uint8], hand: Mask, other: Mask, asked: Mask, settings: MaskSettings
) -> Array | None:
    """(n,) above 0 where the colour of an asked pixel is more the hand's; None when the two are not known apart.

    Shares of the channels, which shading leaves alone; medians, because what is not the hand is not all the object.
    """
    if min(np.count_nonzero(hand), np.count_nonzero(other)) < settings.colour_pixels:
        return None

    def shares(chosen: Mask, most: float) -> Array:
        count = int(np.count_nonzero(chosen))
        step = int(max(1, count // most))
        out = np.zeros((-(-count // step), 2))
        kernels.shares(rgb, chosen, step, out)
        return out

    centres, spreads = [], []
    for part in (hand, other):
        share = shares(part, settings.colour_most)
        centre = median(share)
        centres.append(centre)
        spreads.append(np.maximum(1.4826 * median(np.abs(share - centre)), settings.colour_floor))
    apart = np.abs(centres[0] - centres[1]) / np.sqrt((spreads[0] ** 2 + spreads[1] ** 2) / 2)
    if apart.max() < settings.colour_apart:
        return None
    share = shares(asked, np.inf)
    off = [np.square((share - c) / s).sum(axis=1) + 2 * np.log(s).sum() for c, s in zip(centres, spreads)]
    return np.asarray(off[1] - off[0])


def connected_pieces(z: Array, candidates: Mask, settings: MaskSettings) -> NDArray[np.int64]:
    """(h, w) number of the connected piece that each candidate pixel belongs to, from 0; -1 elsewhere."""
    number = np.zeros(z.shape, dtype=np.int64)
    known = np.asarray(candidates, dtype=bool)
    number_pieces(
        np.asarray(z, np.float64), known, settings.step, settings.step_share, np.zeros(z.size, np.int64), number
    )
    return number


def _chosen(
    pieces: NDArray[np.int64],
    z: Array,
    corner: tuple[int, int],
    frame: Frame,
    model: ObjectModel,
    start: Array | None,
    view: HandView | None,
    settings: MaskSettings,
) -> Mask:
    """(h, w) pixels of the pieces that are held, felt, or where the start expects the object; else the largest.

    z (h, w): depths (m) of the pixels from corner (u, v) on.
    """
    assert frame.camera is not None
    size = np.bincount(pieces.ravel() + 1)[1:]
    kept = np.zeros(len(size) + 1, dtype=bool)  # the last one stands for no piece
    felt = frame.contacts.moved(frame.camera_from_world).points
    # the hand may be behind the object: what is seen is then its thickness away
    thickness = settings.held + 2.0 * max(0.0, -model.field.lowest)
    gaps = np.full(len(size), np.inf)
    off = np.zeros(len(size))
    samples = _samples(pieces, np.where(size >= settings.smallest, size, 0), z, corner, frame.camera)
    for piece, few in samples.items():
        if view is not None:
            gaps[piece] = view.gap(few)
        if len(felt):
            gaps[piece] = min(gaps[piece], float(np.linalg.norm(few[:, None] - felt[None], axis=2).min()))
        if start is not None:
            off[piece] = float(np.median(np.abs(model.field.distance(poses.apply(poses.inverse(start), few)))))
            kept[piece] = off[piece] < settings.explained
    kept[:-1] |= gaps < settings.held
    _join(kept, samples, settings.held)
    near = gaps < thickness if start is None else off < settings.may_be
    behind = np.where(near, size, 0)
    if behind.max(initial=0) > settings.larger * size[kept[:-1]].sum():
        kept[int(behind.argmax())] = True
    if start is None and view is not None and kept.any():
        middle = float(median(z[pieces >= 0]))
        # the mean shadow of a convex body is a quarter of its surface (Cauchy); that of another is less
        shown = settings.fair_share * model.area / 4.0 * frame.camera.fx * frame.camera.fy / middle**2
        far = np.where((gaps < model.diameter) & ~kept[:-1], size, 0)
        if size[kept[:-1]].sum() < shown < far.max(initial=0):
            kept[int(far.argmax())] = True
    if not kept.any() and size.max(initial=0) >= settings.smallest:
        kept[int(size.argmax())] = True
    return np.asarray(kept[pieces])


def _samples(
    pieces: NDArray[np.int64], size: NDArray[np.int64], z: Array, corner: tuple[int, int], camera: Camera
) -> dict[int, Array]:
    """About SAMPLES points (n, 3) of each of pieces (h, w) whose size (k,) is not 0, by its number."""
    step = np.where(size > 0, np.maximum(size // SAMPLES, 1), 0)
    counts = np.where(step > 0, -(-size // np.maximum(step, 1)), 0)
    ends = np.cumsum(counts)
    points = np.zeros((int(ends[-1]) if len(ends) else 0, 3))
    lens = camera.fx, camera.fy, camera.cx, camera.cy
    kernels.every(pieces, step, ends - counts, lens, corner, z, points)
    return {int(piece): points[ends[piece] - counts[piece] : ends[piece]] for piece in np.flatnonzero(size)}


def _join(kept: Mask, samples: dict[int, Array], gap: float) -> None:
    """Mark, in place, pieces within `gap` metres of marked ones, and of those in turn: readings lost between them."""
    trees = {piece: Nearest(points) for piece, points in samples.items()}
    fresh = [piece for piece in samples if kept[piece]]
    while fresh:
        piece = fresh.pop()
        for other in samples:
            if not kept[other] and trees[piece].distance(samples[other]).min() < gap:
                kept[other] = True
                fresh.append(other)
