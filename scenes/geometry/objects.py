"""A known rigid object: its mesh in metres, its signed-distance lattice, surface samples and symmetries."""

from __future__ import annotations

import copy
import hashlib
import logging
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenes.cache import Arrays, are_triangles, remembered_of_file
from scenes.errors import InputError, MeshError, unknown
from scenes.files.formats.meshes import loaded, without_triangles
from scenes.geometry import distance_field, mesh_repair, poses
from scenes.geometry.appearance.texture import Texture, files_beside, sampled
from scenes.geometry.distance_field import DistanceField
from scenes.geometry.surface import Surface, hull_of
from scenes.geometry.symmetries import Symmetries

_log = logging.getLogger(__name__)

Array = NDArray[np.float64]
Faces = NDArray[np.int64]

# Those of the formats that need no package beyond what is installed with this one.
MESHES = ".ply .obj .stl .off .glb"
METRES_PER_UNIT = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254}

# What a hand can meet. Outside, the unit is almost surely wrong.
SMALLEST_DIAMETER = 0.005
LARGEST_DIAMETER = 2.0
# Above this, the hull of all vertices costs seconds and only the outer ones are asked for the largest extent.
MANY_VERTICES = 100_000
# Surface samples up to so many are kept, drawn from the first seed: every frame asks for the same again.
KEPT_SAMPLES = 1000
# Points of the surface that `slippage` is the mean over: its square root is then known to 1 %.
SLIPPING_POINTS = 4000
# Sides from which an outline is looked at, and vertices that it is drawn of: their mean is within 2 % of that of all.
SIDES, DRAWN = 16, 2000
# Raised whenever reading, repairing or measuring a mesh changes, so that old cache entries are not read.
MESH_VERSION = 3


class ObjectModel:
    """A closed rigid object in its own frame, metres.

    Attributes: name; vertices (n, 3); faces (m, 3), wound outwards; centroid (3,) of the volume; diameter, largest
    extent across the vertices; symmetries, of the shape; mended, what was repaired when it was read, in words; texture,
    what is printed on it, None for a plain object.
    """

    def __init__(
        self,
        name: str,
        vertices: Array,
        faces: Faces,
        symmetries: Symmetries | None = None,
        mended: tuple[str, ...] = (),
        texture: Texture | None = None,
    ) -> None:
        """Use `load` or `from_mesh`, which check and repair."""
        self.name = name
        self.vertices = np.ascontiguousarray(vertices, dtype=np.float64)
        self.faces = np.ascontiguousarray(faces, dtype=np.int64)
        low, high = (int(self.faces.min()), int(self.faces.max())) if self.faces.size else (0, -1)
        if low < 0 or high >= len(self.vertices):
            raise InputError(f"{name}: expected vertex numbers 0..{len(self.vertices) - 1}, got {low}..{high}")
        self.symmetries = symmetries or Symmetries.none()
        self.mended = mended
        self.texture = texture

    @staticmethod
    def load(path: str | Path, unit: str = "m", name: str | None = None) -> ObjectModel:
        """Read any mesh that trimesh reads, and the OFF files that strict parsers refuse; with its colours, where it
        has some (at vertices, by faces, or in an image beside it).

        unit: "m", "cm", "mm" or "inch", of the file's numbers. Raises MeshError for a file that is not a mesh, has no
        triangles, cannot be closed, or whose size tells that the unit is wrong.
        """
        path = Path(path)
        if unit not in METRES_PER_UNIT:
            raise unknown("unit", unit, METRES_PER_UNIT)
        if not path.is_file():
            raise MeshError(f"{path}: expected a mesh file, found none")

        def make() -> Arrays:
            vertices, faces, (points, colours) = _read_mesh(path)
            made = ObjectModel.from_mesh(vertices * METRES_PER_UNIT[unit], faces, where=str(path))
            mended = np.array(made.mended, dtype=np.str_)
            parts = {"vertices": made.vertices, "faces": made.faces, "mended": mended}
            printed: Arrays = {"points": (points * METRES_PER_UNIT[unit]).astype(np.float32), "colours": colours}
            return {**parts, **printed, "diameter": np.array(made.diameter)}

        # a mesh seen before needs neither a reader of every format nor a repair: both load for a second
        try:
            beside = [hashlib.sha256(one.read_bytes()).hexdigest() for one in files_beside(path)]
            known = remembered_of_file("mesh", (MESH_VERSION, unit, *beside), path, make, _is_model)
        except OSError as error:
            raise MeshError(f"{path}: expected a mesh file, it cannot be opened: {error.strerror}") from error
        model = ObjectModel(
            name or path.stem, known["vertices"], known["faces"], mended=tuple(map(str, known["mended"]))
        )
        vars(model)["diameter"] = float(known["diameter"])
        if model.mended:
            _log.info("%s is not closed as it is: %s", path, "; ".join(model.mended))
        return model.with_texture(Texture(known["points"], known["colours"])) if len(known["points"]) else model

    def with_symmetries(self, symmetries: Symmetries) -> ObjectModel:
        """The same object of which these symmetries are known."""
        other = copy.copy(self)
        other.symmetries = symmetries
        return other

    def with_texture(self, texture: Texture | None) -> ObjectModel:
        """The same object with this printed on it."""
        other = copy.copy(self)
        other.texture = texture
        return other

    @staticmethod
    def from_mesh(
        vertices: Array,
        faces: Faces,
        name: str = "object",
        symmetries: Symmetries | None = None,
        where: str | None = None,
    ) -> ObjectModel:
        """Check, repair and keep a mesh given as vertices (n, 3) metres and faces (m, 3)."""
        where = where or name
        vertices, faces, mended = mesh_repair.close(vertices, faces, where)
        model = ObjectModel(name, vertices, faces, symmetries, tuple(mended))
        check_size(model.diameter, where)
        return model

    @property
    def filled(self) -> tuple[str, ...]:
        """In words, which surface the mesh did not have and was given; none where it was closed."""
        made = ", ".join(how for how in self.mended if mesh_repair.FILLED in how)
        return (f"the mesh is not closed as it is: {made}",) if made else ()

    @cached_property
    def diameter(self) -> float:
        """Largest distance between two vertices, metres."""
        from scipy.spatial import ConvexHull, QhullError
        from scipy.spatial.distance import cdist, pdist

        vertices = self.vertices if len(self.vertices) <= MANY_VERTICES else _outer(self.vertices)
        try:
            hull = vertices[ConvexHull(vertices).vertices]
        except QhullError:
            hull = vertices
        if len(hull) <= 2000:
            pairs = pdist(hull)
            row = int(np.searchsorted(np.cumsum(np.arange(len(hull) - 1, 0, -1)), int(pairs.argmax()), side="right"))
            longest, end = float(pairs.max()), hull[row]
        else:
            # those of a pair farther apart than a first guess lie far from the middle
            guess = float(pdist(hull[:: len(hull) // 1000 + 1]).max())
            away = np.linalg.norm(hull - hull.mean(axis=0), axis=1)
            first, second = hull[away >= 0.5 * guess], hull[away >= guess - away.max()]
            reach = np.concatenate([cdist(first[i : i + 1000], second).max(axis=1) for i in range(0, len(first), 1000)])
            longest, end = float(reach.max()), first[int(reach.argmax())]
        if len(vertices) < len(self.vertices):  # from the end that was found, among all of them
            longest = max(longest, float(np.linalg.norm(self.vertices - end, axis=1).max()))
        return longest

    @cached_property
    def _moments(self) -> tuple[float, Array]:
        corners = self.vertices[self.faces] - self.vertices.mean(axis=0)
        volumes = np.einsum("ni,ni->n", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6.0
        total = float(volumes.sum())
        centre = (volumes[:, None] * corners.sum(axis=1) / 4.0).sum(axis=0) / total
        return total, centre + self.vertices.mean(axis=0)

    @property
    def volume(self) -> float:
        """Cubic metres."""
        return self._moments[0]

    @property
    def centroid(self) -> Array:
        """(3,) centre of the volume: the point about which poses are perturbed and covariances expressed."""
        return self._moments[1]

    @cached_property
    def radius(self) -> float:
        """Distance of the farthest vertex from the centroid, metres."""
        return float(np.linalg.norm(self.vertices - self.centroid, axis=1).max())

    @cached_property
    def area(self) -> float:
        """Of the surface, square metres."""
        corners = self.vertices[self.faces]
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        return float(0.5 * np.linalg.norm(cross, axis=1).sum())

    @cached_property
    def mean_outline(self) -> float:
        """Area of the outline as seen from far away, square metres: the mean over all sides, of the convex hull."""
        import cv2

        sides = poses.around(SIDES)
        across = np.cross(sides, np.eye(3)[np.argmin(np.abs(sides), axis=1)])
        across /= np.linalg.norm(across, axis=1)[:, None]
        vertices = self.vertices[:: max(1, len(self.vertices) // DRAWN)]
        drawn = vertices @ np.stack([across, np.cross(sides, across)]).transpose(1, 2, 0)
        outlines = [cv2.contourArea(cv2.convexHull(points.astype(np.float32))) for points in drawn]
        return float(np.mean(outlines))

    @cached_property
    def slippage(self) -> Array:
        """(6, 6) mean over the surface of j j^T, j = (p x n, n) about the centroid, object axes: how far (mean square,
        m^2) points move along their normals for a small turn (rad) and shift (m); what slides along itself counts
        nothing (Gelfand and Guibas, Shape segmentation using local slippage analysis, 2004).

        Normals are the distance field's: a scan's facets tilt by ten degrees, as if a can were a gear.
        """
        points, _ = self.sample_surface(SLIPPING_POINTS, seed=1)
        normals = self.field.normals(points)
        rows = np.concatenate([np.cross(points - self.centroid, normals), normals], axis=1)
        return np.asarray(rows.T @ rows / len(rows), dtype=np.float64)

    @cached_property
    def field(self) -> DistanceField:
        """The signed-distance lattice; built at the first use, then read from the disk cache."""
        return distance_field.load_or_build(self.vertices, self.faces)

    @cached_property
    def face_normals(self) -> Array:
        """(m, 3) outward unit normals."""
        corners = self.vertices[self.faces]
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        return cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-300)

    @cached_property
    def surface(self) -> Surface:
        """Exact closest points on the mesh (slower than `field`, for the last digits)."""
        return Surface(self.vertices, self.faces)

    def __getstate__(self) -> dict[str, object]:
        """Everything but the ray-casting scene, which does not pickle and is rebuilt where it is needed."""
        return {key: value for key, value in self.__dict__.items() if key != "surface"}

    def sample_surface(self, count: int, seed: int = 0, only: NDArray[np.int64] | None = None) -> tuple[Array, Array]:
        """Points (count, 3) uniform over the area and their outward normals (count, 3); not to be written to. only:
        numbers (k,) of those that are asked for, in their order.
        """
        if only is None and (count, seed) in self._sampled:
            return self._sampled[count, seed]
        rng = np.random.default_rng(seed)
        # as rng.choice of these shares draws, which sums them up each time
        at, (u, v) = rng.random(count), rng.random((2, count))
        if only is not None:
            at, u, v = at[only], u[only], v[only]
        face = self._face_sums.searchsorted(at, side="right")
        root = np.sqrt(u)
        weights = np.stack([1 - root, root * (1 - v), root * v], axis=1)
        corners = self.vertices[self.faces[face]]
        found = np.einsum("nk,nkd->nd", weights, corners), self.face_normals[face]
        if seed == 0 and only is None and count <= KEPT_SAMPLES:
            self._sampled[count, seed] = found
        return found

    @cached_property
    def outer_vertices(self) -> Array:
        """(k, 3) the vertices that bound all of them in every view."""
        return np.ascontiguousarray(self.vertices[hull_of(self.vertices)])

    def bounding_points(self, count: int) -> tuple[Array, int]:
        """The points (count, 3) of `sample_surface`, and how many of them, the first, bound all in every view."""
        if count not in self._bounding:
            points = self.sample_surface(count)[0]
            outer = hull_of(points)
            rest = np.delete(np.arange(len(points)), outer)
            self._bounding[count] = np.ascontiguousarray(points[np.concatenate([outer, rest])]), len(outer)
        return self._bounding[count]

    @cached_property
    def _bounding(self) -> dict[int, tuple[Array, int]]:
        return {}

    @cached_property
    def _sampled(self) -> dict[tuple[int, int], tuple[Array, Array]]:
        return {}

    @cached_property
    def _face_shares(self) -> Array:
        """(m,) shares of the surface's area."""
        corners = self.vertices[self.faces]
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        return np.asarray(area / area.sum())

    @cached_property
    def _face_sums(self) -> Array:
        """(m,) shares of the surface's area up to and with each face."""
        sums = self._face_shares.cumsum()
        return np.asarray(sums / sums[-1])

    def symmetry_poses(self, steps: int = 36) -> Array:
        """(k, 4, 4) object_from_object that leave the object unchanged."""
        return self.symmetries.poses(steps)


def _outer(vertices: Array) -> Array:
    """Of vertices (n, 3), the farthest from the middle in each of 7,200 directions: enough for the largest extent."""
    local = vertices - 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    away = np.linalg.norm(local, axis=1)
    height = np.clip((local[:, 2] / np.maximum(away, 1e-300) + 1) * 30, 0, 59).astype(np.int64)
    turn = np.clip((np.arctan2(local[:, 1], local[:, 0]) / np.pi + 1) * 60, 0, 119).astype(np.int64)
    order = np.lexsort((-away, height * 120 + turn))
    _, first = np.unique((height * 120 + turn)[order], return_index=True)
    return vertices[order[first]]


def check_size(diameter: float, where: str) -> None:
    """Raise MeshError when an object of `diameter` metres cannot be in a hand, and name the likely unit."""
    if SMALLEST_DIAMETER <= diameter <= LARGEST_DIAMETER:
        return
    # too large: numbers of a smaller unit read as metres; too small: metres read as a smaller unit
    smaller = [(unit, METRES_PER_UNIT[unit]) for unit in ("mm", "cm", "inch")]
    guesses = [f"{diameter:.3g} {unit}" for unit, factor in smaller if 0.02 <= diameter * factor <= 0.5]
    guesses += [f"{diameter / factor:.3g} m" for _, factor in smaller if 0.02 <= diameter / factor <= 0.5]
    hint = f" ({guesses[0]}?)" if guesses else ""
    raise MeshError(
        f"{where}: expected an object of {SMALLEST_DIAMETER * 1e3:.0f} mm to {LARGEST_DIAMETER:.0f} m,"
        f" got a diameter of {diameter:.4g} m{hint}: is the unit right?"
    )


def _is_model(arrays: Arrays) -> bool:
    mended, diameter = arrays["mended"], arrays["diameter"]
    told = mended.ndim == 1 and mended.dtype.kind == "U" and diameter.shape == ()
    points, colours = arrays["points"], arrays["colours"]
    printed = points.dtype == np.float32 and colours.dtype == np.uint8 and points.shape == colours.shape
    printed = printed and points.ndim == 2 and points.shape[1] == 3 and bool(np.isfinite(points).all())
    return bool(told and diameter > 0 and printed and are_triangles(arrays))


def _read_mesh(path: Path) -> tuple[Array, Faces, tuple[Array, NDArray[np.uint8]]]:
    """Vertices, faces, and coloured points of the surface, none for a mesh without colours; in the file's unit."""
    plain = np.zeros((0, 3)), np.zeros((0, 3), dtype=np.uint8)
    if path.suffix.lower() == ".off":
        from scenes.files.formats.off import read_off

        data = read_off(path)
        if data.colours is None or not len(data.faces):
            return data.points, data.faces, plain
        import trimesh

        coloured = trimesh.Trimesh(data.points, data.faces, vertex_colors=data.colours, process=False)
        return data.points, data.faces, sampled(coloured) or plain
    try:
        mesh = loaded(path, force="mesh")
    except ValueError as error:
        raise MeshError(f"{path}: expected a mesh ({MESHES} …), got {error}") from error
    vertices = getattr(mesh, "vertices", None)
    faces = getattr(mesh, "faces", None)
    if vertices is None or faces is None or len(faces) == 0:
        raise MeshError(f"{path}: expected a mesh with triangles, got {without_triangles(path)}")
    return np.asarray(vertices, dtype=np.float64), np.asarray(faces, dtype=np.int64), sampled(mesh) or plain
