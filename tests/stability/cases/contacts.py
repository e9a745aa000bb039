"""Contacts where it hurts: on edges and corners, on the medial axis, 10 cm inside; in one line, one plane, one point.

What the contacts leave free must be free in the covariance, and nothing else. Metres, radians.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from cases.registry import Cases, apart, at_most, is_covariance, is_rigid, is_sound, need
from scenes.evidence.align import AlignSettings, Prior, align, costs, terms
from scenes.evidence.modes import ModeSettings, covariance_of
from scenes.evidence.table import from_contacts
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Contacts, Frame
from scenes.synthesis import library
from touch.localization import localize

Array = NDArray[np.float64]

CASES = Cases()

TRUTH = se3.make_pose(se3.exp_rotation(np.array([0.5, -0.8, 1.1])), [0.2, -0.1, 0.6])
SIGMA = 1e-3


@cache
def _carton() -> ObjectModel:
    return library.make("box")


@cache
def _crate() -> ObjectModel:
    """A crate of half a metre: room for a contact 10 cm inside."""
    carton = _carton()
    return ObjectModel.from_mesh(carton.vertices * [3.0, 4.0, 6.0], carton.faces, "crate")


@cache
def _half() -> Array:
    """Half extents (3,) of the carton, centred on its origin or not."""
    return 0.5 * np.ptp(_carton().vertices, axis=0)


def _middle() -> Array:
    return 0.5 * (_carton().vertices.max(axis=0) + _carton().vertices.min(axis=0))


def _on_edges(model: ObjectModel) -> Contacts:
    """Two contacts on each of five edges of a box, normals halfway between the faces."""
    low, high = model.vertices.min(axis=0), model.vertices.max(axis=0)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    points, normals = [], []
    for along, first, second in ((0, 1, 1), (0, -1, 1), (1, 1, -1), (2, 1, 1), (2, -1, -1)):
        others = [i for i in range(3) if i != along]
        normal = np.zeros(3)
        normal[others] = first / np.sqrt(2), second / np.sqrt(2)
        for share in (-0.5, 0.4):
            point = middle.copy()
            point[along] += share * half[along]
            point[others] += np.array([first, second]) * half[others]
            points.append(point)
            normals.append(normal)
    return Contacts(np.array(points), np.array(normals), SIGMA, 0.1)


def _on_corners(model: ObjectModel) -> Contacts:
    low, high = model.vertices.min(axis=0), model.vertices.max(axis=0)
    signs = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])[:7]
    return Contacts(np.where(signs, high, low), (2.0 * signs - 1) / np.sqrt(3), SIGMA, 0.1)


@CASES("edges and corners", "error of the centroid, m", over=("edges", "corners"))
def contacts_on(where: str) -> float:
    """Every contact on an edge or corner, where there is no normal: found, and not surer than the contacts allow."""
    model = _carton()
    contacts = (_on_edges if where == "edges" else _on_corners)(model).moved(TRUTH)
    found = localize(model, contacts, seed=0)
    is_sound(found)
    spread = np.sqrt(np.diag(found.covariance)[3:])
    need(
        bool((spread > 0.15 * SIGMA).all()), f"claims {1e6 * spread.min():.0f} um from {len(contacts)} contacts of 1 mm"
    )
    # an edge of the lattice is rounded by half a cell
    return at_most(apart(model, found.pose, TRUTH)[1], 2 * SIGMA, "error")


@CASES("edges and corners", "change of the cost per micrometre")
def the_cost_is_smooth_across_an_edge() -> float:
    """Moved over an edge in steps of 1 um, a contact's cost never jumps."""
    model = _carton()
    edge = model.vertices.max(axis=0) - [0.5 * np.ptp(model.vertices[:, 0]), 0, 0]
    worst = 0.0
    for normal in (None, np.array([[0.0, 0.0, 1.0]]), np.array([[0.0, 0.70710678, 0.70710678]])):
        rows = from_contacts(Contacts(edge[None], normal, SIGMA, 0.1))
        steps = np.linspace(-3e-5, 3e-5, 61)
        moved = se3.perturb(np.eye(4), np.stack([0 * steps] * 4 + [steps, 0.3 * steps], axis=1), model.centroid)
        values = costs(model, rows, moved)
        need(np.isfinite(values).all(), "not finite")
        worst = max(worst, at_most(np.abs(np.diff(values)), 0.02, "jump of the cost"))
    return worst


# ---- far inside


@CASES("inside", "contact's distance from the surface, m", over=(0.01, 0.03, 0.06, 0.1))
def every_contact_inside_by(depth: float) -> float:
    """Contacts on one face as deep in the crate as that still find their way out."""
    model = _crate()
    points, normals = model.sample_surface(100, seed=5)
    top = normals[:, 2] > 0.9
    points, normals = points[top], normals[top]
    start = se3.make_pose(translation=[0.0, 0.0, depth])
    rows = from_contacts(Contacts(points, normals, SIGMA, 0.1))
    before = costs(model, rows, start[None])
    found = align(model, rows, start[None], settings=AlignSettings(iterations=100))
    is_rigid(found.poses)
    need(found.costs[0] <= before[0], "the cost rose")
    distance = model.field.distance(se3.apply(se3.inverse(found.poses[0]), points))
    return at_most(np.abs(distance), 2e-3, "left over")


@CASES("inside", "contact's distance from the surface, m")
def one_contact_ten_centimetres_inside() -> float:
    """A single contact, no normal, 10 cm below the face: out it goes."""
    model = _crate()
    top = model.vertices[:, 2].max()
    point = np.array([[0.01, 0.02, top - 0.1]])
    found = align(
        model, from_contacts(Contacts(point, None, SIGMA)), np.eye(4)[None], settings=AlignSettings(iterations=100)
    )
    is_rigid(found.poses)
    return at_most(np.abs(model.field.distance(se3.apply(se3.inverse(found.poses[0]), point))), 1e-3, "left over")


@CASES("inside", "rise of a cost", over=("sphere", "box", "cylinder"))
def starts_on_the_medial_axis_of(name: str) -> float:
    """Contacts on the medial axis, without a gradient of the distance: no cost rises, the search finds."""
    model = library.make(name)
    centre = model.centroid
    worst = 0.0
    for count in (1, 2, 5):
        points = centre + np.linspace(-0.2, 0.2, count)[:, None] * model.radius * np.array([0.0, 0.0, 1.0])
        for normals in (None, np.tile([1.0, 0.0, 0.0], (count, 1))):
            contacts = Contacts(points, normals, SIGMA, 0.1)
            rows = from_contacts(contacts)
            before = costs(model, rows, np.eye(4)[None])
            found = align(model, rows, np.eye(4)[None])
            is_rigid(found.poses)
            need(np.isfinite(found.hessians).all(), "Hessian not finite")
            worst = max(worst, at_most(found.costs - before, 1e-9, "rise of the cost"))
            is_sound(localize(model, contacts, seed=0))
    points, normals = model.sample_surface(12, seed=6)
    answer = localize(model, Contacts(points, normals, SIGMA, 0.1).moved(TRUTH), seed=0)
    at_most(answer.index, 2e-3, "mean distance of contacts on the surface")
    return worst


# ---- too little said


def _flat(count: int) -> Contacts:
    """Contacts on the carton's top face, spread over 3 x 2 cm."""
    rng = np.random.default_rng(0)
    points = _middle() + np.concatenate(
        [rng.uniform(-1, 1, (count, 2)) * [0.03, 0.02], np.full((count, 1), _half()[2])], axis=1
    )
    return Contacts(points, np.tile([0.0, 0.0, 1.0], (count, 1)), SIGMA, 0.1)


def _straight(count: int, normals: bool) -> Contacts:
    """Contacts in a row along x on the top face."""
    points = _middle() + np.stack(
        [np.linspace(-0.03, 0.03, count), np.zeros(count), np.full(count, _half()[2])], axis=1
    )
    return Contacts(points, np.tile([0.0, 0.0, 1.0], (count, 1)) if normals else None, SIGMA, 0.1)


def _one_place(count: int, normals: bool) -> Contacts:
    """The same contact again and again."""
    points = np.tile(_middle() + np.array([0.01, 0.005, _half()[2]]), (count, 1))
    return Contacts(points, np.tile([0.0, 0.0, 1.0], (count, 1)) if normals else None, SIGMA, 0.1)


X, Y, Z = np.eye(3)
# Contacts; what they leave free, as turns about the contacts' middle and moves; and what they hold.
POOR = {
    "coplanar": (_flat(10), [("move", X), ("move", Y), ("turn", Z)], [("move", Z), ("turn", X), ("turn", Y)]),
    "collinear with normals": (
        _straight(8, True),
        [("move", X), ("move", Y), ("turn", Z)],
        [("move", Z), ("turn", X), ("turn", Y)],
    ),
    "collinear": (
        _straight(8, False),
        [("move", X), ("move", Y), ("turn", Z), ("turn", X)],
        [("move", Z), ("turn", Y)],
    ),
    "identical with normals": (
        _one_place(20, True),
        [("move", X), ("move", Y), ("turn", Z)],
        [("move", Z), ("turn", X), ("turn", Y)],
    ),
    "identical": (
        _one_place(20, False),
        [("move", X), ("move", Y), ("turn", X), ("turn", Y), ("turn", Z)],
        [("move", Z)],
    ),
    "one contact": (
        _one_place(1, False),
        [("move", X), ("move", Y), ("turn", X), ("turn", Y), ("turn", Z)],
        [("move", Z)],
    ),
}


def _direction(model: ObjectModel, contacts: Contacts, kind: str, axis: Array) -> Array:
    """(6,) of the chart of poses.perturb: a move along the axis, or a turn about it through the contacts' middle."""
    if kind == "move":
        return np.concatenate([np.zeros(3), axis])
    return np.concatenate([axis, np.cross(axis, model.centroid - contacts.points.mean(axis=0))])


@CASES("poor contacts", "least share of the full width in a free direction", over=tuple(POOR))
def what_is_free_is_wide(what: str) -> float:
    """The covariance at the truth is as wide as can be where contacts say nothing, and narrow where they do."""
    model = _carton()
    contacts, free, held = POOR[what]
    hessian = terms(model, from_contacts(contacts), np.eye(4))[2]
    covariance = covariance_of(model, hessian)
    is_covariance(covariance)
    settings = ModeSettings()
    widths = np.array([settings.widest_angle] * 3 + [settings.widest_share * model.radius] * 3)
    least = np.inf
    for kind, axis in free:
        # by how much the pose may go along v: (v' C^-1 v)^-1/2, beside what it would be without any contact
        v = _direction(model, contacts, kind, axis)
        without = np.sqrt(1.0 / (v / widths**2 @ v))
        with_contacts = np.sqrt(1.0 / (v @ np.linalg.solve(covariance, v)))
        least = min(least, float(with_contacts / without))
    need(least > 0.5, f"{what}: a free direction has {least:.3f} of its width")
    for kind, axis in held:
        v = _direction(model, contacts, kind, axis)
        width = 1.0 / np.sqrt(v @ np.linalg.solve(covariance, v))
        limit = 0.3 if kind == "turn" else 2 * SIGMA
        at_most(width, limit, f"{what}: {kind} {axis}")
    return least


@CASES("poor contacts", "index, m", over=tuple(POOR))
def touch_does_not_claim_more_than(what: str) -> float:
    """Localize and estimate: sound, the contacts met, and never "ok"."""
    from fusion.estimation.estimate import estimate

    model = _carton()
    contacts = POOR[what][0].moved(TRUTH)
    found = localize(model, contacts, seed=0)
    is_sound(found, "localize")
    need(found.verdict == "ambiguous", f"localize is {found.verdict} from {what} contacts")
    answer = estimate(Frame(0, contacts=contacts), model)
    is_sound(answer, "estimate")
    need(answer.verdict != "ok", f"estimate is ok from {what} contacts")
    need(len(answer.unobservable) > 0 or len(answer.modes) > 1, "nothing said of what is not known")
    return at_most(found.index, SIGMA, "index")


@CASES("poor contacts", "width of the turn, rad", over=("cylinder", "bottle", "sphere"))
def symmetric_object(name: str) -> float:
    """Contacts all around: the turn about the axis is named as unknown, the verdict is about the rest."""
    from fusion.estimation.estimate import estimate

    model = library.make(name)
    contacts = Contacts(*model.sample_surface(25, seed=1), SIGMA, 0.1).moved(TRUTH)
    answer = estimate(Frame(0, contacts=contacts), model)
    is_sound(answer)
    need(answer.verdict == "ok", f"verdict {answer.verdict}")
    named = [text for text in answer.unobservable if text.startswith("rotation about")]
    need(len(named) == (3 if model.symmetries.is_spherical else 1), f"unobservable: {answer.unobservable}")
    at_most(apart(model, answer.pose, TRUTH)[1], 2e-3, "displacement")
    if model.symmetries.is_spherical:
        return np.inf
    axis = TRUTH[:3, :3] @ (model.symmetries.axes[0].direction if model.symmetries.axes else Z)
    turn = np.concatenate([axis, np.zeros(3)])
    width = float(np.sqrt(turn @ answer.covariance @ turn))
    need(width > 0.2, f"the turn about the axis is said to be known to {width:.3g} rad")
    return width


@CASES("poor contacts", "error of the held direction, m")
def a_prior_fills_what_contacts_leave_open() -> float:
    """One face touched and a prior: the face decides along its normal, the prior across, and the answer is one."""
    model = _carton()
    contacts = _flat(10)
    prior = Prior.isotropic(
        se3.perturb(np.eye(4), [0.01, 0.0, 0.02, 0.004, -0.003, 0.006], model.centroid), 0.05, 0.005
    )
    found = localize(model, contacts, seed=0, prior=prior)
    is_sound(found)
    need(found.verdict == "ok", f"verdict {found.verdict}")
    delta = se3.difference(found.pose, np.eye(4), model.centroid)
    spread = np.sqrt(np.diag(found.covariance))
    need(0.003 < spread[3] < 0.006 and spread[5] < 1e-3, f"standard deviations {1e3 * spread[3:]} mm")
    at_most(np.abs(delta[3:5] - [0.004, -0.003]), 2e-3, "across: the prior's")
    return at_most(abs(delta[5]), 1e-3, "along the normal: the contacts'")
