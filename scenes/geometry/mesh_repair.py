"""From a mesh as found to one with an inside: merged, closed, wound outwards; or a refusal with its reason."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scenes.errors import MeshError
from scenes.geometry import surface_kernels
from scenes.words import counted

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]
Faces = NDArray[np.int64]


# Of what was mended in words: surface that was made up.
FILLED = "filled"


@dataclass(frozen=True)
class RepairSettings:
    """What may be mended silently and what is refused. Values by judgement."""

    # Vertices nearer than this share of the diameter are one vertex (export round-off).
    merge_share: float = 1e-6
    # Curved holes are closed by the patch of least area as long as patches stay below this share of the surface:
    # beyond, the shape would be an invention. A flat rim has one obvious lid, so those may be larger (a box modelled
    # without its ends, a scan of what stood on a table).
    max_patch_share: float = 0.1
    max_lid_share: float = 0.4
    # A rim is flat when it leaves its plane by less than this share of its own size: a scan's ends in whole triangles.
    flat_share: float = 0.1
    # Rims of more corners are closed by a fan about their middle: a patch of least area takes their cube of steps.
    longest_rim: int = 800
    # Where triangles meet without sharing vertices nothing leaks: winding numbers (no unit)
    # stay this near whole numbers.
    largest_leak: float = 0.02


def close(
    vertices: ArrayLike, faces: ArrayLike, name: str, settings: RepairSettings | None = None
) -> tuple[Array, Faces, list[str]]:
    """Make a mesh closed and outwards wound.

    vertices (n, 3) any unit, faces (m, 3). Returns vertices, faces and what was mended, in words.
    Raises MeshError for no faces, not finite, flat, or open beyond the settings.
    """
    import trimesh

    settings = settings or RepairSettings()
    vertices, faces = _numbers(vertices, faces, name)
    if vertices.size and (vertices.ndim != 2 or vertices.shape[1] != 3):
        raise MeshError(f"{name}: expected vertices of shape (n, 3), got {vertices.shape}")
    if faces.size and (faces.ndim != 2 or faces.shape[1] != 3):
        raise MeshError(f"{name}: expected triangles of shape (m, 3), got {faces.shape}")
    if faces.size == 0:
        raise MeshError(f"{name}: expected a mesh with triangles, got {len(vertices)} vertices and no triangle")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise MeshError(f"{name}: expected vertex numbers 0..{len(vertices) - 1}, got {faces.min()}..{faces.max()}")
    mentioned = np.zeros(len(vertices), dtype=bool)
    mentioned[faces.ravel()] = True
    used = np.flatnonzero(mentioned)  # ten times faster than np.unique for a million triangles
    if not np.isfinite(vertices[used]).all():
        raise MeshError(f"{name}: expected finite vertices, got NaN or infinity")
    extent = np.ptp(vertices[used], axis=0)
    with np.errstate(over="ignore"):
        diameter = float(np.linalg.norm(extent))
    if diameter <= 0 or extent.min() < 1e-5 * diameter:
        raise MeshError(
            f"{name}: expected a solid, got a flat mesh of extent {extent[0]:.3g} x {extent[1]:.3g} x {extent[2]:.3g}"
        )

    if len(used) == len(vertices) and _is_clean(vertices, faces, diameter):
        return np.array(vertices), np.array(faces), []
    mended: list[str] = []
    before = len(faces)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    digits = int(np.clip(np.ceil(-np.log10(settings.merge_share * diameter)), 0, 14))
    mesh.update_vertices(np.isin(np.arange(len(vertices)), used))
    mesh.merge_vertices(digits_vertex=digits, merge_tex=True, merge_norm=True)
    mesh.update_faces(mesh.nondegenerate_faces(height=1e-12 * diameter))
    mesh.update_faces(_without_fins(np.asarray(mesh.faces)))
    mesh.update_faces(mesh.unique_faces())
    mesh.remove_unreferenced_vertices()
    if len(mesh.faces) == 0:
        raise MeshError(f"{name}: expected a mesh with triangles, got only triangles without area")
    if len(mesh.faces) < before:
        mended.append(f"{before - len(mesh.faces)} empty or repeated triangles removed")
    vertices, faces = np.array(mesh.vertices), np.array(mesh.faces, dtype=np.int64)

    if not mesh.is_winding_consistent:
        faces = _wound_alike(faces)
        mesh = trimesh.Trimesh(vertices, faces, process=False)
        mended.append("triangles rewound consistently")
    if not mesh.is_watertight and _encloses(mesh, settings.largest_leak):
        mended.append("edges that meet without sharing their vertices accepted (no gap between them)")
    elif not mesh.is_watertight:
        vertices, faces, patched, lids, holes = _close_holes(vertices, faces, settings)
        area = max(float(mesh.area), 1e-300)
        share = (patched + lids) / (area + patched + lids)
        mesh = trimesh.Trimesh(vertices, faces, process=False)
        if patched > settings.max_patch_share * area or lids > settings.max_lid_share * area or not mesh.is_watertight:
            left = _boundary_edges(faces)
            raise MeshError(
                f"{name}: expected a closed mesh, got {counted(holes, 'hole')}, {share:.0%} of its surface once closed"
                f" ({len(left)} edges still open after filling): close it in a mesh editor"
            )
        mended.append(f"{counted(holes, 'hole')} {FILLED} ({share:.1%} of the surface)")
    bodies = mesh.split(only_watertight=False, repair=False) if mesh.body_count > 1 else [mesh]
    with np.errstate(divide="ignore", invalid="ignore"):  # trimesh divides by the volume of what has none
        if mesh.volume < 0 or any(b.volume < 0 and _outermost(b, bodies) for b in bodies):
            if len(bodies) > 1:
                trimesh.repair.fix_inversion(mesh, multibody=True)
            else:
                mesh.invert()
            mended.append("inside-out surface turned outwards")
    if not mesh.volume > 1e-9 * diameter**3:
        raise MeshError(
            f"{name}: expected a solid, got a mesh of volume {mesh.volume:.3g} for a diameter of {diameter:.3g}"
        )
    return np.array(mesh.vertices, dtype=np.float64), np.array(mesh.faces, dtype=np.int64), mended


def _numbers(vertices: ArrayLike, faces: ArrayLike, name: str) -> tuple[Array, Faces]:
    """The arrays as numbers; raises MeshError for what is none, for what has an imaginary part or is masked, and for
    vertex numbers that are not whole.
    """
    for what, given in (("vertices", vertices), ("triangles", faces)):
        if np.iscomplexobj(given):
            raise MeshError(f"{name}: expected {what} as real numbers, got complex ones")
        if np.ma.is_masked(given):
            raise MeshError(f"{name}: expected {what} that are all there, got a masked array")
    try:
        points, corners = np.asarray(vertices, dtype=np.float64), np.asarray(faces)
        whole = corners if corners.dtype.kind in "iu" else np.asarray(corners, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise MeshError(f"{name}: expected vertices and triangles as numbers: {error}") from error
    if whole.dtype.kind == "f" and whole.size and not (np.abs(whole) < 2**53).all():
        raise MeshError(f"{name}: expected vertex numbers, got some that are not finite or too large")
    triangles = whole.astype(np.int64)
    if not np.array_equal(triangles, whole):
        raise MeshError(f"{name}: expected whole vertex numbers, got fractions")
    return points, triangles


def _without_fins(faces: Faces) -> NDArray[np.bool_]:
    """Triangles to keep (m,): not two of the same corners wound against each other (a fin without volume, as mesh
    simplification leaves them), where dropping both leaves no edge of theirs open.
    """
    keep = np.ones(len(faces), dtype=bool)
    _, group, size = np.unique(np.sort(faces, axis=1), axis=0, return_inverse=True, return_counts=True)
    for number in np.flatnonzero(size == 2):
        pair = np.flatnonzero(group.ravel() == number)
        first, second = (np.roll(faces[i], -int(np.argmin(faces[i]))) for i in pair)
        if first[1] == second[1]:
            continue  # the same triangle twice
        rest = np.delete(faces, pair, axis=0)
        left = [
            int(((rest == a).any(axis=1) & (rest == b).any(axis=1)).sum()) for a, b in zip(first, np.roll(first, 1))
        ]
        keep[pair] = not all(count in (0, 2) for count in left)
    return keep


def _is_clean(vertices: Array, faces: Faces, diameter: float) -> bool:
    """Whether the mesh is one closed body wound outwards as it is: the usual case, told in a second for 1 M faces."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    count = len(vertices)
    first, second = faces.ravel(), faces[:, [1, 2, 0]].ravel()
    there, back = np.sort(first * count + second), np.sort(second * count + first)
    # every directed edge once, and each with its reverse: closed, and neighbours wound alike
    if (there[1:] == there[:-1]).any() or not np.array_equal(there, back):
        return False
    local = vertices - vertices.mean(axis=0)
    corner, one, other = (local[faces[:, i]] for i in range(3))
    one -= corner
    other -= corner
    cross = np.cross(one, other)
    area = np.sqrt(np.einsum("ni,ni->n", cross, cross))
    longest = np.sqrt(np.maximum(np.einsum("ni,ni->n", one, one), np.einsum("ni,ni->n", other, other)))
    if (area <= 1e-12 * diameter * longest).any():
        return False
    if not float(np.einsum("ni,ni->", corner, cross)) / 6 > 1e-9 * diameter**3:
        return False
    graph = coo_array((np.ones(len(first), dtype=np.int8), (first, second)), shape=(count, count)).tocsr()
    return int(connected_components(graph, directed=False, return_labels=False)) == 1


def winding_numbers(vertices: Array, faces: Faces, points: Array) -> Array:
    """Generalised winding number (n,) at points (n, 3): solid angles over 4 pi (van Oosterom & Strackee 1983)."""
    out = np.zeros(len(points))
    for i, point in enumerate(points):
        a, b, c = np.moveaxis(vertices[faces] - point, 1, 0)
        la, lb, lc = (np.linalg.norm(x, axis=1) for x in (a, b, c))
        numerator = np.einsum("ni,ni->n", a, np.cross(b, c))
        denominator = (
            la * lb * lc
            + np.einsum("ni,ni->n", a, b) * lc
            + np.einsum("ni,ni->n", b, c) * la
            + np.einsum("ni,ni->n", c, a) * lb
        )
        out[i] = np.arctan2(numerator, denominator).sum() / (2 * np.pi)
    return out


def _wound_alike(faces: Faces) -> Faces:
    """The triangles turned so that neighbours run through their common edge in opposite directions.

    Walks over each connected part from its first triangle; a part that is inside out as a whole stays so.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import breadth_first_order, connected_components

    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    owner = np.tile(np.arange(len(faces)), 3)
    _, number = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True)
    order = np.argsort(number.ravel(), kind="stable")
    number = number.ravel()[order]
    pair = np.flatnonzero(number[:-1] == number[1:])
    a, b = order[pair], order[pair + 1]
    alike = edges[a, 0] == edges[b, 0]  # the same direction through a common edge: one of the two must turn
    count = len(faces)
    graph = coo_array((np.where(alike, 2, 1), (owner[a], owner[b])), shape=(count, count)).tocsr()
    graph = graph.maximum(graph.T)
    turn = np.zeros(count, dtype=bool)
    _, part = connected_components(graph, directed=False)
    for first in np.unique(part, return_index=True)[1]:
        walk, before = breadth_first_order(graph, first, directed=False)
        for face in walk[1:]:
            turn[face] = turn[before[face]] ^ (graph[before[face], face] == 2)
    out = faces.copy()
    out[turn] = out[turn][:, ::-1]
    return out


def _encloses(mesh: trimesh.Trimesh, largest_leak: float) -> bool:
    """Whether the surface has no gap although edges are not shared: winding numbers beside it are whole.

    Looked at beside the whole surface and beside the edges that one triangle has alone, where a hole would be.
    """
    rng = np.random.default_rng(0)
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    count = int(np.clip(4_000_000 // len(faces), 60, 600))
    corners = mesh.triangles[rng.choice(len(faces), size=count, p=mesh.area_faces / mesh.area_faces.sum())]
    points = np.einsum("nk,nkd->nd", rng.dirichlet((1, 1, 1), size=count), corners)
    size = np.full(count, 0.01 * np.linalg.norm(np.ptp(vertices, axis=0)))
    ends = vertices[rng.permutation(_boundary_edges(faces))[:count]]
    points = np.concatenate([points, ends.mean(axis=1)])
    size = np.concatenate([size, 0.15 * np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)])
    winding = winding_numbers(vertices, faces, points + rng.normal(size=points.shape) * size[:, None])
    leak = np.abs(winding - np.round(winding))
    return all(np.quantile(part, 0.995) < largest_leak for part in (leak[:count], leak[count:]) if len(part))


def _outermost(body: trimesh.Trimesh, bodies: Sequence[trimesh.Trimesh]) -> bool:
    """Whether no other body's box holds this one (an inner, inverted shell is a cavity, not a mistake)."""
    low, high = body.bounds
    return not any(
        other is not body and (other.bounds[0] <= low).all() and (other.bounds[1] >= high).all() for other in bodies
    )


def _boundary_edges(faces: Faces) -> NDArray[np.int64]:
    """Directed edges (k, 2) that belong to one triangle only."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    key = np.sort(edges, axis=1)
    _, inverse, counts = np.unique(key, axis=0, return_inverse=True, return_counts=True)
    return edges[counts[inverse.ravel()] == 1]


def _loops(following: dict[int, list[int]]) -> Iterator[list[int]]:
    """The simple loops of a boundary: where two holes touch in a vertex they are two, not one figure of eight.

    following: the vertices that come after each vertex; emptied. Open chains give none: the mesh stays open, which the
    caller sees.
    """
    while following:
        path = [next(iter(following))]
        while path[-1] in following:
            current = path[-1]
            onward = following[current].pop()
            if not following[current]:
                del following[current]
            if onward not in path:
                path.append(onward)
                continue
            first = path.index(onward)
            if len(path) - first >= 3:
                yield path[first:]
            path = path[: first + 1]


def _close_holes(vertices: Array, faces: Faces, settings: RepairSettings) -> tuple[Array, Faces, float, float, int]:
    """Close every boundary loop with the patch of least area that spans it.

    Returns also the area of the curved and of the flat patches, and how many there are.
    """
    boundary = _boundary_edges(faces)
    following: dict[int, list[int]] = {}
    for a, b in boundary:
        following.setdefault(int(b), []).append(int(a))  # reversed: the patch runs against its neighbours
    new_vertices, new_faces, curved, flat, holes = [vertices], [faces], 0.0, 0.0, 0
    count, whole = len(vertices), len(vertices)
    edges = np.unique(_edge_numbers(faces, whole))
    for loop in _loops(following):
        ring, numbers = vertices[loop], np.asarray(loop, dtype=np.int64)
        holes += 1
        sizes = np.linalg.svd(ring - ring.mean(axis=0), compute_uv=False)
        patch = np.zeros((max(len(loop) - 2, 0), 3), dtype=np.int64)
        # a chord that is an edge of the mesh would have four sides
        if len(loop) > settings.longest_rim or not surface_kernels.least_patch(
            ring, _are_edges(numbers, edges, whole), 1e-9 * float(sizes[0]) ** 2 / len(loop), patch
        ):
            ring, numbers = np.concatenate([ring, ring.mean(axis=0)[None]]), np.append(numbers, count)
            new_vertices.append(ring[-1:])
            count += 1
            patch = np.array([[n, (n + 1) % len(loop), len(loop)] for n in range(len(loop))])
        new_faces.append(numbers[patch])
        corner, one, other = np.moveaxis(ring[patch], 1, 0)
        area = 0.5 * float(np.linalg.norm(np.cross(one - corner, other - corner), axis=1).sum())
        if sizes[-1] <= settings.flat_share * sizes[0]:
            flat += area
        else:
            curved += area
    return np.concatenate(new_vertices), np.concatenate(new_faces), curved, flat, holes


def _edge_numbers(faces: Faces, count: int) -> NDArray[np.int64]:
    """(3 m,) a number for each edge of faces (m, 3), the same both ways, of `count` vertices."""
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    return np.asarray(edges[:, 0] * count + edges[:, 1])


def _are_edges(rim: NDArray[np.int64], edges: NDArray[np.int64], count: int) -> NDArray[np.bool_]:
    """(n, n) whether two corners of a rim (n,) are the ends of one of the edges, by number; see `_edge_numbers`."""
    chords = np.minimum(rim, rim[:, None]) * count + np.maximum(rim, rim[:, None])
    return np.isin(chords, edges)
