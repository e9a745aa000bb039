"""The particle filter of PCL's point cloud tracker, which T1 section 4.3.2 tracks its objects with.

Each particle is a pose. It is weighed by how near the points of a reference (the object as the first frame shows it,
which is what PCL is given) come to observed ones: coherence = sum 1 / (1 + d^2 / half^2) over points with a neighbour
within reach, then w = exp(1 - 15 (best - coherence) / (best - worst)), normalised
(pcl::tracking::ParticleFilterTracker::normalizeWeight, DistanceCoherence, NearestPairPointCloudCoherence). Resampled
particles take a random step, a quarter of them the last frame's motion too. Left out: the adaption of the number of
particles (KLD), which saves time and no error. Poses are averaged in the chart of poses.perturb, not as Euler angles.
camera_from_object (4, 4), metres.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Frame
from scenes.threads import run_chunks
from vision.look.warm import Looker

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ParticleTrackerSettings:
    """PCL's names are in the comments. Steps and initial spread are tuned, the rest is its tutorial's."""

    # setParticleNum; PCL starts with 600.
    particles: int = 600
    # setStepNoiseCovariance, as standard deviations per axis: PCL's 15 mm and 5.4 degrees are for a hand-held object
    # at few frames a second; a tenth of it follows 30 frames a second with less noise (rad, m).
    step_angle: float = float(np.deg2rad(1.0))
    step_distance: float = 0.0015
    # setInitialNoiseCovariance (rad, m): it starts from a pose that another method has found.
    initial_angle: float = float(np.deg2rad(2.0))
    initial_distance: float = 0.003
    # motion_ratio_: share of the particles that move on as the object did last.
    motion_ratio: float = 0.25
    # alpha_ of normalizeWeight.
    alpha: float = 15.0
    # setMaximumDistance of the coherence (m), and the distance at which a pair counts half (m). PCL's weight of 1 per
    # square metre makes every pair count alike.
    reach: float = 0.010
    half: float = 0.005
    # Points of the reference, and edge of the grid that thins the observed cloud (m).
    reference: int = 300
    grid: float = 0.003
    # Weighing and resampling, this often a frame (setIterationNum).
    iterations: int = 2


@numba.njit(cache=True, nogil=True)
def _coherences(reference, rotations, translations, observed, starts, low, cell, counts, reach, half, out):
    """Fill out (n,): sum over reference points (k, 3) of 1 / (1 + d^2 / half^2), d to the nearest observed point.

    observed (m, 3) sorted by cell, starts (cells + 1,): first point of each cell of a grid of counts (3,) cells of
    edge `cell` >= reach from corner `low`. Points without a neighbour within reach add nothing.
    """
    for n in range(rotations.shape[0]):
        r, t = rotations[n], translations[n]
        total = 0.0
        for k in range(reference.shape[0]):
            px, py, pz = reference[k, 0], reference[k, 1], reference[k, 2]
            x = r[0, 0] * px + r[0, 1] * py + r[0, 2] * pz + t[0]
            y = r[1, 0] * px + r[1, 1] * py + r[1, 2] * pz + t[1]
            z = r[2, 0] * px + r[2, 1] * py + r[2, 2] * pz + t[2]
            ix = math.floor((x - low[0]) / cell)
            iy = math.floor((y - low[1]) / cell)
            iz = math.floor((z - low[2]) / cell)
            best = reach * reach
            found = False
            for ax in range(max(ix - 1, 0), min(ix + 2, counts[0])):
                for ay in range(max(iy - 1, 0), min(iy + 2, counts[1])):
                    for az in range(max(iz - 1, 0), min(iz + 2, counts[2])):
                        c = (ax * counts[1] + ay) * counts[2] + az
                        for i in range(starts[c], starts[c + 1]):
                            dx, dy, dz = observed[i, 0] - x, observed[i, 1] - y, observed[i, 2] - z
                            square = dx * dx + dy * dy + dz * dz
                            if square <= best:
                                best = square
                                found = True
            if found:
                total += 1.0 / (1.0 + best / (half * half))
        out[n] = total


def coherences(reference: Array, poses: Array, observed: Array, reach: float, half: float) -> Array:
    """(n,) coherences of poses (n, 4, 4): reference (k, 3) object frame, observed (m, 3) camera frame, metres."""
    out = np.zeros(len(poses))
    if not len(observed) or not len(reference):
        return out
    low = observed.min(axis=0)
    cells = np.floor((observed - low) / reach).astype(np.int64)
    counts = cells.max(axis=0) + 1
    key = (cells[:, 0] * counts[1] + cells[:, 1]) * counts[2] + cells[:, 2]
    order = np.argsort(key, kind="stable")
    starts = np.searchsorted(key[order], np.arange(int(counts.prod()) + 1))
    rotations, translations = np.ascontiguousarray(poses[:, :3, :3]), np.ascontiguousarray(poses[:, :3, 3])
    observed = np.ascontiguousarray(observed[order])

    def work(part: slice) -> None:
        _coherences(
            reference, rotations[part], translations[part], observed, starts, low, reach, counts, reach, half, out[part]
        )

    run_chunks(work, len(poses), smallest=32)
    return out


def thin_cloud(points: Array, edge: float) -> Array:
    """One point, the mean, of every cell of a grid of this edge (m)."""
    if not len(points):
        return points
    key = np.floor(points / edge).astype(np.int64)
    _, inverse, count = np.unique(key, axis=0, return_inverse=True, return_counts=True)
    total = np.zeros((len(count), 3))
    np.add.at(total, inverse.ravel(), points)
    return total / count[:, None]


class ParticleTracker:
    """Follows one object by its cloud."""

    def __init__(
        self, model: ObjectModel, pose: Array, settings: ParticleTrackerSettings | None = None, seed: int = 0
    ) -> None:
        """pose: the start, camera_from_object (4, 4); the filter has no other way to begin."""
        self.model = model
        self.settings = settings or ParticleTrackerSettings()
        self._rng = np.random.default_rng(seed)
        self._reference = np.zeros((0, 3))
        self._looker = Looker(model)
        self._motion = np.zeros(6)
        self._first = True
        self.pose = pose
        s = self.settings
        spread = np.repeat([s.initial_angle, s.initial_distance], 3)
        self._particles = se3.perturb(pose, spread * self._rng.normal(size=(s.particles, 6)), model.centroid)

    def step(self, frame: Frame) -> Array:
        """The weighted mean (4, 4) of the particles after this frame; without pixels they only wander."""
        s, centre = self.settings, self.model.centroid
        looked = self._looker.look(frame, self.pose)
        observed = thin_cloud(looked.pixels.points, s.grid)
        if not len(self._reference):
            self._reference = self._as_reference(observed)
        before = self.pose
        for turn in range(s.iterations):
            if turn or not self._first:
                self._wander(self._motion if turn == 0 else np.zeros(6))
            weights = self._weigh(observed)
            best = self._particles[int(np.argmax(weights))]
            delta = se3.difference(self._particles, best, centre)
            self.pose = se3.perturb(best, weights @ delta, centre)
            chosen = self._rng.choice(len(weights), size=len(weights), p=weights)
            self._particles = self._particles[chosen]
        self._motion = np.zeros(6) if self._first else se3.difference(self.pose, before, centre)
        self._first = False
        return self.pose

    def _as_reference(self, observed: Array) -> Array:
        """The observed points (n, 3) in the object's frame, at most as many as asked."""
        step = max(1, len(observed) // self.settings.reference)
        return np.ascontiguousarray(se3.apply(se3.inverse(self.pose), observed[::step]))

    def _wander(self, motion: Array) -> None:
        s = self.settings
        step = np.repeat([s.step_angle, s.step_distance], 3) * self._rng.normal(size=(s.particles, 6))
        moving = self._rng.random(s.particles) < s.motion_ratio
        self._particles = se3.perturb(self._particles, step + moving[:, None] * motion, self.model.centroid)

    def _weigh(self, observed: Array) -> Array:
        s = self.settings
        value = coherences(self._reference, self._particles, observed, s.reach, s.half)
        span = float(value.max() - value.min())
        if span <= 0.0:
            return np.full(len(value), 1.0 / len(value))
        weights = np.exp(1.0 - s.alpha * (value.max() - value) / span)
        return np.asarray(weights / weights.sum())
