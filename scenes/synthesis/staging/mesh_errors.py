"""The mesh that an estimator is given is not quite the object: too fat, of another size, another scan.

The object that is seen and felt stays the true one; both meshes share their frame, so that the true pose is the same.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from scenes.errors import unknown
from scenes.geometry import poses
from scenes.geometry.objects import ObjectModel

Array = NDArray[np.float64]
Faces = NDArray[np.int64]

# How much too fat a mesh is (m), as a coarse voxel grid or a thick scan leaves it, and its wrong size (share).
FAT = 0.001
SCALE = 1.01
# Another scan: faces left, waves that bend it, and the standard deviation of their bumps and dents (m); meshes of one
# product from two data sets differ by millimetres to a centimetre.
SCAN_FACES = 3000
WAVES = 12
SCAN_SIGMA = 0.0025
# Edges of meshes with few faces are cut until they can bend (m).
LONGEST_EDGE = 0.012
# Wavelengths of the bumps, shares of the diameter.
WAVELENGTH = (0.4, 1.2)
# A mesh that is bent: fewer, longer or shorter waves of another size (m); all faces stay.
BENT_WAVES = 7
BENT_SIGMA = 0.0016
BENT_WAVELENGTH = (0.25, 0.9)
# A mesh that is nearly right, as a good scan leaves it: dents and bumps of less than a millimetre, shorter ones too.
DENTED_WAVES = 10
DENTED_SIGMA = 0.0006
DENTED_WAVELENGTH = (0.15, 0.7)


def believed(model: ObjectModel, error: str | None, seed: int = 0) -> ObjectModel:
    """The mesh that the estimator gets instead of the object's, with the same name and symmetries.

    error: one of `NAMES`, None for the true mesh. Another scan is another one for every seed. Raises InputError,
    listing the names, for an unknown one.
    """
    if error is None:
        return model
    if error not in _MAKERS:
        raise unknown("mesh error", error, _MAKERS)
    rng = np.random.default_rng([seed, zlib.crc32(model.name.encode())])
    vertices, faces = _MAKERS[error](model, rng)
    return ObjectModel.from_mesh(vertices, faces, model.name, model.symmetries, where=f"{model.name}, {error}")


def _fat(model: ObjectModel, rng: np.random.Generator) -> tuple[Array, Faces]:
    return model.vertices + FAT * _outwards(model), model.faces


def _scaled(model: ObjectModel, rng: np.random.Generator) -> tuple[Array, Faces]:
    return model.centroid + SCALE * (model.vertices - model.centroid), model.faces


def _scan(model: ObjectModel, rng: np.random.Generator) -> tuple[Array, Faces]:
    """Fewer faces, and a smooth deformation."""
    vertices, faces = _evenly_cut(model)
    return _waved(model, vertices, WAVES, WAVELENGTH, SCAN_SIGMA, rng), faces


def _bent(model: ObjectModel, rng: np.random.Generator) -> tuple[Array, Faces]:
    vertices, faces = _evenly_cut(model)
    return _waved(model, vertices, BENT_WAVES, BENT_WAVELENGTH, BENT_SIGMA, rng), faces


def _dented(model: ObjectModel, rng: np.random.Generator) -> tuple[Array, Faces]:
    vertices, faces = _evenly_cut(model)
    return _waved(model, vertices, DENTED_WAVES, DENTED_WAVELENGTH, DENTED_SIGMA, rng), faces


def _waved(
    model: ObjectModel,
    vertices: Array,
    count: int,
    wavelength: tuple[float, float],
    sigma: float,
    rng: np.random.Generator,
) -> Array:
    """Vertices (n, 3) moved smoothly by sigma (m per axis), without the rigid motion that this holds.

    wavelength: of the waves, shares of the diameter.
    """
    length = model.diameter * rng.uniform(*wavelength, count)
    waves = 2 * np.pi / length[:, None] * poses.random_unit_vectors(count, rng)
    along = poses.random_unit_vectors(count, rng) * rng.normal(size=(count, 1))
    phase = rng.uniform(0, 2 * np.pi, count)

    def shift(points: Array) -> Array:
        return np.asarray(np.sin(points @ waves.T + phase) @ along)

    surface, _ = model.sample_surface(4000, seed=0)
    moved = shift(surface)
    size = sigma / max(float(np.sqrt((moved**2).sum(axis=1).mean() / 3)), 1e-12)
    back = _rigid(surface + size * moved, surface)
    return poses.apply(back, vertices + size * shift(vertices))


def _rigid(points: Array, onto: Array) -> Array:
    """The motion (4, 4) that brings points (n, 3) nearest to their partners (Arun, Huang, Blostein 1987)."""
    middle, goal = points.mean(axis=0), onto.mean(axis=0)
    u, _, vt = np.linalg.svd((onto - goal).T @ (points - middle))
    rotation = u @ np.diag([1.0, 1.0, float(np.sign(np.linalg.det(u @ vt)))]) @ vt
    return poses.make_pose(rotation, goal - rotation @ middle)


def _evenly_cut(model: ObjectModel) -> tuple[Array, Faces]:
    if len(model.faces) <= SCAN_FACES:
        import trimesh

        finer = trimesh.remesh.subdivide_to_size(model.vertices, model.faces, LONGEST_EDGE)
        whole = trimesh.Trimesh(*finer)  # corners that faces share are one again
        return np.array(whole.vertices, dtype=np.float64), np.array(whole.faces, dtype=np.int64)
    from scenes._open3d import open3d

    o3d = open3d()
    mesh = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(model.vertices), o3d.utility.Vector3iVector(model.faces.astype(np.int32))
    )
    fewer = mesh.simplify_quadric_decimation(SCAN_FACES)
    return np.asarray(fewer.vertices).copy(), np.asarray(fewer.triangles).astype(np.int64)


def _outwards(model: ObjectModel) -> Array:
    """(n, 3) where vertices move when all faces move outwards by 1: the mean normal, faces weighed by their angle
    (Thürmer and Wüthrich 1998), longer where faces meet at an edge.
    """
    corners = model.vertices[model.faces]
    angles = np.zeros((len(model.faces), 3))
    for i in range(3):
        a, b = corners[:, (i + 1) % 3] - corners[:, i], corners[:, (i + 2) % 3] - corners[:, i]
        size = np.maximum(np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1), 1e-300)
        angles[:, i] = np.arccos(np.clip(np.einsum("ij,ij->i", a, b) / size, -1.0, 1.0))
    total, weight, along = np.zeros_like(model.vertices), np.zeros(len(model.vertices)), np.zeros(len(model.vertices))
    for i in range(3):
        np.add.at(total, model.faces[:, i], angles[:, i, None] * model.face_normals)
        np.add.at(weight, model.faces[:, i], angles[:, i])
    unit = total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12)
    for i in range(3):
        cosine = np.einsum("ij,ij->i", unit[model.faces[:, i]], model.face_normals)
        np.add.at(along, model.faces[:, i], angles[:, i] * cosine)
    # at a needle's point the mean would run away
    return np.asarray(unit / np.maximum(along / np.maximum(weight, 1e-12), 0.5)[:, None])


_MAKERS: dict[str, Callable[[ObjectModel, np.random.Generator], tuple[Array, Faces]]] = {
    "fat": _fat,
    "scaled": _scaled,
    "scan": _scan,
    "bent": _bent,
    "dented": _dented,
}
NAMES = tuple(_MAKERS)
