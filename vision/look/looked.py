"""What was seen in a frame: pixels by what they may show, and the rows of evidence they make. Camera frame, metres."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from scenes.evidence import table as tables
from scenes.evidence.table import VISION, Evidence
from scenes.recordings.beliefs import DepthModel
from vision.look.hand.hand import HandView
from vision.look.pixels import Pixels, Region

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RowSettings:
    """What pixels say as rows of evidence. Tuned on generated captures."""

    # Object pixels that become rows.
    most: int = 500
    # A pixel this many sigmas in front of the surface is as likely something else: unknown occluders are common.
    gate_above: float = 2.5
    # Nothing opaque is inside the object; beyond this many sigmas the pixel is a flying one.
    gate_below: float = 5.0
    # Free space: rays sampled, points per ray, distance (m) kept from the seen surface, and the rows' sigma (m), gate
    # (sigmas) and weight (neighbours along a ray and across it repeat one another).
    free_rays: int = 120
    free_steps: int = 5
    free_clearance: float = 0.012
    free_sigma: float = 0.004
    free_gate: float = 3.0
    free_weight: float = 0.2


@dataclass(frozen=True)
class Looked:
    """Pixels of a frame by what they may show (camera frame).

    pixels: may be the object; of_hand: explained by the hand; others: seen beyond or beside the region (for free
    space). region: where the object is looked for. hand: the aligned hand. dropped: counts by reason. is_cloud: the
    points come from a cloud, not from pixels of a camera. told_apart: a mask or the hand's model removed what hides the
    object. how: a word on what was taken away first. planes (k, 6): table and walls, see `find_plane`; floors (m, 6):
    those behind which nothing is, whether or not readings are taken away as theirs. at_hand: pixels are the object's
    only because they are at the hand; at_touch: because they are there, and at what is felt. empty: nothing is seen at
    a hand that is known, or it is out of the image, and nothing is felt: it need not hold the object.
    """

    pixels: Pixels
    of_hand: Pixels
    others: Pixels
    region: Region | None
    hand: HandView | None = None
    dropped: dict[str, int] = field(default_factory=dict)
    is_cloud: bool = False
    told_apart: bool = False
    how: str = ""
    planes: Array = field(default_factory=lambda: np.zeros((0, 6)))
    pieces: tuple[Pixels, ...] = ()
    at_hand: bool = False
    at_touch: bool = False
    empty: bool = False
    floors: Array = field(default_factory=lambda: np.zeros((0, 6)))
    # rows by what they were made with: several steps ask for them
    _made: dict[tuple[DepthModel | None, RowSettings], Evidence] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    @property
    def seen_hand(self) -> HandView | None:
        """The aligned hand when enough of its pixels are seen to say where it is."""
        return self.hand if self.hand is not None and len(self.hand.points) else None

    def rows(self, depth: DepthModel, settings: RowSettings) -> Evidence:
        """Rows of the object's pixels, with the space before what was seen; none without such a pixel."""
        if (depth, settings) not in self._made:
            seen = surface_rows(self, depth, settings)
            self._made[depth, settings] = tables.stack(seen, self.free(settings)) if len(seen) else seen
        return self._made[depth, settings]

    def free(self, settings: RowSettings) -> Evidence:
        """OUTSIDE rows before what was seen, wherever the object is."""
        if (None, settings) not in self._made:
            self._made[None, settings] = free_space_rows(self, settings)
        return self._made[None, settings]


def nothing_seen(region: Region | None, why: str | None = None, hand: HandView | None = None) -> Looked:
    """No pixel at all, for a reason."""
    return Looked(no_pixels(), no_pixels(), no_pixels(), region, hand, {} if why is None else {why: 1})


def no_planes() -> Array:
    """No table and no wall."""
    return np.zeros((0, 6))


def no_pixels() -> Pixels:
    """An empty set of pixels."""
    return Pixels(np.zeros((0, 2), dtype=np.int64), np.zeros((0, 3)), 1.0)


def surface_rows(looked: Looked, depth: DepthModel, settings: RowSettings) -> Evidence:
    """ON rows of at most `settings.most` object pixels, evenly chosen, weighed down for the bias neighbours share."""
    pixels = looked.pixels
    if len(pixels) == 0:
        return tables.empty()
    step = max(1.0, len(pixels) / settings.most)
    chosen = pixels.points[(np.arange(int(len(pixels) / step)) * step).astype(int)]
    if looked.is_cloud:
        return tables.make(
            chosen,
            depth.cloud_sigma,
            VISION,
            weight=min(1.0, depth.cloud_patches / len(chosen)),
            gate_above=settings.gate_above,
            gate_below=settings.gate_below,
        )
    independent = depth.independent_sigma(chosen[:, 2])
    sigma = np.sqrt(independent**2 + depth.bias_sigma**2)
    # rows that share one patch of bias: together they know the patch's bias no better than one of them
    length = depth.sharing_length if looked.told_apart else depth.sharing_length_unknown
    sharing = float(np.clip(length**2 / (pixels.area * step), 1.0, max(1.0, len(chosen) / 3.0)))
    weight = sigma**2 / (independent**2 + sharing * depth.bias_sigma**2)
    return tables.make(
        chosen,
        sigma,
        VISION,
        rays=chosen / np.linalg.norm(chosen, axis=1, keepdims=True),
        weight=np.minimum(weight, 1.0),
        gate_above=settings.gate_above,
        gate_below=settings.gate_below,
    )


def free_space_rows(looked: Looked, settings: RowSettings) -> Evidence:
    """OUTSIDE rows along rays through the region, up to a clearance before what each ray met.

    Hand and background pixels speak as well as the object's own: whatever was seen, nothing was in front of it.
    """
    if looked.region is None:
        return tables.empty()
    groups = [p for p in (looked.others, looked.of_hand, looked.pixels) if len(p)]
    if not groups or looked.is_cloud:
        return tables.empty()
    ends = np.concatenate([p.points for p in groups])
    ends = ends[np.linspace(0, len(ends) - 1, min(len(ends), settings.free_rays)).astype(int)]
    length = np.linalg.norm(ends, axis=1)
    direction = ends / length[:, None]
    along = direction @ looked.region.centre
    across = np.linalg.norm(looked.region.centre - along[:, None] * direction, axis=1)
    half = np.sqrt(np.maximum(looked.region.radius**2 - across**2, 0.0))
    # a region may reach behind the camera, which sees nothing there
    first, last = np.maximum(along - half, 0.0), np.minimum(along + half, length - settings.free_clearance)
    use = (half > 0) & (last > first)
    first, last, direction = first[use], last[use], direction[use]
    if len(first) == 0:
        return tables.empty()
    # the last points of a ray are the telling ones; the rest are spread over the region
    share = (np.arange(settings.free_steps) + 1) / settings.free_steps
    t = first[:, None] + (last - first)[:, None] * share
    points = (direction[:, None] * t[..., None]).reshape(-1, 3)
    rows = tables.outside(points, settings.free_sigma, VISION, gate=settings.free_gate)
    return rows.reweighted(settings.free_weight)
