"""The object's and the hand's triangles as a page can carry them: few, of the same look, reduced once and kept."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenes.cache import Arrays, are_triangles, remembered
from scenes.geometry.objects import ObjectModel
from scenes.robot.hands import Hand

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

# Raised whenever the reduction changes what it makes, so that old cache entries are not read.
SHAPES_VERSION = 2
# A mesh of more than so many times what is asked for is thinned to that on a grid first: quadric decimation of millions
# of triangles takes minutes and gigabytes, and ends in the same look.
THINNED_FIRST = 20
# A link of a hand keeps at least this many triangles: a box.
FEWEST = 12


def shown_object(model: ObjectModel, most: int) -> tuple[Array, Indices]:
    """Vertices (n, 3) relative to the centroid, metres, and at most `most` triangles (m, 3)."""
    vertices = model.vertices - model.centroid
    if len(model.faces) <= most:
        return vertices, model.faces
    content = model.vertices, model.faces
    made = remembered(
        "shown",
        (SHAPES_VERSION, most),
        content,
        lambda: dict(zip(("vertices", "faces"), _reduced(vertices, model.faces, most))),
        are_triangles,
    )
    return made["vertices"], made["faces"]


def shown_hand(hand: Hand, most: int) -> tuple[Array, Indices, Indices]:
    """Vertices (n, 3) in the frames of their links, some `most` triangles (m, 3), and each vertex's link (n,)."""
    links = [[(s.vertices, s.faces) for s in shapes] for shapes in hand.robot.links.values()]
    total = sum(len(faces) for link in links for _, faces in link)

    def make() -> Arrays:
        vertices, faces, owner, count = [], [], [], 0
        for number, link in enumerate(links):
            for points, triangles in link:
                share = max(FEWEST, most * len(triangles) // total)
                points, triangles = _reduced(points, triangles, share) if total > most else (points, triangles)
                vertices.append(points)
                faces.append(triangles + count)
                owner.append(np.full(len(points), number))
                count += len(points)
        return {"vertices": np.concatenate(vertices), "faces": np.concatenate(faces), "links": np.concatenate(owner)}

    def is_sound(arrays: Arrays) -> bool:
        owner = arrays["links"]
        listed = owner.shape == arrays["vertices"].shape[:1] and owner.dtype.kind == "i"
        return bool(listed and are_triangles(arrays) and owner.min() >= 0 and owner.max() < len(links))

    content = [array for link in links for shape in link for array in shape]
    settings = SHAPES_VERSION, most, [len(link) for link in links]
    made = remembered("shown", settings, content, make, is_sound) if total > most else make()
    return made["vertices"], made["faces"], made["links"]


def _reduced(vertices: Array, faces: Indices, most: int) -> tuple[Array, Indices]:
    """A mesh of at most `most` triangles with the same look (quadric decimation)."""
    if len(faces) <= most:
        return vertices, faces
    from scenes._open3d import open3d

    o3d = open3d()
    mesh = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(vertices), o3d.utility.Vector3iVector(np.asarray(faces, dtype=np.int32))
    )
    if len(faces) > THINNED_FIRST * most:
        # a cell has two triangles, about
        cell = float(np.sqrt(2.0 * mesh.get_surface_area() / (THINNED_FIRST * most)))
        mesh = mesh.simplify_vertex_clustering(cell) if cell > 0.0 else mesh
    small = mesh.simplify_quadric_decimation(most)
    return np.asarray(small.vertices), np.asarray(small.triangles, dtype=np.int64)
