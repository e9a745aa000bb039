"""The object's own pixels in a full scene: table and wall, the robot's hand and things that stand about taken away.

Everything is decided in the image at full resolution, from depth, the hand's model and, where it tells the hand from
the object, colour; nothing is learned. Camera frame, metres.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenes.geometry import poses
from scenes.geometry.cameras import Camera
from scenes.geometry.nearest import Nearest
from scenes.geometry.objects import ObjectModel
from scenes.recordings.beliefs import Beliefs, DepthModel
from scenes.recordings.frames import Frame
from vision.look.hand.hand import HandView, HandViewSettings, view_hand
from vision.look.mask import mask_kernels as kernels
from vision.look.mask.piece_kernels import number_pieces, sizes_of
from vision.look.mask.planes import find_plane, for_kernels, some_points
from vision.look.mask.settings import MaskSettings
from vision.look.pixels import Region, median, quantile, read_pixels
from vision.look.regions import find_region

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Points of a piece, about, from which its distances are told.
SAMPLES = 300


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


def exceeds(mask: Mask, frame: Frame, model: ObjectModel, settings: MaskSettings) -> bool:
    """Whether a connected piece of a mask (h, w) is longer than the object anywhere: then it is something else, or the
    object and something else.
    """
    assert frame.depth is not None
    assert frame.camera is not None
    rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    if not len(rows):
        return False
    top, left = int(rows[0]), int(columns[0])
    part = slice(top, rows[-1] + 1), slice(left, columns[-1] + 1)
    inside = np.ascontiguousarray(mask[part])
    z = np.where(inside, frame.depth[part], 0.0).astype(np.float64)
    pieces = connected_pieces(z, inside, settings)
    size = sizes_of(pieces)
    samples = _samples(pieces, np.where(size >= settings.smallest, size, 0), z, (left, top), frame.camera)
    longest = max((_length(points, settings.longest_share) for points in samples.values()), default=0.0)
    return longest > settings.longest * model.diameter


def _length(points: Array, share: float) -> float:
    """How long (m) the middle `share` of points (n, 3) is, along the axis along which they are longest."""
    off = points - median(points)
    along = off @ np.linalg.svd(off, full_matrices=False)[2][0]
    return quantile(along, 0.5 + 0.5 * share) - quantile(along, 0.5 - 0.5 * share)


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
    points, each = some_points(frame, settings)
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
    found = np.zeros(z.shape, dtype=bool)
    own = view.box_within(frame.camera, box)
    drawn = np.zeros((0, 0)) if own is None else view.depth(frame.camera, own)
    if own is None or not (is_drawn := np.isfinite(drawn)).any():
        return found
    away = float(median(drawn[is_drawn].astype(np.float32)))
    outline = int(np.ceil(settings.hand_outline * frame.camera.fx / away))
    # farther from the hand than that nothing is asked
    reach = outline if rgb is None else max(outline + settings.colour_strip, settings.colour_around)
    left, top = max(own[0] - box[0] - reach, 0), max(own[1] - box[1] - reach, 0)
    part = slice(top, own[3] - box[1] + reach), slice(left, own[2] - box[0] + reach)
    z, candidates = np.ascontiguousarray(z[part]), np.ascontiguousarray(candidates[part])
    depth = np.full(z.shape, np.inf)
    row, column = own[1] - box[1] - top, own[0] - box[0] - left
    depth[row : row + drawn.shape[0], column : column + drawn.shape[1]] = drawn
    nearest, farthest = np.zeros((2, *z.shape), dtype=np.float32)
    there, close = np.zeros(z.shape, dtype=np.uint8), np.zeros(z.shape, dtype=bool)
    kernels.lay_hand(depth, nearest, farthest, there)
    margin = np.float32(settings.hand_margin)
    if rgb is not None:
        kernel = _square(outline + settings.colour_strip)
        near, far = cv2.erode(nearest, kernel), cv2.dilate(farthest, kernel)
        kernels.close_to(z, candidates, near, far, margin, close)
        inner, outer, uncertain = np.zeros((3, *z.shape), dtype=bool)
        whole, around = cv2.erode(there, kernel), cv2.dilate(there, _square(settings.colour_around))
        kernels.part(candidates, close, near, whole, around, inner, outer, uncertain)
        scores = _colour_scores(np.ascontiguousarray(rgb[part]), inner, outer, uncertain, settings)
        if scores is not None:
            inner[uncertain] = scores > 0
            found[part] = inner
            return found
    kernel = _square(outline)
    kernels.close_to(z, candidates, cv2.erode(nearest, kernel), cv2.dilate(farthest, kernel), margin, close)
    found[part] = close
    return found


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
    squares = [np.square((share - c) / s) for c, s in zip(centres, spreads)]
    off = [square[:, 0] + square[:, 1] + 2 * np.log(s).sum() for square, s in zip(squares, spreads)]
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
    size = sizes_of(pieces)
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
