"""Many contacts: a few hundred that constrain the pose are searched with, and all of them settle what was found.

The time of a search grows with its rows, what it needs to know does not: which basin is right, a few hundred contacts
spread over the surface tell. So those are chosen, each worth what it claims and no more, evenly over the places and the
directions that were touched: a thousand contacts at one spot and ten elsewhere keep the ten. The poses found are then
moved by Gauss-Newton steps to the minimum of the cost of all contacts, block by block, so that the answer's covariance
rests on every contact, none counted twice.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenes.evidence.align import Alignment, AlignSettings, Prior, terms
from scenes.evidence.table import NO_GATE, TOUCH, Evidence, empty, make
from scenes.geometry.objects import ObjectModel
from scenes.geometry.poses import perturb
from scenes.recordings.frames import Contacts
from scenes.threads import run_chunks

Array = NDArray[np.float64]

# Contacts whose rows are laid out at a time: 17 numbers each, 5 MB.
BLOCK = 40_000
# Cells a side at most (three times 10 bits), and how much finer the next ones that are tried are.
MOST_PARTS = 1000
FINER = 1.3
# Contacts that tell how fine the cells may be.
COUNTED = 20_000
# Multiples of it fill 0..1 evenly.
GOLDEN = 0.6180339887498949
# Settled when a step would move by less than this in squared standard deviations (a thirtieth of one), and how often a
# step that climbs is halved.
SETTLED = 1e-3
HALVINGS = 4
# A direction with less than this share of the best known one's information (both in units of the object's size) is
# not moved along: rounding.
NO_INFORMATION = 1e-12


def cells_of(contacts: Contacts, most: int) -> NDArray[np.int64]:
    """(n,) number, from 0, of the cell that each contact lies in.

    Cells are cubes of one size, each divided by the normal's strongest axis and its sign; they shrink until there are
    about `most` of them.
    """
    points = contacts.points - contacts.points.min(axis=0)
    side = float(points.max())
    facing = np.zeros(len(contacts), dtype=np.int64)
    known = contacts.has_normal
    normals = contacts.normals[known]
    axis = np.abs(normals).argmax(axis=1)
    facing[known] = 1 + 2 * axis + (np.take_along_axis(normals, axis[:, None], axis=1)[:, 0] > 0)
    # how fine is told by some of them
    some = slice(None, None, max(1, len(contacts) // COUNTED))
    parts = 2
    while parts < MOST_PARTS:
        finer = math.ceil(FINER * parts)
        if len(np.unique(_cells(points[some], facing[some], side, finer))) > most:
            break
        parts = finer
    return np.unique(_cells(points, facing, side, parts), return_inverse=True)[1].astype(np.int64)


def informative(contacts: Contacts, cells: NDArray[np.int64], most: int) -> NDArray[np.intp]:
    """Indices, ascending, of `most` contacts spread over the cells (n,); all of them when there are no more.

    Every cell gives one contact, then a second, until there are enough. Of a cell the surest come first, of those the
    earliest.
    """
    count = len(contacts)
    if count <= most:
        return np.arange(count, dtype=np.intp)
    order = np.lexsort((contacts.sigma_point, cells))
    starts = np.flatnonzero(np.diff(cells[order], prepend=-1))
    sizes = np.diff(starts, append=count)
    rank = np.arange(count) - np.repeat(starts, sizes)
    # where not every cell can give one more, those that do are spread: cells in a row are neighbours
    spread = np.repeat(np.arange(len(starts)) * GOLDEN % 1.0, sizes)
    return np.sort(order[np.lexsort((spread, rank))[:most]])


def _cells(points: Array, facing: NDArray[np.int64], side: float, parts: int) -> NDArray[np.int64]:
    """(n,) which of parts^3 cells over 0..side (m) each point (n, 3) is in, and of those which side it faces."""
    index = np.minimum((points * (parts / max(side, 1e-12))).astype(np.int64), parts - 1)
    return ((index[:, 0] * parts + index[:, 1]) * parts + index[:, 2]) * 7 + facing


@dataclass(frozen=True)
class Whole:
    """The cost of all contacts at a pose. cells (n,): see cells_of. sigma (m): instead of the contacts' own; gate: see
    scenes.evidence.table.
    """

    model: ObjectModel
    contacts: Contacts
    cells: NDArray[np.int64]
    prior: Prior | None
    extra: Evidence | None
    settings: AlignSettings
    sigma: float | None = None
    gate: float = NO_GATE

    def terms(self, pose: Array) -> tuple[float, Array, Array]:
        """Cost, gradient (6,) and Hessian (6, 6): blocks are summed in their order, however many threads."""
        starts = range(0, len(self.contacts), BLOCK)
        parts: list[tuple[float, Array, Array]] = [(0.0, np.zeros(6), np.zeros((6, 6)))] * len(starts)

        def work(some: slice) -> None:
            for k in range(some.start, some.stop):
                rows = self._rows(slice(starts[k], starts[k] + BLOCK))
                parts[k] = terms(self.model, rows, pose, settings=self.settings)

        run_chunks(work, len(starts))
        if self.extra is not None or self.prior is not None:
            rest = self.extra if self.extra is not None else empty()
            parts.append(terms(self.model, rest, pose, self.prior, self.settings))
        cost, gradient, hessian = 0.0, np.zeros(6), np.zeros((6, 6))
        for part in parts:
            cost, gradient, hessian = cost + part[0], gradient + part[1], hessian + part[2]
        return cost, gradient, hessian

    def scatter(self, pose: Array) -> Array:
        """(6, 6) sum over the cells of the outer products of their gradients."""
        order = np.argsort(self.cells, kind="stable")
        ends = np.cumsum(np.bincount(self.cells))
        gradients = np.zeros((len(ends), 6))

        def work(some: slice) -> None:
            for k in range(some.start, some.stop):
                rows = self._rows(order[ends[k - 1] if k else 0 : ends[k]])
                gradients[k] = terms(self.model, rows, pose, settings=self.settings)[1]

        run_chunks(work, len(ends))
        return np.asarray(gradients.T @ gradients)

    def _rows(self, block: slice | NDArray[np.intp]) -> Evidence:
        contacts = self.contacts
        return make(
            contacts.points[block],
            contacts.sigma_point[block] if self.sigma is None else self.sigma,
            TOUCH,
            normals=contacts.normals[block],
            sigma_normal=contacts.sigma_normal[block],
            gate_above=self.gate,
            gate_below=self.gate,
            from_outside=True,
        )

    def settle(self, poses: Array, steps: int) -> Alignment:
        """Every pose (b, 4, 4) moved by at most `steps` Gauss-Newton steps towards the cost's minimum.

        A step that raises the cost is halved; a pose's cost never rises. Hessians are those of the cost, less what the
        contacts of a cell share.
        """
        moved, costs, hessians, used = zip(*(self._settled(pose, steps) for pose in poses))
        told = [self._honest(pose, hessian) for pose, hessian in zip(moved, hessians)]
        return Alignment(np.array(moved), np.array(costs), np.array(told), np.array(used, dtype=np.int64))

    def _honest(self, pose: Array, hessian: Array) -> Array:
        """The information (6, 6) about the pose that the contacts hold, of a Hessian of their cost that takes their
        errors as independent.

        A mesh's or a lattice's error, a rounded edge, is met by every contact of a place alike: many contacts there
        know it well, and the place of the object no better. The covariance of the minimum is H^-1 B H^-1, B the scatter
        of the cells' gradients (Liang and Zeger, Biometrika 73, 1986), which is H^-1 where errors are independent; the
        larger of the two counts, direction by direction.
        """
        unit = np.array([1.0] * 3 + [self.model.radius] * 3)
        values, vectors = np.linalg.eigh(hessian * unit * unit[:, None])
        firm = values > NO_INFORMATION * max(float(values[-1]), 1e-300)
        root = np.where(firm, np.sqrt(np.where(firm, values, 1.0)), 0.0)
        inverse = np.where(firm, 1.0 / np.where(firm, root, 1.0), 0.0)
        scatter = vectors.T @ (self.scatter(pose) * unit * unit[:, None]) @ vectors * inverse * inverse[:, None]
        excess, axes = np.linalg.eigh(0.5 * (scatter + scatter.T))
        kept = (axes / np.maximum(excess, 1.0)) @ axes.T * root * root[:, None]
        return np.asarray(vectors @ kept @ vectors.T / unit / unit[:, None])

    def _settled(self, pose: Array, steps: int) -> tuple[Array, float, Array, int]:
        unit = np.array([1.0] * 3 + [self.model.radius] * 3)
        cost, gradient, hessian = self.terms(pose)
        for used in range(steps):
            values, vectors = np.linalg.eigh(hessian * unit * unit[:, None])
            slope = vectors.T @ (gradient * unit)
            firm = values > NO_INFORMATION * max(float(values[-1]), 1e-300)
            step = -np.where(firm, slope / np.where(firm, values, 1.0), 0.0)
            if not -slope @ step > SETTLED:  # NaN is not above it either
                return pose, cost, hessian, used
            trial = perturb(pose, (vectors @ step) * unit, self.model.centroid)
            new = self.terms(trial)
            for halving in range(1, HALVINGS + 1):
                if new[0] <= cost:
                    break
                trial = perturb(pose, 0.5**halving * (vectors @ step) * unit, self.model.centroid)
                new = self.terms(trial)
            if new[0] > cost:
                return pose, cost, hessian, used
            pose, (cost, gradient, hessian) = trial, new
        return pose, cost, hessian, steps
