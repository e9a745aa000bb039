"""Colours of a surface: what is printed on an object. Object frame, metres; colours are shares of white, red first.

However a mesh file has them (at vertices, by faces, in an image laid over it), they are kept as coloured samples of the
surface, averaged over the cells of cubic lattices: one as fine as the samples, coarser ones for those who see
the object from far off, as an image's pyramid of levels (Williams, "Pyramidal parametrics", SIGGRAPH 1983).
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scenes.errors import MeshError
from scenes.geometry.surface_kernels import mix_cells

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TextureSettings:
    """How colours are kept. By judgement."""

    # Samples of a surface: one on every square of a 200th of a compact object's size.
    samples: int = 150_000
    # Cells along the object's longest side in the finest lattice, and how many lattices there are, each of cells of
    # twice the size of the one before.
    finest: int = 160
    levels: int = 4
    # Standard deviation of a colour (share of white) below which an object counts as plain: nothing is printed on it.
    plain: float = 0.02
    # Edges (m) of a mesh that is written with colours at its vertices, as far as that needs no more than so many faces.
    edge: float = 0.003
    most_faces: int = 200_000


class Texture:
    """The colours of a surface; `at` looks them up."""

    def __init__(self, points: ArrayLike, colours: ArrayLike, settings: TextureSettings | None = None) -> None:
        """Points (n, 3) of the surface, all over it; colours (n, 3) 0 to 255. Raises MeshError when they do not fit."""
        self.points = np.ascontiguousarray(points, dtype=np.float32)
        self.colours = np.ascontiguousarray(colours, dtype=np.uint8)
        self.settings = settings or TextureSettings()
        if self.points.ndim != 2 or self.points.shape[1] != 3 or not len(self.points):
            raise MeshError(f"texture: expected points of shape (n, 3), got {self.points.shape}")
        if self.colours.shape != self.points.shape:
            raise MeshError(f"texture: expected colours of shape {self.points.shape}, got {self.colours.shape}")

    @cached_property
    def levels(self) -> list[tuple[float, Array, NDArray[np.int32], Array]]:
        """Of each lattice: size of a cell (m), its origin (3,), number of each cell's colour + 1, 0 for none; colours
        (k, 3).
        """
        low = self.points.min(axis=0).astype(np.float64)
        extent = float((self.points.max(axis=0) - low).max())
        found = []
        for level in range(self.settings.levels):
            cell = max(extent / self.settings.finest, 1e-6) * 2.0**level
            origin = low - cell
            place = np.floor((self.points - origin) / cell).astype(np.int64)
            shape = tuple(place.max(axis=0) + 2)
            flat = np.ravel_multi_index(tuple(place.T), shape)
            used, own = np.unique(flat, return_inverse=True)
            count = np.bincount(own)
            mean = np.stack([np.bincount(own, self.colours[:, c] / 255.0) / count for c in range(3)], axis=1)
            index = np.zeros(int(np.prod(shape)), dtype=np.int32)
            index[used] = np.arange(1, len(used) + 1)
            found.append((cell, origin, index.reshape(shape), np.ascontiguousarray(mean)))
        return found

    def at(self, points: Array, size: float = 0.0) -> Array:
        """(n, 3) colours at points (n, 3) of the surface, averaged over about `size` (m); NaN far from the surface."""
        level = max((k for k, (cell, *_) in enumerate(self.levels) if cell <= max(size, 0.0)), default=0)
        out = np.full((len(points), 3), np.nan)
        for k in range(level, self.settings.levels):  # where the samples leave a gap, coarser cells have it
            open_ = np.isnan(out[:, 0])
            if not open_.any():
                break
            cell, origin, index, colours = self.levels[k]
            mixed = np.full((int(open_.sum()), 3), np.nan)
            mix_cells(np.ascontiguousarray(points[open_], dtype=np.float64), origin, cell, index, colours, mixed)
            out[open_] = mixed
        return out


def files_beside(path: Path) -> list[Path]:
    """Files that a mesh file takes its colours from, as far as they exist: an OBJ's materials and their images, the
    image that a PLY names in a comment.
    """
    kind = path.suffix.lower()
    if kind == ".obj":
        text = path.read_text(encoding="utf-8", errors="replace")
        materials = _there(path, re.findall(r"^mtllib\s+(.+?)\s*$", text, re.MULTILINE))
        named = [
            one
            for material in materials
            for one in re.findall(r"^\s*map_Kd\s+(.+?)\s*$", material.read_text(errors="replace"), re.MULTILINE)
        ]
        return [*materials, *_there(path, named)]
    if kind == ".ply":
        with path.open("rb") as file:
            head = file.read(4096).decode("latin-1")
        return _there(path, re.findall(r"^comment TextureFile\s+(.+?)\s*$", head, re.MULTILINE))
    return []


def _there(path: Path, names: list[str]) -> list[Path]:
    return [path.parent / name for name in names if (path.parent / name).is_file()]


def sampled(
    mesh: trimesh.parent.Geometry, settings: TextureSettings | None = None
) -> tuple[Array, NDArray[np.uint8]] | None:
    """Points (n, 3) of a mesh as read, in its own unit, and their colours (n, 3); None for a mesh without colours,
    or of about one colour all over.
    """
    s = settings or TextureSettings()
    import trimesh

    if not isinstance(mesh, trimesh.Trimesh):
        return None
    visual: Any = mesh.visual
    kind = getattr(visual, "kind", None)
    image = _image_of(visual) if kind == "texture" else None
    if kind not in ("vertex", "face") and image is None:
        return None
    with np.errstate(over="ignore", invalid="ignore"):
        area = np.asarray(mesh.area_faces, dtype=np.float64)
    if not (np.isfinite(area).all() and area.sum() > 0.0):
        return None
    rng = np.random.default_rng(0)
    face = np.sort(rng.choice(len(area), size=s.samples, p=area / area.sum()))
    u, v = rng.random((2, s.samples))
    root = np.sqrt(u)
    weights = np.stack([1 - root, root * (1 - v), root * v], axis=1)
    corner = np.asarray(mesh.faces)[face]
    points = np.einsum("nk,nkd->nd", weights, np.asarray(mesh.vertices)[corner])
    if image is not None:
        uv = np.asarray(visual.uv, dtype=np.float64)
        if uv.shape != (len(mesh.vertices), 2):
            return None
        colours = _read(image, np.einsum("nk,nkd->nd", weights, uv[corner]))
    elif kind == "face":
        colours = np.asarray(visual.face_colors)[face, :3].astype(np.float64)
    else:
        colours = np.einsum("nk,nkd->nd", weights, np.asarray(visual.vertex_colors)[corner][..., :3].astype(np.float64))
    good = np.isfinite(points).all(axis=1) & np.isfinite(colours).all(axis=1)
    if not good.any() or (colours[good].std(axis=0) < 255.0 * s.plain).all():
        return None
    return points[good], np.clip(np.rint(colours[good]), 0, 255).astype(np.uint8)


def _image_of(visual: object) -> NDArray[np.uint8] | None:
    """(h, w, 3) the image laid over a mesh; None where it was not found beside it."""
    material = getattr(visual, "material", None)
    image = getattr(material, "image", None)
    if image is None:
        image = getattr(material, "baseColorTexture", None)
    if image is None or getattr(visual, "uv", None) is None:
        return None
    return np.asarray(image.convert("RGB"), dtype=np.uint8)


def _read(image: NDArray[np.uint8], uv: Array) -> Array:
    """(n, 3) colours at texture coordinates (n, 2), which repeat beyond 0 to 1 and count from below; bilinear."""
    height, width = image.shape[:2]
    x = np.mod(uv[:, 0], 1.0) * width - 0.5
    y = (1.0 - np.mod(uv[:, 1], 1.0)) * height - 0.5
    x0, y0 = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    fx, fy = (x - x0)[:, None], (y - y0)[:, None]
    x0, x1, y0, y1 = x0 % width, (x0 + 1) % width, np.clip(y0, 0, height - 1), np.clip(y0 + 1, 0, height - 1)
    top = image[y0, x0] * (1.0 - fx) + image[y0, x1] * fx
    return np.asarray(top * (1.0 - fy) + (image[y1, x0] * (1.0 - fx) + image[y1, x1] * fx) * fy, dtype=np.float64)


def coloured_mesh(
    vertices: Array, faces: NDArray[np.int64], texture: Texture | None, settings: TextureSettings | None = None
) -> tuple[Array, NDArray[np.int64], NDArray[np.uint8] | None]:
    """The same surface with triangles so small that colours at its vertices show the texture, and those colours (n, 3);
    as it is, and None, without one.
    """
    if texture is None:
        return vertices, faces, None
    import trimesh

    s = settings or TextureSettings()
    while 4 * len(faces) <= s.most_faces:
        edges = vertices[faces] - vertices[np.roll(faces, 1, axis=1)]
        if float(np.linalg.norm(edges, axis=2).max()) <= s.edge:
            break
        vertices, faces = trimesh.remesh.subdivide(vertices, faces)
    colours = np.nan_to_num(texture.at(np.asarray(vertices)), nan=0.5)
    return np.asarray(vertices), np.asarray(faces), np.rint(255.0 * colours).astype(np.uint8)
