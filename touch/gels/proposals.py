"""Poses from the shape of a patch: where on the object does the surface bend like what the gel felt?

T1 chapter 5 compares the covariance of the felt points with that of the object's points in the sensing box. With
hundreds of points and a normal the second moments say more when they are written as a height over the tangent plane:
h(x, y) = a x^2 + b x y + c y^2 over a box of the patch's own size. Its eigenvalues are the bending along two principal
directions (0, 0: a plane; one large: an edge; both large: a corner or a ball), which no turn changes, and their axes
fix the turn about the normal up to half a turn. Each place of the object with like bending is one
proposal, or two; where the patch is round, turns are tried all around. Metres.
"""

from __future__ import annotations

from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from touch.gels.patches import Patch

Array = NDArray[np.float64]


@dataclass(frozen=True)
class GelProposalSettings:
    """How places are compared. Values by judgement."""

    # Places of the object that are described, and points its surface is sampled with.
    places: int = 1500
    samples: int = 40_000
    # Radii (m) of the boxes that are described; a patch is compared with the nearest one below its own size.
    boxes: tuple[float, ...] = (0.002, 0.004, 0.0065)
    # Error of a bending (1/m) beside a tenth of its own size: 0.3 mm over the box's half width.
    bend_sigma: float = 0.0003
    # Bends that differ by less than this (1/m, over the smallest box) have no direction.
    round_below: float = 12.0
    # Turns tried about the normal of a round patch, and proposals of one patch.
    turns: int = 12
    most: int = 2000


@dataclass(frozen=True)
class Bending:
    """points (n, 3); frames (n, 3, 3): columns the principal directions and the outward normal; bends (n, 2) 1/m,
    larger first, positive where the object bulges out.
    """

    points: Array
    frames: Array
    bends: Array


_TABLES: WeakKeyDictionary[ObjectModel, dict[tuple[float, GelProposalSettings], Bending]] = WeakKeyDictionary()


def bending_table(model: ObjectModel, box: float, settings: GelProposalSettings | None = None) -> Bending:
    """How the object's surface bends at many places, within `box` (m); built at the first call and kept."""
    settings = settings or GelProposalSettings()
    kept = _TABLES.setdefault(model, {})
    if (box, settings) not in kept:
        kept[box, settings] = _describe(model, box, settings)
    return kept[box, settings]


def _describe(model: ObjectModel, box: float, settings: GelProposalSettings) -> Bending:
    from scipy.spatial import cKDTree

    points, normals = model.sample_surface(settings.samples, seed=3)
    places = points[: settings.places]
    near = cKDTree(points).query_ball_point(places, box)
    out = np.zeros((len(places), 3)), np.zeros((len(places), 3, 3)), np.zeros((len(places), 2))
    good = np.zeros(len(places), dtype=bool)
    for number, (index, own) in enumerate(zip(near, normals)):
        # a thin wall's other side is no neighbour
        index = np.array(index)[normals[index] @ own > -0.2]
        if len(index) < 8:
            continue
        fitted = bend_of(points[index], normals[index])
        if fitted is not None:
            out[0][number], out[1][number], out[2][number] = fitted
            good[number] = True
    return Bending(out[0][good], out[1][good], out[2][good])


def bend_of(points: Array, normals: Array) -> tuple[Array, Array, Array] | None:
    """Middle (3,) on the surface, frame (3, 3) and bends (2,) of oriented points (n, 3); None where they are a line."""
    axis = normals.sum(axis=0)
    length = float(np.linalg.norm(axis))
    if length < 0.2 * len(normals):
        return None
    axis = axis / length
    side = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    side /= np.linalg.norm(side)
    basis = np.stack([side, np.cross(axis, side), axis], axis=1)
    middle = points.mean(axis=0)
    local = (points - middle) @ basis
    x, y, z = local.T
    size = float(np.sqrt((x * x + y * y).mean()))
    if size < 1e-6:
        return None
    x, y = x / size, y / size
    design = np.stack([x * x, x * y, y * y, x, y, np.ones_like(x)], axis=1)
    gram = design.T @ design + 1e-3 * len(x) * np.diag([1.0, 1.0, 1.0, 0.1, 0.1, 0.0])
    a, b, c, p, q, r = np.linalg.solve(gram + 1e-9 * len(x) * np.eye(6), design.T @ z)
    # out of the object is up: a bulge falls off to its sides
    values, vectors = np.linalg.eigh(-2.0 / size**2 * np.array([[a, 0.5 * b], [0.5 * b, c]]))
    normal = basis @ np.array([-p / size, -q / size, 1.0])
    normal /= np.linalg.norm(normal)
    first = basis[:, :2] @ vectors[:, 1]
    first = first - (first @ normal) * normal
    first /= max(float(np.linalg.norm(first)), 1e-12)
    frame = np.stack([first, np.cross(normal, first), normal], axis=1)
    return middle + r * axis, frame, values[::-1]


def propose(model: ObjectModel, patch: Patch, settings: GelProposalSettings | None = None) -> Array:
    """(n, 4, 4) frame_from_object that lay like-bent places of the object onto the patch, the most alike first."""
    settings = settings or GelProposalSettings()
    if len(patch) < 8:
        return np.zeros((0, 4, 4))
    extent = float(np.sqrt(2.0 * ((patch.points - patch.points.mean(axis=0)) ** 2).sum(axis=1).mean()))
    box = max((b for b in settings.boxes if b <= extent), default=settings.boxes[0])
    near = ((patch.points - patch.middle) ** 2).sum(axis=1) <= box**2
    fitted = bend_of(patch.points[near], patch.normals[near]) if near.sum() >= 8 else None
    if fitted is None:
        return np.zeros((0, 4, 4))
    middle, frame, bends = fitted
    table = bending_table(model, box, settings)
    # of bends h = k x^2 / 2, an error of height over half a box is this error of k; unknown depths blur it further
    sigma = 2.0 * settings.bend_sigma / box**2 + (0.1 if patch.measured else 0.5) * np.abs(bends).max()
    order = np.argsort((((table.bends - bends) / sigma) ** 2).sum(axis=1), kind="stable")
    directed = bends[0] - bends[1] > max(settings.round_below, sigma)
    turns = np.array([0.0, np.pi]) if directed else 2 * np.pi * np.arange(settings.turns) / settings.turns
    order = order[: max(1, settings.most // len(turns))]
    rotations, places = [], []
    for turn in turns:
        c, s = np.cos(turn), np.sin(turn)
        about = frame @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        rotation = about @ np.swapaxes(table.frames[order], 1, 2)
        rotations.append(rotation)
        places.append(middle - np.einsum("nij,nj->ni", rotation, table.points[order]))
    return se3.make_poses(np.concatenate(rotations), np.concatenate(places))
