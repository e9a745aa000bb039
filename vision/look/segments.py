"""Which pixels may show the object, which show the hand, and what space the camera saw to be empty."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from scenes.evidence import table as tables
from scenes.evidence.table import VISION, Evidence
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Frame
from vision.look.hand import CalibrationModel, HandView, HandViewSettings, view_hand
from vision.look.pixels import DepthModel, Pixels, Region, read_pixels

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SegmentationSettings:
    """What is looked at and what is taken for the object."""

    # Room around the prior's ball in which the object is looked for, metres: T1's coarse starts are 33 mm off.
    slack: float = 0.035
    # Pixels read from the region's box (object, hand and background together), and of those inside the region the
    # ones that are told apart from the hand: a closest-point query each.
    most: int = 40_000
    most_inside: int = 2500
    # Pixels of the whole image among which the hand is looked for.
    most_hand: int = 12_000
    # A pixel this many sigmas in front of the surface is as likely something else: unknown occluders are common.
    gate_above: float = 2.5
    # Nothing opaque is inside the object; beyond this many sigmas the pixel is a flying one.
    gate_below: float = 5.0
    # Radius (m) of the crop that people use around a start, beyond the model's own.
    crop_margin: float = 0.01
    # Free space: rays sampled, points per ray, distance (m) kept from the seen surface, and the rows' sigma (m).
    free_rays: int = 120
    free_steps: int = 5
    free_clearance: float = 0.012
    free_sigma: float = 0.004
    free_gate: float = 3.0
    free_weight: float = 0.2


@dataclass(frozen=True)
class Segments:
    """Pixels of a frame by what they may show (camera frame).

    pixels: may be the object; hand: explained by the hand; others: seen beyond or beside the region (for free space).
    region: where the object is looked for. hand_view: the aligned hand. dropped: counts by reason. is_cloud: the points
    come from a cloud, not from pixels of a camera. told_apart: a mask or the hand's model
    removed what hides the object.
    """

    pixels: Pixels
    hand: Pixels
    others: Pixels
    region: Region | None
    hand_view: HandView | None = None
    dropped: dict[str, int] = field(default_factory=dict)
    is_cloud: bool = False
    told_apart: bool = False


def _no_pixels() -> Pixels:
    return Pixels(np.zeros((0, 2), dtype=np.int64), np.zeros((0, 3)), 1.0)


def find_region(frame: Frame, model: ObjectModel, start: Array | None, settings: SegmentationSettings) -> Region | None:
    """Where to look: around the start, else the mask, the contacts, the hand's fingertips, or everything."""
    if start is not None:
        centre = start[:3, :3] @ model.centroid + start[:3, 3]
        return Region(centre, model.radius + settings.slack)
    if frame.mask is not None and frame.depth is not None and frame.camera is not None and frame.mask.any():
        points = frame.camera.back_project(frame.depth, frame.mask)
        if len(points):
            return Region(np.median(points, axis=0), model.diameter + settings.slack)
    if len(frame.contacts):
        middle = frame.contacts.moved(frame.camera_from_world).points.mean(axis=0)
        return Region(middle, model.diameter + settings.slack)
    if frame.hand is not None and frame.joints is not None and frame.world_from_hand is not None:
        sensors = frame.hand.hand_from_sensor(frame.joints)
        if sensors:  # what a hand holds is among its fingertips
            middle = np.mean([pose[:3, 3] for pose in sensors.values()], axis=0)
            camera_from_hand = frame.camera_from_world @ frame.world_from_hand
            centre = camera_from_hand[:3, :3] @ middle + camera_from_hand[:3, 3]
            return Region(centre, model.diameter + settings.slack)
    return None


def region_around(model: ObjectModel, candidates: Array, settings: SegmentationSettings) -> Region:
    """The ball that holds the object at each of the poses (n, 4, 4) camera_from_object, with the usual slack."""
    middles = candidates[:, :3, :3] @ model.centroid + candidates[:, :3, 3]
    centre = 0.5 * (middles.min(axis=0) + middles.max(axis=0))
    reach = float(np.linalg.norm(middles - centre, axis=1).max())
    return Region(centre, model.radius + settings.slack + reach)


def crop_points(frame: Frame, model: ObjectModel, start: Array, settings: SegmentationSettings | None = None) -> Array:
    """(n, 3) camera-frame points of the usual crop: everything seen within the model's ball around the start."""
    settings = settings or SegmentationSettings()
    points = all_points(frame)
    centre = start[:3, :3] @ model.centroid + start[:3, 3]
    return points[np.linalg.norm(points - centre, axis=1) < model.radius + settings.crop_margin]


def object_points(frame: Frame, model: ObjectModel, start: Array | None) -> Array:
    """(n, 3) camera-frame points that our segmentation leaves to the object."""
    return segment(frame, model, start).pixels.points


def all_points(frame: Frame) -> Array:
    """(n, 3) camera-frame points of the depth image (mask applied when there is one) and the cloud."""
    parts = []
    if frame.depth is not None and frame.camera is not None:
        parts.append(frame.camera.back_project(frame.depth, frame.mask))
    if frame.cloud is not None:
        cloud = frame.cloud[np.isfinite(frame.cloud).all(axis=1)]
        parts.append(cloud @ frame.camera_from_world[:3, :3].T + frame.camera_from_world[:3, 3])
    return np.concatenate(parts) if parts else np.zeros((0, 3))


def segment(
    frame: Frame,
    model: ObjectModel,
    start: Array | None = None,
    settings: SegmentationSettings | None = None,
    depth_model: DepthModel | None = None,
    calibration: CalibrationModel | None = None,
    again: tuple[Region, HandView | None] | None = None,
) -> Segments:
    """Sort the frame's pixels into object, hand and others.

    start (4, 4) camera_from_object, a coarse one, narrows the region. A frame without depth, or whose region is outside
    the image, gives no pixels. again: a region to look at closely, and the hand as it was seen in this frame before.
    """
    settings = settings or SegmentationSettings()
    depth_model = depth_model or DepthModel()
    calibration = calibration or CalibrationModel()
    region = find_region(frame, model, start, settings) if again is None else again[0]
    if frame.depth is None or frame.camera is None:
        return _segment_cloud(frame, region, settings)
    full = (0, 0, frame.camera.width, frame.camera.height)
    box = region.box(frame.camera) if region is not None else full
    if box is None:
        return Segments(_no_pixels(), _no_pixels(), _no_pixels(), region, None, {"region outside the image": 1})
    pixels = read_pixels(frame.depth, frame.camera, box, settings.most)
    inside = np.ones(len(pixels), dtype=bool)
    if region is not None:
        inside = np.linalg.norm(pixels.points - region.centre, axis=1) < region.radius
    if frame.mask is not None:
        inside &= frame.mask[pixels.uv[:, 1], pixels.uv[:, 0]]
    others = pixels.take(~inside).thinned(settings.free_rays)
    mine = pixels.take(inside).thinned(settings.most_inside)
    dropped: dict[str, int] = {}
    hand_view = None
    near_hand = np.zeros(len(mine), dtype=bool)
    if frame.hand is not None and frame.joints is not None and frame.world_from_hand is not None:
        hand_settings = HandViewSettings()
        if again is not None:
            hand_view = again[1]
        else:
            wide = read_pixels(frame.depth, frame.camera, full, settings.most_hand)
            hand_view = view_hand(frame, wide, depth_model, calibration, hand_settings)
        if hand_view is not None and len(mine):
            near_hand = hand_view.nearer(mine.points, hand_settings.margin)
            dropped["hand pixels"] = int(near_hand.sum())
    told_apart = frame.mask is not None or hand_view is not None
    return Segments(
        mine.take(~near_hand), mine.take(near_hand), others, region, hand_view, dropped, told_apart=told_apart
    )


def _segment_cloud(frame: Frame, region: Region | None, settings: SegmentationSettings) -> Segments:
    """A cloud has no pixels: its points are taken as they are, thinned evenly."""
    points = all_points(frame)
    dropped = {}
    if frame.cloud is not None and len(points) < len(frame.cloud):
        dropped["cloud points not finite"] = len(frame.cloud) - len(points)
    if region is not None:
        points = points[np.linalg.norm(points - region.centre, axis=1) < region.radius]
    cloud = Pixels(np.zeros((len(points), 2), dtype=np.int64), points, 1.0).thinned(settings.most_inside)
    return Segments(cloud, _no_pixels(), _no_pixels(), region, None, dropped, is_cloud=True)


def surface_rows(segments: Segments, most: int, settings: SegmentationSettings, depth_model: DepthModel) -> Evidence:
    """ON rows of at most `most` object pixels, evenly chosen, weighed down for the bias that neighbours share."""
    pixels = segments.pixels
    if len(pixels) == 0:
        return tables.empty()
    step = max(1.0, len(pixels) / most)
    chosen = pixels.points[(np.arange(int(len(pixels) / step)) * step).astype(int)]
    if segments.is_cloud:
        return tables.make(
            chosen,
            depth_model.cloud_sigma,
            VISION,
            weight=min(1.0, depth_model.cloud_patches / len(chosen)),
            gate_above=settings.gate_above,
            gate_below=settings.gate_below,
        )
    independent = depth_model.independent_sigma(chosen[:, 2])
    sigma = np.sqrt(independent**2 + depth_model.bias_sigma**2)
    # rows that share one patch of bias: together they know the patch's bias no better than one of them
    length = depth_model.sharing_length if segments.told_apart else depth_model.sharing_length_unknown
    sharing = float(np.clip(length**2 / (pixels.area * step), 1.0, max(1.0, len(chosen) / 3.0)))
    weight = sigma**2 / (independent**2 + sharing * depth_model.bias_sigma**2)
    return tables.make(
        chosen,
        sigma,
        VISION,
        rays=chosen / np.linalg.norm(chosen, axis=1, keepdims=True),
        weight=np.minimum(weight, 1.0),
        gate_above=settings.gate_above,
        gate_below=settings.gate_below,
    )


def free_space_rows(segments: Segments, settings: SegmentationSettings) -> Evidence:
    """OUTSIDE rows along rays through the region, up to a clearance before what each ray met.

    Hand and background pixels speak as well as the object's own: whatever was seen, nothing was in front of it.
    """
    if segments.region is None:
        return tables.empty()
    groups = [p for p in (segments.others, segments.hand, segments.pixels) if len(p)]
    if not groups or segments.is_cloud:
        return tables.empty()
    ends = np.concatenate([p.points for p in groups])
    ends = ends[np.linspace(0, len(ends) - 1, min(len(ends), settings.free_rays)).astype(int)]
    length = np.linalg.norm(ends, axis=1)
    direction = ends / length[:, None]
    along = direction @ segments.region.centre
    across = np.linalg.norm(segments.region.centre - along[:, None] * direction, axis=1)
    half = np.sqrt(np.maximum(segments.region.radius**2 - across**2, 0.0))
    first, last = along - half, np.minimum(along + half, length - settings.free_clearance)
    use = (half > 0) & (last > first)
    first, last, direction = first[use], last[use], direction[use]
    if len(first) == 0:
        return tables.empty()
    # the last points of a ray are the telling ones; the rest are spread over the region
    share = (np.arange(settings.free_steps) + 1) / settings.free_steps
    t = first[:, None] + (last - first)[:, None] * share
    points = (direction[:, None] * t[..., None]).reshape(-1, 3)
    rows = tables.outside(points, settings.free_sigma, VISION, gate=settings.free_gate)
    # neighbours along a ray and across it repeat one another
    return rows.reweighted(settings.free_weight)
