"""Objects of 5 mm to 2 m, meshes with every defect, and the borders of the distance lattice. Metres."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cases.registry import Cases, apart, at_most, is_sound, need, refuses, survives
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Contacts
from scenes.synthesis import library

Array = NDArray[np.float64]
Faces = NDArray[np.int64]
Mesh = tuple[Array, Faces]

CASES = Cases()

# Diameters (m) that are just inside what a hand can meet, and in between; and those just outside.
SIZES = (0.00501, 0.01, 0.05, 0.3, 1.0, 1.999)
REFUSED = (1e-12, 0.00499, 2.001, 170.0, 1e12)


@cache
def _bent() -> ObjectModel:
    return library.make("l_block")


@cache
def sized(diameter: float) -> ObjectModel:
    """The bent block at that size."""
    model = _bent()
    return ObjectModel.from_mesh(model.vertices * (diameter / model.diameter), model.faces, f"block {diameter} m")


@CASES("sizes", "error of the pose, share of the diameter", over=SIZES)
def touch_finds_an_object_of(diameter: float) -> float:
    """Contacts whose noise is in proportion: the answer is as good at every size."""
    from touch.localization import localize

    model = sized(diameter)
    rng = np.random.default_rng(0)
    sigma = 0.003 * diameter
    truth = se3.make_pose(se3.random_rotations(1, rng)[0], [0.1, 0.0, 0.4])
    points, normals = model.sample_surface(25, seed=4)
    contacts = Contacts(points + rng.normal(size=points.shape) * sigma, normals, sigma, 0.05).moved(truth)
    found = localize(model, contacts, seed=0)
    is_sound(found)
    turn, move = apart(model, found.pose, truth)
    at_most(turn, 0.05, "rotation")
    return at_most(move / diameter, 0.01, "displacement")


@CASES("sizes", "worst error of the distance, share of the diameter", over=SIZES)
def the_lattice_of_an_object_of(diameter: float) -> float:
    """Distances near the surface are those of the mesh to a thousandth of its size."""
    model = sized(diameter)
    points = model.sample_surface(1000, seed=1)[0] + np.random.default_rng(1).normal(size=(1000, 3)) * 0.02 * diameter
    error = model.field.distance(points) - model.surface.closest(points)[0]
    return at_most(float(np.sqrt(np.mean(error**2))) / diameter, 1.5e-3, "RMS error")


@CASES("sizes", "", over=REFUSED)
def impossible_size(diameter: float) -> float:
    """Refused with the size and, where one is likely, the unit."""
    return refuses(lambda: sized(diameter), f"{diameter} m", ("expected", "m"))


@CASES("sizes", "")
def likely_units_are_named() -> float:
    """A mug of 95 units is millimetres, one of 0.000095 m was scaled twice."""
    model = _bent()
    refuses(lambda: ObjectModel.from_mesh(model.vertices * 1e3, model.faces), "millimetres", ("mm",))
    return refuses(lambda: ObjectModel.from_mesh(model.vertices * 1e-3, model.faces), "scaled twice", ("unit",))


# ---- meshes as they come


def _box(half: Array, middle: Array | None = None) -> Mesh:
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float64) * half
    corners_of = ["013", "032", "467", "475", "045", "051", "237", "276", "026", "064", "157", "173"]
    faces = np.array([[int(digit) for digit in triangle] for triangle in corners_of], dtype=np.int64)
    return corners + (0.0 if middle is None else middle), faces


def _together(*meshes: Mesh) -> Mesh:
    vertices, faces, count = [], [], 0
    for points, triangles in meshes:
        vertices.append(points)
        faces.append(triangles + count)
        count += len(points)
    return np.concatenate(vertices), np.concatenate(faces)


def _repeated() -> Mesh:
    """Every triangle with corners of its own, as STL has them, and some triangles twice."""
    model = _bent()
    faces = np.concatenate([model.faces, model.faces[:5]])
    return model.vertices[faces].reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3)


def _rounded_off() -> Mesh:
    """Corners that differ by single precision's last digit."""
    vertices, faces = _repeated()
    return vertices * (1 + np.random.default_rng(0).uniform(-6e-8, 6e-8, vertices.shape)), faces


def _inverted() -> Mesh:
    model = _bent()
    return model.vertices, model.faces[:, ::-1]


def _half_inverted() -> Mesh:
    model = _bent()
    faces = model.faces.copy()
    faces[::2] = faces[::2, ::-1]
    return model.vertices, faces


def _without_area() -> Mesh:
    """Triangles of one point, of two, and of three on a line."""
    model = _bent()
    faces = model.faces
    middle = model.vertices[faces[0, :2]].mean(axis=0)
    extra = [
        [faces[0, 0]] * 3,
        [faces[1, 0], faces[1, 0], faces[1, 1]],
        [faces[0, 0], len(model.vertices), faces[0, 1]],
    ]
    return np.concatenate([model.vertices, middle[None]]), np.concatenate([faces, np.array(extra)])


def _punctured() -> Mesh:
    """One triangle missing on a fine mesh."""
    vertices, faces = _fine()
    return vertices, np.delete(faces, 17, axis=0)


def _fine() -> Mesh:
    import trimesh

    mesh = trimesh.Trimesh(_bent().vertices, _bent().faces, process=False)
    for _ in range(2):
        mesh = mesh.subdivide()
    return np.array(mesh.vertices), np.array(mesh.faces)


def _strangers() -> Mesh:
    """Vertices that no triangle names, not finite ones among them."""
    model = _bent()
    return np.concatenate([model.vertices, [[9.0, 9.0, 9.0], [np.nan, 0.0, np.inf]]]), model.faces


def _needles() -> Mesh:
    """A triangle cut into slivers a nanometre wide."""
    model = _bent()
    a, b, c = model.faces[0]
    first, count = model.vertices[a], len(model.vertices)
    near = first + 1e-9 * (model.vertices[b] - first) / np.linalg.norm(model.vertices[b] - first)
    faces = np.concatenate([model.faces[1:], [[count, b, c], [a, count, c]]])
    return np.concatenate([model.vertices, near[None]]), faces


def _renumbered() -> Mesh:
    model = _bent()
    order = np.random.default_rng(3).permutation(len(model.vertices))
    place = np.zeros(len(order), dtype=np.int64)
    place[order] = np.arange(len(order))
    return model.vertices[order], place[model.faces][np.random.default_rng(4).permutation(len(model.faces))]


SAME = {
    "duplicate vertices": _repeated,
    "vertices apart by round-off": _rounded_off,
    "inside out": _inverted,
    "half of it inside out": _half_inverted,
    "triangles without area": _without_area,
    "one triangle missing": _punctured,
    "unused vertices": _strangers,
    "slivers": _needles,
    "another order": _renumbered,
    "16 times finer": _fine,
}


@CASES("meshes", "worst difference of the distance, m", over=tuple(SAME))
def mended(what: str) -> float:
    """A mesh that looks like the block is the block: volume, signs, distances, and where it is found."""
    good = _bent()
    vertices, faces = SAME[what]()
    model = survives(lambda: ObjectModel.from_mesh(vertices, faces, what), what)
    need(model is not None, f"{what}: refused")
    at_most(abs(model.volume / good.volume - 1), 1e-3, "volume")
    at_most(abs(model.diameter - good.diameter), 1e-6, "diameter")
    return _same_distances(model, good.surface.closest)


def _same_distances(model: ObjectModel, exact: Callable[[Array], tuple[Array, Array, Array]]) -> float:
    surface = model.sample_surface(1500, seed=2)[0]
    far = surface + np.random.default_rng(2).normal(size=(1500, 3)) * 0.01
    at_most(np.abs(model.surface.closest(far)[0] - exact(far)[0]), 1e-5, "exact distance")
    points = surface + np.random.default_rng(3).normal(size=(1500, 3)) * 0.002
    expected = exact(points)[0]
    found = model.field.distance(points)
    clear = np.abs(expected) > model.field.spacing
    need((np.sign(found) == np.sign(expected))[clear].all(), "sign of a distance")
    return at_most(np.abs(found - expected), 1.0 * model.field.spacing, "distance")


@CASES("meshes", "worst distance where it should be inside, m")
def two_bodies() -> float:
    """Two boxes apart are one object of two bodies, both solid."""
    half = np.array([0.03, 0.02, 0.01])
    model = ObjectModel.from_mesh(*_together(_box(half), _box(half, np.array([0.09, 0.0, 0.0]))), "two")
    at_most(abs(model.volume - 2 * 8 * np.prod(half)), 1e-9, "volume")
    inside = np.array([[0.0, 0, 0], [0.09, 0, 0]])
    need(model.field.distance(np.array([[0.045, 0, 0]]))[0] > 0.01, "between them is outside")
    at_most(np.abs(model.centroid - [0.045, 0, 0]), 1e-9, "centroid")
    return at_most(model.field.distance(inside), -0.008, "inside of both")


@CASES("meshes", "worst distance where it should be inside, m")
def bodies_that_cut_one_another() -> float:
    """Two boxes through one another: the common part is inside, neither hole nor outside."""
    half = np.array([0.03, 0.02, 0.01])
    model = survives(
        lambda: ObjectModel.from_mesh(
            *_together(_box(half), _box(half[[1, 0, 2]], np.array([0.01, 0, 0.002]))), "cross"
        ),
        "cross",
    )
    need(model is not None, "two closed bodies refused")
    inside = np.array([[0.0, 0, 0], [0.025, 0, 0], [0.01, 0.025, 0.002], [0.01, 0.0, 0.001]])
    worst = at_most(model.field.distance(inside), -0.002, "inside")
    need((model.field.distance(np.array([[0.06, 0, 0], [0, 0.06, 0], [0, 0, 0.03]])) > 0.01).all(), "outside")
    return worst


@CASES("meshes", "worst distance in the cavity, m")
def a_cavity_is_outside() -> float:
    """A closed shell inside, wound inwards."""
    vertices, faces = _box(np.array([0.02, 0.02, 0.02]))
    model = ObjectModel.from_mesh(*_together(_box(np.array([0.04, 0.04, 0.04])), (vertices, faces[:, ::-1])), "shell")
    need(model.field.distance(np.array([[0.03, 0, 0]]))[0] < -0.008, "the wall is inside")
    return at_most(-model.field.distance(np.zeros((1, 3))), -0.018, "the cavity is outside")


@CASES("meshes", "")
def hopeless_meshes_are_refused() -> float:
    """No triangle, open, flat, not finite, out of range, of no volume: one line each, no crash and no lattice."""
    vertices, faces = _box(np.array([0.03, 0.02, 0.01]))
    flat = vertices * [1.0, 1.0, 0.0]
    infinite = vertices.copy()
    infinite[3, 1] = np.inf
    huge = vertices.copy()
    huge[3, 1] = 1e308
    bad: dict[str, tuple[Any, Any]] = {
        "nothing": (np.zeros((0, 3)), np.zeros((0, 3), dtype=int)),
        "no triangle": (vertices, np.zeros((0, 3), dtype=int)),
        "half of a box": (vertices, faces[:6]),
        "one triangle": (vertices, faces[:1]),
        "flat": (flat, faces),
        "a line": (vertices * [1.0, 0.0, 0.0], faces),
        "a point": (vertices * 0.0, faces),
        "infinite": (infinite, faces),
        "NaN": (vertices * np.nan, faces),
        "1e308": (huge, faces),
        "denormal": (vertices * 1e-310, faces),
        "index too large": (vertices, faces + 1),
        "index below 0": (vertices, faces - 1),
        "quads": (vertices, np.zeros((2, 4), dtype=int)),
        "two coordinates": (vertices[:, :2], faces),
        "text": ([["a", "b", "c"]], faces),
        "fractions of an index": (vertices, faces + 0.5),
        "indices that are not numbers": (vertices, faces * np.nan),
    }
    for what, (points, triangles) in bad.items():
        refuses(partial(ObjectModel.from_mesh, points, triangles, what), what)
    return 0.0


@CASES("meshes", "difference of the distance, m", slow=True)
def a_million_faces() -> float:
    """A ball of 10^6 triangles is checked, given a lattice and found."""
    import trimesh

    from touch.localization import localize

    ball = trimesh.creation.icosphere(subdivisions=8, radius=0.05)
    vertices = np.array(ball.vertices) * [1.0, 0.8, 0.6]
    faces = np.array(ball.faces)
    faces = np.concatenate([faces, np.zeros((0, 3), dtype=faces.dtype)])
    need(len(faces) > 1_000_000, "as many faces as promised")
    model = ObjectModel.from_mesh(vertices, faces, "egg")
    contacts = Contacts(*model.sample_surface(30, seed=0), 1e-3, 0.1)
    is_sound(localize(model, contacts, seed=0))
    points = model.sample_surface(500, seed=2)[0] + np.random.default_rng(2).normal(size=(500, 3)) * 0.005
    return at_most(np.abs(model.field.distance(points) - model.surface.closest(points)[0]), 3e-4, "distance")


# ---- borders of the lattice


@CASES("lattice", "worst jump of the distance, m")
def across_every_border() -> float:
    """Along lines through nodes, faces, edges and corners of the box: no jump, no NaN, whatever the distance."""
    field = _bent().field
    shape = np.array(field.values.shape)
    ends = np.array([np.zeros(3), shape - 1.0, 0.5 * (shape - 1), np.floor(0.5 * shape)])
    rng = np.random.default_rng(0)
    worst = 0.0
    for at in ends[[0, 1, 2, 3]]:
        for direction in np.concatenate([np.eye(3), -np.eye(3), se3.random_unit_vectors(6, rng)]):
            for step in (0.0, 1e-15, 1e-12, 1e-9, 1e-6, 1e-4, 1e-3):
                points = field.origin + field.spacing * np.array([at - step * direction, at, at + step * direction])
                distance, gradient = field.distance_and_gradient(points)
                need(np.isfinite(distance).all() and np.isfinite(gradient).all(), f"at {at}")
                at_most(np.linalg.norm(gradient, axis=1), 2.0, "gradient")
                jump = np.abs(np.diff(distance)).max() - 2.0 * step * field.spacing
                worst = max(worst, at_most(max(0.0, jump), 5e-4 * field.spacing, f"jump at {at}"))
    return worst


@CASES("lattice", "worst error of the distance, share of the distance")
def far_outside() -> float:
    """Up to 10^5 km away the distance is that to the object, and the gradient points away from it."""
    model = _bent()
    directions = se3.random_unit_vectors(50, np.random.default_rng(1))
    worst = 0.0
    for away in (1.0, 1e3, 1e6, 1e8):
        distance, gradient = model.field.distance_and_gradient(model.centroid + away * directions)
        need(bool((np.einsum("ni,ni->n", gradient, directions) > 0.9).all()), f"gradient {away} m away")
        worst = max(worst, at_most(np.abs(distance - away) / away, 0.1, f"{away} m away"))
    return worst


@CASES("lattice", "smallest normal's length")
def normals_at_every_node_and_border() -> float:
    """Unit normals at nodes, at the border, outside, on the medial axis: finite, never longer than 1."""
    model = _bent()
    field = model.field
    shape = np.array(field.values.shape)
    rng = np.random.default_rng(2)
    nodes = field.origin + field.spacing * rng.integers(0, shape, size=(300, 3))
    outside = model.centroid + 10 * se3.random_unit_vectors(50, rng)
    normals = field.normals(np.concatenate([nodes, outside, model.centroid[None]]))
    need(np.isfinite(normals).all(), "not finite")
    at_most(np.linalg.norm(normals, axis=1), 1 + 1e-9, "length")
    return float(np.linalg.norm(normals, axis=1).min())


@CASES("lattice", "")
def points_that_are_no_points() -> float:
    """NaN and infinity are refused at the door of the compiled look-ups; so are points of the wrong shape."""
    field = _bent().field
    for value in (np.nan, np.inf, -np.inf):
        points = np.zeros((3, 3))
        points[1, 2] = value
        refuses(partial(field.distance, points), str(value))
        refuses(partial(field.distance_and_gradient, points), str(value))
        refuses(partial(field.normals, points), str(value))
    refuses(lambda: field.distance(np.zeros((3, 2))), "two coordinates")
    need(field.distance(np.zeros((0, 3))).shape == (0,), "no points, no distances")
    return 0.0


@CASES("lattice", "")
def numbers_too_large_to_square() -> float:
    """1e155 m and beyond cannot be a place: a finite distance or a refusal, not a NaN."""
    field = _bent().field
    for value in (1e90, 1e155, 1e200, 1e308):
        found = survives(partial(field.distance_and_gradient, np.full((1, 3), value)), f"{value}")
        if found is not None:
            need(np.isfinite(found[0]).all() and np.isfinite(found[1]).all(), f"{value}: not finite")
    return 0.0
