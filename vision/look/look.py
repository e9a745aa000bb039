"""One look at a frame: the only way from pixels to what may be the object. Camera frame, metres.

The hand is found first, because it is the one thing in view whose shape and place are known. Without a start and a mask
the object's own pixels are then told from table, hand and clutter; else a ball around the start is enough.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from scenes.errors import check_above
from scenes.geometry import poses
from scenes.geometry.cameras import Camera, is_reading
from scenes.geometry.objects import ObjectModel
from scenes.recordings.beliefs import Beliefs, usual_beliefs
from scenes.recordings.frames import Frame
from vision.filling import FillingSettings
from vision.look.colours import Coloured, PartingSettings
from vision.look.hand.hand import HandView, HandViewSettings, view_hand
from vision.look.looked import Looked, RowSettings, no_pixels, no_planes, nothing_seen
from vision.look.mask.mask import connected_pieces, exceeds, object_mask
from vision.look.mask.piece_kernels import list_cells, surface_points
from vision.look.mask.planes import find_planes, floors_of, floors_under, for_kernels
from vision.look.mask.settings import MaskSettings
from vision.look.pixel_kernels import CHOSEN, OTHER
from vision.look.pixels import Pixels, Region, median, read_pixels, sort_pixels
from vision.look.points import all_points
from vision.look.regions import find_region
from vision.noise import NoiseSettings

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class LookSettings:
    """What is looked at and what is taken for the object. By judgement, on generated captures."""

    # Room around the prior's ball in which the object is looked for, metres: T1's coarse starts are 33 mm off.
    slack: float = 0.035
    # Share of a mask's readings from which on those that lie before the rest, by more than the object is long, are the
    # object's, and the rest was seen through it: a quarter, of which a mask is not believed anyway
    # (`VerdictSettings.most_bare`); less than that leaks onto what stands in front.
    seen_through: float = 0.25
    # Pixels read from the region's box (object, hand and background together), and of those inside the region the
    # ones that are told apart from the hand: a closest-point query each.
    most: int = 40_000
    most_inside: int = 2500
    # The same around a start: what shows the object is looked at again when poses are fitted.
    most_near: int = 1500
    # Pixels of the whole image among which the hand is looked for.
    most_hand: int = 12_000
    # Pixels outside the region that are kept: more than the rays of free space are not used.
    most_others: int = 120
    # Whether, without a start and a mask, table, hand and clutter are taken away first where a hand is seen.
    tidy: bool = True
    # Fewer pixels than this are no object but what a mask left over.
    least_masked: int = 60
    # A plane that most readings lie on is table or wall, not the object, where it goes on for so many times the
    # diameter of the object (between its 5th and 95th percentiles).
    plane_extent: float = 1.5
    # Pieces of the image where nothing tells the object from other things: pixels along each axis from one that is
    # looked at to the next, the most of them, the most pixels of each, and the least share of what the object shows on
    # average that one must have.
    piece_step: int = 3
    most_pieces: int = 10
    most_in_piece: int = 1200
    piece_share: float = 0.1
    # Pieces by colour and depth that propose, at most.
    most_coloured: int = 6
    # Smoothed depths of neighbours that differ by more (m, and as a share of depth) part a piece in two: a third of
    # what parts things for certain; of pieces that share this much the coarser is kept.
    piece_fine: float = 0.002
    piece_fine_share: float = 0.003
    piece_same: float = 0.9
    # Share of what was taken for the object, because it is at the hand, that an answer which is not `ok` leaves on no
    # surface of it, from which on other things must be at the hand: of 15 answers of tuning families with that much 5
    # were right, of the other 37 that were not `ok` 23; with arms, another generator's, none of 5.
    other_share: float = 0.2
    # Confidence (a probability, no unit) from which what is found away from a hand is answered, where nothing is at the
    # hand: more likely right than not. What is hidden in a hand whole would else be at whatever looks a little like it.
    elsewhere: float = 0.5
    colour: PartingSettings = field(default_factory=PartingSettings)
    hand: HandViewSettings = field(default_factory=HandViewSettings)
    mask: MaskSettings = field(default_factory=MaskSettings)
    noise: NoiseSettings = field(default_factory=NoiseSettings)
    filling: FillingSettings = field(default_factory=FillingSettings)
    rows: RowSettings = field(default_factory=RowSettings)

    def __post_init__(self) -> None:
        """Refuse looks that leave no pixels."""
        counts = ("most", "most_inside", "most_near", "most_hand", "most_others", "piece_step", "most_in_piece")
        check_above(self, counts)


def look(
    frame: Frame,
    model: ObjectModel,
    beliefs: Beliefs | None = None,
    start: Array | None = None,
    settings: LookSettings | None = None,
) -> Looked:
    """Sort the frame's pixels into object, hand and others.

    start (4, 4) camera_from_object, a coarse one, narrows the region. A frame without depth gives its cloud's points,
    one whose region is outside the image no pixels.
    """
    settings, beliefs = settings or LookSettings(), beliefs or usual_beliefs()
    if start is not None:
        settings = replace(settings, most_inside=min(settings.most_inside, settings.most_near))
    region = find_region(frame, model, start, settings.slack, frame.mask, settings.seen_through)
    if frame.depth is None or frame.camera is None:
        return _cloud(frame, region, settings)
    alone = frame.mask is None and start is None
    hand = _find_hand(frame, beliefs, settings)
    empty = settings.tidy and alone and hand is not None and not len(frame.contacts)
    if _box(frame, region) is None:
        outside = "region outside the image"
        return replace(nothing_seen(region, outside, hand), empty=True) if empty else nothing_seen(region, outside)
    if frame.mask is None and hand is None:
        planes = large_planes(frame, model, beliefs, settings, start)
        bare = _sorted(frame, region, None, None, settings, planes, beliefs)
        if start is not None:
            return bare
        return replace(bare, pieces=_find_pieces(frame, model, planes, beliefs, settings))
    if frame.mask is not None and hand is None:
        masked = _sorted(frame, region, frame.mask, None, settings)
        planes = large_planes(frame, model, beliefs, settings, start, floor_only=True)
        return replace(masked, floors=floors_under(masked.pixels.points, planes, settings.mask, beliefs.depth))
    if not settings.tidy or not alone or hand is None or not len(hand.points):
        return replace(_sorted(frame, region, frame.mask, hand, settings), empty=empty)
    mask = object_mask(frame, model, beliefs, settings=settings.mask, view=hand)
    if np.count_nonzero(mask) < settings.least_masked:
        bare = _sorted(frame, region, None, hand, settings)
        return replace(bare, how="; no piece of an object near the hand", empty=empty)
    if not len(frame.contacts) and exceeds(mask, frame, model, settings.mask):
        return among_others(frame, model, hand, beliefs, settings)
    region = find_region(frame, model, None, settings.slack, mask)
    found = _sorted(frame, region, mask, hand, settings)
    felt = len(frame.contacts) > 0
    return replace(found, how="; table, hand and clutter taken away", at_hand=not felt, at_touch=felt)


def among_others(
    frame: Frame,
    model: ObjectModel,
    hand: HandView,
    beliefs: Beliefs | None = None,
    settings: LookSettings | None = None,
    anywhere: bool = False,
) -> Looked:
    """All that may be the object near a hand that is known, where what is at the hand is not all the object's: its arm,
    as a rule, of which there is no model. Nobody says then what hides the object, or which piece it is. anywhere: in
    all the image, for nothing is at the hand.
    """
    settings, beliefs = settings or LookSettings(), beliefs or usual_beliefs()
    planes = large_planes(frame, model, beliefs, settings)
    region = None if anywhere else find_region(frame, model, None, settings.slack)
    found = _sorted(frame, region, None, hand, settings, planes, beliefs)
    pieces = []
    for piece in _find_pieces(frame, model, planes, beliefs, settings):
        bare = piece.take(~hand.nearer(piece.points, settings.hand.margin))
        if len(bare) * settings.piece_step**2 >= settings.least_masked:
            pieces.append(bare)
    how = f"; the hand and {found.how.removeprefix('; ')}" if found.how else "; the hand taken away"
    return replace(found, told_apart=False, pieces=tuple(pieces), how=f"{how}, other things are at it")


def _box(frame: Frame, region: Region | None) -> tuple[int, int, int, int] | None:
    """Pixels (u0, v0, u1, v1) that can see the region; None when it is outside the image."""
    assert frame.camera is not None
    return (0, 0, frame.camera.width, frame.camera.height) if region is None else region.box(frame.camera)


def large_planes(
    frame: Frame,
    model: ObjectModel,
    beliefs: Beliefs,
    settings: LookSettings,
    start: Array | None = None,
    floor_only: bool = False,
) -> Array:
    """(k, 6) planes that many readings lie on, too large to be the object's own face; see `find_planes`. start (4, 4):
    about where the object is; without one it is near what is felt. floor_only: the first of them alone.
    """
    meant = None
    if start is not None:
        meant = poses.apply(start, model.centroid[None])[0]
    elif len(frame.contacts):
        meant = median(poses.apply(frame.camera_from_world, frame.contacts.points))
    extent = settings.plane_extent * model.diameter
    return find_planes(frame, settings.mask, beliefs.depth, extent, meant, floor_only)


def _find_pieces(
    frame: Frame, model: ObjectModel, planes: Array, beliefs: Beliefs, settings: LookSettings
) -> tuple[Pixels, ...]:
    """Connected surfaces off the planes, largest first, those that are not far too small to be the object's; then those
    into which finer steps of depth part them: a finger that lies on the object is one piece with it, or two.
    """
    assert frame.camera is not None
    out: list[Pixels] = []
    points, pieces = surfaces(frame, planes, beliefs, settings)
    # of the pieces that are there: which each cell is of, and their sizes
    coarse = np.full(pieces.size, -1)
    sizes: list[int] = []
    for numbers in (pieces, finer_surfaces(points, pieces, settings)):
        size = np.bincount(numbers.ravel() + 1, minlength=2)[1:]
        order = np.argsort(-size, kind="stable")[: settings.most_pieces - len(out)]
        before = len(sizes)
        for own in _cells(numbers, order, size):
            # what finer steps did not part is there already
            shared = np.bincount(coarse[own] + 1, minlength=before + 1)[1 : before + 1]
            if (shared > settings.piece_same * np.array(sizes[:before])).any():
                continue
            pixels = _piece(own, points, frame.camera, model, settings)
            if pixels is not None:
                # those that finer steps part are of no other
                if numbers is pieces:
                    coarse[own] = len(sizes)
                    sizes.append(len(own))
                out.append(pixels)
    return tuple(out)


def _cells(numbers: NDArray[np.int64], chosen: NDArray[np.int64], size: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Indices, in order, of the cells of each chosen piece of numbers (h, w), whose sizes (k,) are known."""
    slot = np.full(len(size), -1)
    slot[chosen] = np.arange(len(chosen))
    ends = np.cumsum(size[chosen])
    cells = np.zeros(int(ends[-1]) if len(ends) else 0, dtype=np.int64)
    list_cells(numbers.ravel(), slot, ends - size[chosen], cells)
    return np.split(cells, ends[:-1]) if len(ends) else []


def coloured_pieces(
    coloured: Coloured, points: Array, camera: Camera, model: ObjectModel, settings: LookSettings
) -> tuple[Pixels, ...]:
    """What colour says may be one thing of surfaces with points (h, w, 3), largest first, those that are not far too
    small to be the object's.
    """
    found = []
    for group in coloured.groups[: settings.most_coloured]:
        of_it = np.zeros(int(coloured.numbers.max(initial=-1)) + 2, dtype=bool)  # the last one stands for no piece
        of_it[group] = True
        own = np.flatnonzero(of_it[coloured.numbers])
        pixels = _piece(own, points, camera, model, settings)
        if pixels is not None:
            found.append(pixels)
    return tuple(found)


def _piece(
    own: NDArray[np.int64], points: Array, camera: Camera, model: ObjectModel, settings: LookSettings
) -> Pixels | None:
    """The pixels that cells own (n,) of points (h, w, 3) are; None where these are far too few for the object's."""
    step, count, places = settings.piece_step, len(own), points.reshape(-1, 3)
    middle = float(median(places[own, 2])) if count else 0.0
    # the mean shadow of a convex body is a quarter of its surface (Cauchy)
    shown = model.area / 4.0 * camera.fx * camera.fy / max(middle, 1e-3) ** 2 / step**2
    if count < max(settings.least_masked / step**2, settings.piece_share * shown):
        return None
    v, u = np.divmod(own, points.shape[1])
    pixels = Pixels(step * np.stack([u, v], axis=1), places[own], float(step**2))
    return pixels.thinned(settings.most_in_piece)


def finer_surfaces(points: Array, pieces: NDArray[np.int64], settings: LookSettings) -> NDArray[np.int64]:
    """(h, w) numbers of the pieces into which finer steps of smoothed depth part surfaces; see `surfaces`."""
    import cv2

    z = cv2.medianBlur(np.ascontiguousarray(points[..., 2], dtype=np.float32), 3).astype(np.float64)
    fine = replace(settings.mask, step=settings.piece_fine, step_share=settings.piece_fine_share)
    return connected_pieces(z, (pieces >= 0) & is_reading(z), fine)


def surfaces(frame: Frame, planes: Array, beliefs: Beliefs, settings: LookSettings) -> tuple[Array, NDArray[np.int64]]:
    """Points (h, w, 3) at every settings.piece_step pixels, and the number of the connected surface that each is on,
    from 0, largest or not; -1 where nothing is read, or on one of the planes (k, 6).
    """
    assert frame.depth is not None
    assert frame.camera is not None
    camera, step = frame.camera, settings.piece_step
    shape = -(-camera.height // step), -(-camera.width // step)
    points, good = np.zeros((*shape, 3)), np.zeros(shape, dtype=bool)
    lens, off = (camera.fx, camera.fy, camera.cx, camera.cy), for_kernels(planes, beliefs.depth, settings.mask)
    surface_points(np.ascontiguousarray(frame.depth), lens, step, *off, points, good)
    return points, connected_pieces(points[..., 2], good, settings.mask)


def _find_hand(frame: Frame, beliefs: Beliefs, settings: LookSettings) -> HandView | None:
    if frame.hand is None or frame.joints is None or frame.world_from_hand is None:
        return None
    assert frame.depth is not None
    assert frame.camera is not None
    full = (0, 0, frame.camera.width, frame.camera.height)
    return view_hand(frame, read_pixels(frame.depth, frame.camera, full, settings.most_hand), beliefs, settings.hand)


def _sorted(
    frame: Frame,
    region: Region | None,
    mask: Mask | None,
    hand: HandView | None,
    settings: LookSettings,
    planes: Array | None = None,
    beliefs: Beliefs | None = None,
) -> Looked:
    """The pixels of the region, thinned, by what they may show."""
    assert frame.depth is not None
    assert frame.camera is not None
    box = _box(frame, region)
    if box is None:
        return nothing_seen(region, "region outside the image")
    planes = no_planes() if planes is None else planes
    off = for_kernels(planes, (beliefs or usual_beliefs()).depth, settings.mask)
    pixels = sort_pixels(frame.depth, frame.camera, box, settings.most, region, mask, off)
    others, mine = pixels.some(OTHER, settings.most_others), pixels.some(CHOSEN, settings.most_inside)
    dropped: dict[str, int] = {}
    near_hand = np.zeros(len(mine), dtype=bool)
    if hand is not None and len(mine):
        near_hand = hand.nearer(mine.points, settings.hand.margin)
        dropped["hand pixels"] = int(near_hand.sum())
    told_apart = mask is not None or hand is not None
    how = "; table or wall taken away" if len(planes) else ""
    kept, of_hand = mine.take(~near_hand), mine.take(near_hand)
    known = Looked(kept, of_hand, others, region, hand, dropped, told_apart=told_apart, how=how, planes=planes)
    return replace(known, floors=floors_of(planes))


def _cloud(frame: Frame, region: Region | None, settings: LookSettings) -> Looked:
    """A cloud has no pixels: its points are taken as they are, thinned evenly."""
    points = all_points(frame)
    dropped = {}
    if frame.cloud is not None and len(points) < len(frame.cloud):
        dropped["cloud points not finite"] = len(frame.cloud) - len(points)
    if region is not None:
        points = points[np.linalg.norm(points - region.centre, axis=1) < region.radius]
    cloud = Pixels(np.zeros((len(points), 2), dtype=np.int64), points, 1.0).thinned(settings.most_inside)
    return Looked(cloud, no_pixels(), no_pixels(), region, None, dropped, is_cloud=True)


def object_points(frame: Frame, model: ObjectModel, start: Array | None) -> Array:
    """(n, 3) camera-frame points that a look leaves to the object: what other methods are given to be fair to them."""
    return look(frame, model, start=start).pixels.points
