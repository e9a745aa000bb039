"""From a mesh as found to one with an inside: merged, closed, wound outwards; or a refusal with its reason."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenes.errors import MeshError

Array = NDArray[np.float64]
Faces = NDArray[np.int64]


@dataclass(frozen=True)
class RepairSettings:
    """What may be mended silently and what is refused."""

    # Vertices nearer than this share of the diameter are one vertex (export round-off).
    merge_share: float = 1e-6
    # Curved holes are closed by fans as long as the patches stay below this share of the surface: beyond, the shape
    # would be an invention. A flat rim has one obvious lid, so those may be larger (a box modelled without its ends).
    max_patch_share: float = 0.1
    max_lid_share: float = 0.4
    # A rim is flat when it leaves its plane by less than this share of its own size.
    flat_share: float = 0.02
    # Where triangles meet without sharing vertices nothing leaks: winding numbers stay this near whole numbers.
    largest_leak: float = 0.02


def close(
    vertices: Array, faces: Faces, name: str, settings: RepairSettings | None = None
) -> tuple[Array, Faces, list[str]]:
    """Make a mesh closed and outwards wound.

    vertices (n, 3) any unit, faces (m, 3). Returns vertices, faces and what was mended, in words.
    Raises MeshError for no faces, not finite, flat, or open beyond the settings.
    """
    import trimesh

    settings = settings or RepairSettings()
    vertices = np.asarray(vertices, dtype=np.float64).reshape(-1, 3)
    faces = np.asarray(faces, dtype=np.int64).reshape(-1, 3)
    if len(faces) == 0:
        raise MeshError(f"{name}: expected a mesh with triangles, got {len(vertices)} vertices and no triangle")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise MeshError(f"{name}: expected vertex numbers 0..{len(vertices) - 1}, got {faces.min()}..{faces.max()}")
    used = np.unique(faces)
    if not np.isfinite(vertices[used]).all():
        raise MeshError(f"{name}: expected finite vertices, got NaN or infinity")
    extent = np.ptp(vertices[used], axis=0)
    diameter = float(np.linalg.norm(extent))
    if diameter <= 0 or extent.min() < 1e-5 * diameter:
        raise MeshError(
            f"{name}: expected a solid, got a flat mesh of extent {extent[0]:.3g} x {extent[1]:.3g} x {extent[2]:.3g}"
        )

    mended: list[str] = []
    before = len(faces)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    digits = int(np.clip(np.ceil(-np.log10(settings.merge_share * diameter)), 0, 14))
    mesh.merge_vertices(digits_vertex=digits, merge_tex=True, merge_norm=True)
    mesh.update_faces(mesh.nondegenerate_faces(height=1e-12 * diameter))
    mesh.update_faces(mesh.unique_faces())
    mesh.remove_unreferenced_vertices()
    if len(mesh.faces) == 0:
        raise MeshError(f"{name}: expected a mesh with triangles, got only triangles without area")
    if len(mesh.faces) < before:
        mended.append(f"{before - len(mesh.faces)} empty or repeated triangles removed")
    vertices, faces = np.array(mesh.vertices), np.array(mesh.faces, dtype=np.int64)

    if not mesh.is_winding_consistent:
        trimesh.repair.fix_winding(mesh)
        faces = np.array(mesh.faces, dtype=np.int64)
        mended.append("triangles rewound consistently")
    if not mesh.is_watertight and _encloses(mesh, settings.largest_leak):
        mended.append("edges that meet without sharing their vertices accepted (no gap between them)")
    elif not mesh.is_watertight:
        vertices, faces, patched, lids, holes = _close_holes(vertices, faces, settings.flat_share)
        area = max(float(mesh.area), 1e-300)
        share = (patched + lids) / area
        mesh = trimesh.Trimesh(vertices, faces, process=False)
        if patched > settings.max_patch_share * area or lids > settings.max_lid_share * area or not mesh.is_watertight:
            left = _boundary_edges(faces)
            raise MeshError(
                f"{name}: expected a closed mesh, got {holes} holes of {share:.0%} of its surface"
                f" ({len(left)} edges still open after filling): close it in a mesh editor"
            )
        mended.append(f"{holes} holes filled ({share:.1%} of the surface)")
    if not mesh.is_winding_consistent:
        trimesh.repair.fix_winding(mesh)
    bodies = mesh.split(only_watertight=False) if mesh.body_count > 1 else [mesh]
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


def _encloses(mesh, largest_leak: float) -> bool:
    """Whether the surface has no gap although edges are not shared: winding numbers beside it are whole."""
    rng = np.random.default_rng(0)
    count = int(np.clip(4_000_000 // len(mesh.faces), 60, 600))
    corners = mesh.triangles[rng.choice(len(mesh.faces), size=count, p=mesh.area_faces / mesh.area_faces.sum())]
    points = np.einsum("nk,nkd->nd", rng.dirichlet((1, 1, 1), size=count), corners)
    offsets = rng.normal(size=(count, 3)) * 0.01 * np.linalg.norm(np.ptp(mesh.vertices, axis=0))
    winding = winding_numbers(np.asarray(mesh.vertices), np.asarray(mesh.faces), points + offsets)
    return bool(np.quantile(np.abs(winding - np.round(winding)), 0.995) < largest_leak)


def _outermost(body, bodies) -> bool:
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


def _close_holes(vertices: Array, faces: Faces, flat_share: float) -> tuple[Array, Faces, float, float, int]:
    """Close every boundary loop with a fan about its centre; returns also the curved and flat patches' area, and how many."""
    boundary = _boundary_edges(faces)
    following: dict[int, list[int]] = {}
    for a, b in boundary:
        following.setdefault(int(b), []).append(int(a))  # reversed: the patch runs against its neighbours
    new_vertices, new_faces, curved, flat, holes = [vertices], [faces], 0.0, 0.0, 0
    count = len(vertices)
    while following:
        start = next(iter(following))
        loop, current = [], start
        while current in following:
            loop.append(current)
            onward = following[current].pop()
            if not following[current]:
                del following[current]
            current = onward
            if current == start:
                break
        if current != start or len(loop) < 3:
            continue  # an open chain cannot be closed; the caller sees the mesh is still open
        ring = vertices[loop]
        holes += 1
        centre = ring.mean(axis=0)
        spokes = ring - centre
        area = 0.5 * float(np.linalg.norm(np.cross(spokes, np.roll(spokes, -1, axis=0)), axis=1).sum())
        sizes = np.linalg.svd(spokes, compute_uv=False)
        if sizes[-1] <= flat_share * sizes[0]:
            flat += area
        else:
            curved += area
        if len(loop) == 3:
            fan = np.array([loop])
        else:
            new_vertices.append(centre[None])
            fan = np.array([[a, b, count] for a, b in zip(loop, [*loop[1:], loop[0]])])
            count += 1
        new_faces.append(fan)
    return np.concatenate(new_vertices), np.concatenate(new_faces), curved, flat, holes
