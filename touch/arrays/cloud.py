"""The object's surface as points in a voxel list, for range queries of sensing boxes. Object frame, metres."""

from __future__ import annotations

from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from scenes.geometry.objects import ObjectModel

Array = NDArray[np.float64]


@dataclass(frozen=True)
class CloudSettings:
    """How dense the points are. Values by judgement."""

    # Surface per point (m^2): some forty points under a fingertip's pad. The thesis does not say.
    area: float = 6e-6
    # Limits on the number of points, and how many are drawn for each that is kept, to spread them evenly.
    fewest: int = 2000
    most: int = 60_000
    drawn: int = 6
    # Side of a voxel (m): about the width of a pad's shorter half.
    voxel: float = 0.005
    seed: int = 0


@dataclass(frozen=True)
class SurfaceCloud:
    """points (n, 3) sorted by voxel, z fastest; first (v + 1,): where each voxel's points begin; shape (3,) and
    corner (3,) of the grid; voxel: its side (m).
    """

    points: Array
    first: NDArray[np.int64]
    shape: NDArray[np.int64]
    corner: Array
    voxel: float

    @property
    def arguments(self) -> tuple[Array, NDArray[np.int64], NDArray[np.int64], Array, float]:
        """As the kernels take them."""
        return self.points, self.first, self.shape, self.corner, self.voxel

    @staticmethod
    def of_points(points: Array, voxel: float) -> SurfaceCloud:
        """From points (n, 3) in any order."""
        corner = points.min(axis=0) - 1e-9
        cell = np.floor((points - corner) / voxel).astype(np.int64)
        shape = cell.max(axis=0) + 1
        key = (cell[:, 0] * shape[1] + cell[:, 1]) * shape[2] + cell[:, 2]
        order = np.argsort(key, kind="stable")
        first = np.searchsorted(key[order], np.arange(int(shape.prod()) + 1)).astype(np.int64)
        return SurfaceCloud(np.ascontiguousarray(points[order]), first, shape, corner, voxel)


_CLOUDS: WeakKeyDictionary[ObjectModel, dict[CloudSettings, SurfaceCloud]] = WeakKeyDictionary()


def surface_cloud(model: ObjectModel, settings: CloudSettings | None = None) -> SurfaceCloud:
    """The object's cloud, made at the first call and kept as long as the object."""
    settings = settings or CloudSettings()
    known = _CLOUDS.setdefault(model, {})
    if settings not in known:
        known[settings] = SurfaceCloud.of_points(_even_points(model, settings), settings.voxel)
    return known[settings]


def _even_points(model: ObjectModel, settings: CloudSettings) -> Array:
    """Points spread evenly over the surface: of many random ones, those that come first in their neighbourhood."""
    from scipy.spatial import cKDTree

    corners = model.vertices[model.faces]
    area = 0.5 * float(
        np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()
    )
    count = int(np.clip(area / settings.area, settings.fewest, settings.most))
    points, _ = model.sample_surface(settings.drawn * count, settings.seed)
    # discs that no two of the kept share: random close packing covers 55 % of the plane
    apart = 2.0 * np.sqrt(0.55 * area / count / np.pi)
    near = cKDTree(points).query_pairs(apart, output_type="ndarray")
    near = near[np.lexsort((near[:, 1], near[:, 0]))]
    ends = np.searchsorted(near[:, 0], np.arange(len(points) + 1))
    keep = np.ones(len(points), dtype=bool)
    for i in range(len(points)):
        if keep[i]:
            keep[near[ends[i] : ends[i + 1], 1]] = False
    return points[keep]
