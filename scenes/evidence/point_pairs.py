"""Poses from pairs of points with normals: a pair fixes a pose, and an object has few pairs that look like it.

The invariants of a pair of oriented points are those of Drost et al., "Model globally, match locally" (CVPR 2010):
their distance, the normals' slopes along it and towards each other, here with the sign of the twist so that mirror
images are told apart. The pairs of an object are tabled once; the nearest to each pair of contacts, or of pixels,
become hypotheses, which the table of evidence then ranks. Metres; normals point out of the object.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

import numba
import numpy as np
from numpy.typing import NDArray

from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Contacts
from scenes.threads import run_chunks

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

Array = NDArray[np.float64]
# Numbers (n,) of one point and of the other; all pairs by cells, and where those of each cell begin among them.
Pairs = tuple[NDArray[np.int64], NDArray[np.int64]]
Cells = tuple[NDArray[np.int32], NDArray[np.int32]]

# Pairs that are enough for another thread: half a millisecond's.
ENOUGH = 5000


@dataclass(frozen=True)
class PairSettings:
    """How fine the object's table of pairs is. The table is Drost et al.'s (2010); values by judgement."""

    # Oriented points on the surface; the table holds their square.
    points: int = 500
    # Pairs closer than this share of the object's radius fix no rotation.
    shortest: float = 0.15
    # What counts as alike: the distance as a share of the radius, and the normals' slopes (no unit).
    distance_scale: float = 0.12
    slope_scale: float = 0.25
    # Of an image's pairs the nearest are found to this share of their distance: of 250,000 pairs many are as near as
    # noise tells. Those of contacts are few, and found exactly.
    nearly: float = 0.5
    # Pairs that look like one of many of an image's are drawn from a table of cells; its cells, and how far around the
    # pair they are drawn from, in what counts as alike.
    cell: float = 1.0
    around: float = 0.5
    # Pairs of contacts looked up, the farthest apart first.
    pairs: int = 12
    # Contacts that pairs are made of: all of them would be 5e9 pairs of 1e5 contacts.
    most_contacts: int = 300


class PairTable:
    """Every ordered pair of points on an object, by its invariants."""

    def __init__(self, model: ObjectModel, settings: PairSettings | None = None) -> None:
        """Sampled evenly over the surface with a seed of its own: the same object gives the same table."""
        self.settings = settings or PairSettings()
        self.radius = model.radius
        self.points, self.normals = _spread(
            *model.sample_surface(4 * self.settings.points, seed=1), self.settings.points
        )
        first, second = np.nonzero(~np.eye(len(self.points), dtype=bool))
        apart = np.linalg.norm(self.points[first] - self.points[second], axis=1)
        far = apart > self.settings.shortest * self.radius
        self.first, self.second = first[far], second[far]

    @cached_property
    def tree(self) -> cKDTree:
        """Of the invariants of all pairs."""
        from scipy.spatial import cKDTree

        a, b = self.first, self.second
        return cKDTree(self.invariants(self.points[a], self.normals[a], self.points[b], self.normals[b]))

    @cached_property
    def cells(self) -> Cells:
        """The pairs (n,) by cells of their invariants, and where those of each cell begin among them."""
        a, b = self.first, self.second
        known = self.invariants(self.points[a], self.normals[a], self.points[b], self.normals[b])
        keys = np.zeros(len(known), np.int64)
        cell_keys(known / self.settings.cell, keys)
        begin = np.zeros(CELL_KEYS + 1, np.int32)
        begin[1:] = np.cumsum(np.bincount(keys, minlength=CELL_KEYS))
        return np.argsort(keys, kind="stable").astype(np.int32), begin

    def invariants(self, p1: Array, n1: Array, p2: Array, n2: Array) -> Array:
        """(n, 5): distance and slopes of pairs (n, 3), scaled so that 1 is a noticeable difference."""
        between = p2 - p1
        length = np.linalg.norm(between, axis=1)
        along = between / length[:, None]
        slopes = [(n1 * along).sum(1), (n2 * along).sum(1), (n1 * n2).sum(1), (np.cross(n1, n2) * along).sum(1)]
        return np.stack(
            [length / (self.settings.distance_scale * self.radius), *(s / self.settings.slope_scale for s in slopes)], 1
        )

    def hypotheses(self, contacts: Contacts, count: int) -> tuple[Array, Array]:
        """Rotations (h, 3, 3) and the object's origins (h, 3), about `count` of them: the poses that put pairs of the
        object onto pairs of the contacts. None without two contacts that are apart and have normals.
        """
        known = np.flatnonzero(contacts.has_normal)
        p, n = contacts.points, contacts.normals
        # pairs grow with the square of the contacts: of very many, evenly chosen ones do
        most = self.settings.most_contacts
        known = known if len(known) <= most else known[np.linspace(0, len(known) - 1, most).astype(int)]
        one, other = np.triu_indices(len(known), 1)
        lengths = np.linalg.norm(p[known[one]] - p[known[other]], axis=1)
        apart = np.flatnonzero(lengths > self.settings.shortest * self.radius)
        longest = apart[np.argsort(-lengths[apart], kind="stable")[: self.settings.pairs]]
        if not len(longest):
            return np.zeros((0, 3, 3)), np.zeros((0, 3))
        i, j = known[one[longest]], known[other[longest]]
        return self.matching(p, n, i, j, max(1, count // len(longest)), 0.0)

    def matching(
        self,
        points: Array,
        normals: Array,
        first: NDArray[np.int64],
        second: NDArray[np.int64],
        each: int,
        nearly: float | None = None,
    ) -> tuple[Array, Array]:
        """Rotations (h, 3, 3) and the object's origins (h, 3) that put the `each` nearest pairs of the object onto each
        pair first[k], second[k] of points (n, 3) with normals (n, 3) that are apart; those of one pair together.

        nearly: to what share of their distance they are the nearest; None for the settings'.
        """
        invariants = self.invariants(points[first], normals[first], points[second], normals[second])
        nearly = self.settings.nearly if nearly is None else nearly
        _, found = self.tree.query(invariants, k=min(each, len(self.first)), eps=nearly)
        found = found.reshape(len(first), -1)
        repeat = np.repeat(np.arange(len(first)), found.shape[1])
        return self._matched(found.ravel(), points, normals, (first[repeat], second[repeat]))

    def drawn(
        self,
        points: Array,
        normals: Array,
        first: NDArray[np.int64],
        second: NDArray[np.int64],
        each: int,
        rng: np.random.Generator,
    ) -> tuple[Array, Array]:
        """As `matching`, by `each` draws from the pairs of the object that look alike, in a fiftieth of the time: for
        many pairs of an image, which are noisy anyway. A draw that meets no pair of the object gives none.
        """
        s = self.settings
        invariants = self.invariants(points[first], normals[first], points[second], normals[second])
        keys = np.zeros(each * len(first), np.int64)
        cells_around(invariants, s.around, rng.uniform(-1.0, 1.0, (len(keys), 5)), s.cell, keys)
        drawn = np.zeros((2, len(keys)), np.int64)
        which, found = drawn[:, : draw_from_cells(self.cells, keys, rng.random(len(keys)), each, drawn)]
        return self._matched(found, points, normals, (first[which], second[which]))

    def _matched(self, found: NDArray[np.int64], points: Array, normals: Array, onto: Pairs) -> tuple[Array, Array]:
        """Rotations (h, 3, 3) and origins (h, 3) that put the object's pairs found (h,) onto pairs of the points."""
        (a, b), (i, j) = (self.first[found], self.second[found]), onto
        rotations, origins = np.zeros((len(a), 3, 3)), np.zeros((len(a), 3))

        def work(part: slice) -> None:
            pairs = points, normals, i[part], j[part]
            match_pairs(self.points, self.normals, a[part], b[part], *pairs, rotations[part], origins[part])

        run_chunks(work, len(a), smallest=ENOUGH)
        return rotations, origins


def _spread(points: Array, normals: Array, count: int) -> tuple[Array, Array]:
    """`count` of the points (n, 3), far from one another: each next is the farthest from all before."""
    chosen = np.zeros(min(count, len(points)), dtype=np.int64)
    nearest = np.full(len(points), np.inf)
    for k in range(1, len(chosen)):
        nearest = np.minimum(nearest, ((points - points[chosen[k - 1]]) ** 2).sum(axis=1))
        chosen[k] = int(np.argmax(nearest))
    return points[chosen], normals[chosen]


_TABLES: WeakKeyDictionary[ObjectModel, PairTable] = WeakKeyDictionary()


def pair_table(model: ObjectModel) -> PairTable:
    """The object's table, kept as long as the object; what pairs are looked up in is built when it is first asked."""
    table = _TABLES.get(model)
    if table is None:
        table = PairTable(model)
        _TABLES[model] = table
    return table


def built_pair_table(model: ObjectModel) -> PairTable:
    """The same with all that pairs are looked up in, so that no timed search builds it."""
    table = pair_table(model)
    table.tree, table.cells  # noqa: B018
    return table


# Cells along the distance and along each slope: slopes are within 4 of what counts as alike, and draws around them.
_LONGEST, _SLOPES = 40, 12
CELL_KEYS = _LONGEST * _SLOPES**4


@numba.njit(cache=True, nogil=True)
def cell_keys(invariants: Array, keys: NDArray[np.int64]) -> None:
    """Fill keys (n,) with the numbers of the cells, 1 wide, of invariants (n, 5); what is beyond the last is in it."""
    for n in range(invariants.shape[0]):
        key = min(max(int(invariants[n, 0]), 0), _LONGEST - 1)
        for k in range(1, 5):
            key = key * _SLOPES + min(max(math.floor(invariants[n, k]) + _SLOPES // 2, 0), _SLOPES - 1)
        keys[n] = key


@numba.njit(cache=True, nogil=True)
def cells_around(invariants: Array, around: float, drawn: Array, cell: float, keys: NDArray[np.int64]) -> None:
    """Fill keys (n k,) with the numbers of the cells, `cell` wide, of places drawn (n k, 5), from -1 to 1, of `around`
    about each of invariants (n, 5): the first k about the first.
    """
    each = keys.shape[0] // max(invariants.shape[0], 1)
    place, key = np.zeros((1, 5)), np.zeros(1, np.int64)
    for n in range(keys.shape[0]):
        for k in range(5):
            place[0, k] = (invariants[n // each, k] + around * drawn[n, k]) / cell
        cell_keys(place, key)
        keys[n] = key[0]


@numba.njit(cache=True, nogil=True)
def draw_from_cells(cells: Cells, keys: NDArray[np.int64], share: Array, each: int, out: NDArray[np.int64]) -> int:
    """Fill out (2, n k) from the left with places of keys (n k,) whose cells are not empty, by k = `each`, and one of
    the pairs in each, as share (n k,), from 0 to 1, has it; returns how many. cells: see `PairTable.cells`.
    """
    (order, begin), count = cells, 0
    for n in range(keys.shape[0]):
        first = begin[keys[n]]
        held = begin[keys[n] + 1] - first
        if held > 0:
            out[0, count], out[1, count] = n // each, order[first + int(share[n] * held)]
            count += 1
    return count


@numba.njit(cache=True, nogil=True, error_model="numpy")
def match_pairs(
    points: Array,
    normals: Array,
    first: NDArray[np.int64],
    second: NDArray[np.int64],
    contact_points: Array,
    contact_normals: Array,
    contact_first: NDArray[np.int64],
    contact_second: NDArray[np.int64],
    rotations: Array,
    origins: Array,
) -> None:
    """Poses that lay pair h of the object onto pair h of the contacts: middles meet, directions agree, and the turn
    about the direction fits both normals best. Fills rotations (h, 3, 3) and origins (h, 3).
    """
    e, f, v, x, turned = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    for h in range(first.shape[0]):
        a, b, i, j = first[h], second[h], contact_first[h], contact_second[h]
        for k in range(3):
            e[k] = points[b, k] - points[a, k]
            f[k] = contact_points[j, k] - contact_points[i, k]
        over_e = 1.0 / math.sqrt(e[0] * e[0] + e[1] * e[1] + e[2] * e[2])
        over_f = 1.0 / math.sqrt(f[0] * f[0] + f[1] * f[1] + f[2] * f[2])
        for k in range(3):
            e[k] *= over_e
            f[k] *= over_f
            v[k] = e[k] + f[k]
        # half turn about the bisector v takes e to f, and any x to 2 (v x) v - x; nearly opposite directions: about
        # any line across e
        length = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
        if length < 1e-6:
            axis = 0
            for k in range(1, 3):
                axis = k if abs(e[k]) < abs(e[axis]) else axis
            for k in range(3):
                v[k] = (1.0 if k == axis else 0.0) - e[axis] * e[k]
            length = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
        for k in range(3):
            v[k] /= length
        # then about f: the angle that maximises the sum of the normals' dot products
        cosine, sine = 0.0, 0.0
        for side in range(2):
            m, u = (a, i) if side == 0 else (b, j)
            along = 2.0 * (v[0] * normals[m, 0] + v[1] * normals[m, 1] + v[2] * normals[m, 2])
            for k in range(3):
                x[k] = along * v[k] - normals[m, k]
            p, q, r = contact_normals[u, 0], contact_normals[u, 1], contact_normals[u, 2]
            slope_x, slope_u = x[0] * f[0] + x[1] * f[1] + x[2] * f[2], p * f[0] + q * f[1] + r * f[2]
            cosine += x[0] * p + x[1] * q + x[2] * r - slope_x * slope_u
            sine += f[0] * (x[1] * r - x[2] * q) + f[1] * (x[2] * p - x[0] * r) + f[2] * (x[0] * q - x[1] * p)
        # where neither tells, no turn is better than another
        longest = math.sqrt(cosine * cosine + sine * sine)
        c, s = (cosine / longest, sine / longest) if longest > 0.0 else (1.0, 0.0)
        # the turn T of the half turn: 2 (T v) v' - T
        along = (1.0 - c) * (f[0] * v[0] + f[1] * v[1] + f[2] * v[2])
        turned[0] = along * f[0] + c * v[0] + s * (f[1] * v[2] - f[2] * v[1])
        turned[1] = along * f[1] + c * v[1] + s * (f[2] * v[0] - f[0] * v[2])
        turned[2] = along * f[2] + c * v[2] + s * (f[0] * v[1] - f[1] * v[0])
        rotation = rotations[h]
        for k in range(3):
            for m in range(3):
                rotation[k, m] = 2.0 * turned[k] * v[m] - (1.0 - c) * f[k] * f[m] - (c if k == m else 0.0)
        rotation[0, 1] += s * f[2]
        rotation[0, 2] -= s * f[1]
        rotation[1, 0] -= s * f[2]
        rotation[1, 2] += s * f[0]
        rotation[2, 0] += s * f[1]
        rotation[2, 1] -= s * f[0]
        for k in range(3):
            origins[h, k] = 0.5 * (contact_points[i, k] + contact_points[j, k])
            for m in range(3):
                origins[h, k] -= rotation[k, m] * 0.5 * (points[a, m] + points[b, m])
