"""The Memory Unscented Particle Filter and, with a window of one contact, the Unscented Particle Filter.

Vezzani, Pattacini, Battistelli, Chisci, Natale: Memory Unscented Particle Filter for 6-DOF Tactile Localization (IEEE
T-RO 2017), as T2 algorithm 2 has it: every particle carries a Gaussian that an unscented Kalman update draws towards
the newest contact, weights look back over a window of contacts, nothing is resampled at first. Contacts' frame, metres.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scenes.errors import InputError
from scenes.evidence.align import Prior, costs
from scenes.evidence.modes import covariance_of
from scenes.evidence.table import Evidence
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Contacts
from scenes.threads import run_chunks
from touch.answers import Localization
from touch.published.answers import localization
from touch.published.particles import unscented_kernels as kernels
from touch.published.particles.resampling import normalised, systematic

Array = NDArray[np.float64]


@dataclass(frozen=True)
class UnscentedSettings:
    """T2 table 4.1. Values not in it by judgement."""

    # Particles; 1200 in the published experiments with real contacts.
    particles: int = 700
    # Contacts looked back at, m; None = the share of them all that T2 table 4.3 has (36 of 62, 24 of 40, 9 of 15).
    window: int | None = None
    window_share: float = 0.6
    # Noise of a contact that the filter believes, metres per axis: what T2 section 4.4.4 measured of the iCub (its
    # filter had 1 cm in simulation and 2 cm on the robot). A filter of few particles needs it wide.
    sigma: float = 0.015
    # Sigma of a contact in the Kalman update, metres: the authors' program has none there, so that particles end on the
    # surface; some millimetres keep the gain regular.
    update_sigma: float = 0.004
    # Nodes of the object's lattice are left out until it is about this wide, metres: a third of what the filter
    # believes of a contact, and small enough for a processor's cache, where look-ups take two thirds of the time.
    lattice: float = 0.005
    # Artificial motion between two contacts: variances (rad^2, m^2) per axis, Q.
    process_rotation: float = 1e-4
    process_translation: float = 1e-5
    # Spread of the first centroids and the covariance P_0 of every first particle, metres and radians per axis. T2 has
    # P_0 = the spread of them all (0.2 m, 180 degrees); rotations are drawn over all of SO(3) here, so that each of 700
    # particles need not answer for more than its share, about 0.3 rad: an unscented transform over 180 degrees is
    # noise.
    start_distance: float = 0.15
    start_angle: float = 0.3
    # Scaled unscented transformation (no unit).
    alpha: float = 1.0
    kappa: float = 2.0
    beta: float = 30.0
    # Particles drawn from their Gaussians, as algorithm 2 is printed; else particles are the Gaussians' means, spread
    # by the artificial motion, as the authors' own program has it: the first Gaussians are a radian wide, and drawing
    # from them loses what the contacts have taught.
    sampled: bool = False
    # With a whole recording at hand, contacts are taken farthest from one another first (early contacts then decide
    # what a Kalman update of radians cannot), and gone through again until so many updates were made: a static object
    # allows it. 0 = once each.
    scattered: bool = True
    fewest_updates: int = 24
    # Contacts before the first resampling, t_0.
    keep_all: int = 2
    # Resampling when fewer than this share of the particles carry the weight (1 = always, as printed).
    effective_share: float = 0.2
    # Components below this share of the heaviest one's weight are left out of the estimate's mixture.
    least_weight: float = 1e-3
    # Particles, the heaviest first, at which the mixture is evaluated: where it is highest its particles are heavy.
    candidates: int = 150


class UnscentedParticleFilter:
    """The recursion: `update` with one contact after another, `estimate` whenever an answer is wanted."""

    def __init__(
        self,
        model: ObjectModel,
        around: ArrayLike,
        seed: int = 0,
        settings: UnscentedSettings | None = None,
        prior: Prior | None = None,
        extra: Evidence | None = None,
    ) -> None:
        """Particles around a point (3,) in the contacts' frame (T2's arbitrary x_0), or drawn from `prior`.

        settings.window must be a number here (the length of the recording is not known). extra: more rows of evidence.
        Raises InputError for fewer than two particles or a window below one.
        """
        self.model = model
        self.settings = settings or UnscentedSettings(window=36)
        self.extra = extra
        if self.settings.window is None or self.settings.window < 1 or self.settings.particles < 2:
            raise InputError(
                f"particle filter: expected a window of 1 contact or more and 2 particles or more,"
                f" got {self.settings.window} and {self.settings.particles}"
            )
        self._rng = np.random.default_rng(seed)
        self._contacts: list[Array] = []
        s, n = self.settings, self.settings.particles
        if prior is None:
            self.rotations = se3.random_rotations(n, self._rng)
            self.middles = np.asarray(around, dtype=np.float64) + s.start_distance * self._rng.normal(size=(n, 3))
            spread = np.diag([s.start_angle**2] * 3 + [s.start_distance**2] * 3)
        else:
            spread = covariance_of(model, prior.information)
            drawn = self._rng.normal(size=(n, 6)) @ np.linalg.cholesky(spread).T
            start = se3.perturb(prior.pose, drawn, model.centroid)
            self.rotations = np.ascontiguousarray(start[:, :3, :3])
            self.middles = start[:, :3, :3] @ model.centroid + start[:, :3, 3]
        self.covariances = np.tile(spread, (n, 1, 1))
        self._process = np.diag([s.process_rotation] * 3 + [s.process_translation] * 3)
        factor = s.alpha**2 * (6 + s.kappa)
        central = (factor - 6) / factor
        self._scaling = np.array([np.sqrt(factor), 0.5 / factor, central, central + 1 - s.alpha**2 + s.beta])
        # what the last update left for `estimate`: particles before resampling and the logs of their weights
        self._drawn = (self.rotations, self.middles, self.covariances)
        self._log_weights = np.zeros(n)
        self._log_estimate = np.zeros(n)

    def update(self, point: ArrayLike) -> None:
        """Take one contact (3,), metres. Raises InputError when it is not finite."""
        point = np.asarray(point, dtype=np.float64).reshape(3)
        if not np.isfinite(point).all():
            raise InputError(f"particle filter: expected a finite contact, got {point}")
        self._contacts.append(point)
        s, n, t = self.settings, self.settings.particles, len(self._contacts)
        assert s.window is not None
        window = np.array(self._contacts[-s.window :])
        # eq. 4.24 after eq. 4.18: every contact of the window has the power m in the end, counting earlier uses
        exponents = s.window - np.arange(len(window), dtype=np.float64)[::-1]
        likelihood, powered, proposal = np.zeros(n), np.zeros(n), np.zeros(n)
        draws = self._rng.normal(size=(n, 6))
        values, spacing = _thinned_lattice(self.model, s.lattice)

        def work(part: slice) -> None:
            kernels.filter_step(
                values,
                self.model.field.origin,
                spacing,
                self.model.centroid,
                window,
                exponents,
                s.sigma**2,
                s.update_sigma**2,
                self._process,
                self._scaling,
                s.sampled,
                draws[part],
                self.rotations[part],
                self.middles[part],
                self.covariances[part],
                likelihood[part],
                powered[part],
                proposal[part],
            )

        run_chunks(work, n, smallest=100)
        if self.extra is not None:
            also = costs(self.model, self.extra, self.particles())
            likelihood -= also
            powered -= s.window * also
        self._drawn = (self.rotations, self.middles, self.covariances)
        # Remark 1 of T2: the estimate's weights are those of eq. 4.18 times powers of the likelihoods. The proposal's
        # density divides once; eq. 4.24 as printed would divide by it twice.
        self._log_estimate = self._log_weights + powered - proposal
        if t <= s.keep_all:
            return
        self._log_weights = self._log_weights + likelihood - proposal
        weights = normalised(self._log_weights)
        if 1.0 / np.sum(weights**2) < s.effective_share * n or s.effective_share >= 1.0:
            chosen = systematic(self._log_weights, n, self._rng)
            self._log_weights = np.zeros(n)
            self.rotations, self.middles = self.rotations[chosen], self.middles[chosen]
            self.covariances = self.covariances[chosen]
            if t % 8 == 0:
                # products of thousands of turns leave the group by round-off
                self.rotations = np.ascontiguousarray(se3.nearest_rotation(self.rotations))

    def particles(self) -> Array:
        """(n, 4, 4) contacts_frame_from_object, in no order."""
        return se3.make_poses(self.rotations, self.middles - self.rotations @ self.model.centroid)

    def estimate(self) -> Array:
        """(4, 4): the particle where the posterior's mixture is highest (T2 eqs. 4.26 to 4.29)."""
        rotations, middles, covariances = self._drawn
        weights = self._log_estimate - self._log_estimate.max()
        # the heaviest first: beside them most of the others are soon seen to add nothing
        order = np.argsort(-weights, kind="stable")
        heavy = order[weights[order] > np.log(self.settings.least_weight)]
        components = (rotations[heavy], middles[heavy], covariances[heavy], weights[heavy])
        asked = heavy[: self.settings.candidates]
        density = np.zeros(len(asked))

        def work(part: slice) -> None:
            kernels.mixture_density(*components, rotations[asked[part]], middles[asked[part]], density[part])

        run_chunks(work, len(asked), smallest=50)
        best = asked[int(np.argmax(density))]
        rotation = se3.nearest_rotation(rotations[best])
        return se3.make_pose(rotation, middles[best] - rotation @ self.model.centroid)


_LATTICES: WeakKeyDictionary[ObjectModel, dict[int, tuple[NDArray[np.float32], float]]] = WeakKeyDictionary()


def _thinned_lattice(model: ObjectModel, widest: float) -> tuple[NDArray[np.float32], float]:
    """Every k-th node of the object's lattice along each axis, k as large as `widest` (m) allows, and the spacing.

    Kept as long as the object. The last nodes may be left out: they are in the lattice's padding.
    """
    field = model.field
    stride = max(1, int(widest / field.spacing))
    kept = _LATTICES.setdefault(model, {})
    if stride not in kept:
        kept[stride] = np.ascontiguousarray(field.values[::stride, ::stride, ::stride]), stride * float(field.spacing)
    return kept[stride]


def scattered_order(points: Array) -> NDArray[np.intp]:
    """Indices (n,) of points (n, 3): the first, then always the one farthest from all before it."""
    order = [0]
    away = np.linalg.norm(points - points[0], axis=1)
    for _ in range(len(points) - 1):
        away[order[-1]] = -1.0
        order.append(int(np.argmax(away)))
        away = np.where(away < 0, away, np.minimum(away, np.linalg.norm(points - points[order[-1]], axis=1)))
    return np.array(order)


def localize(
    model: ObjectModel,
    contacts: Contacts,
    seed: int = 0,
    prior: Prior | None = None,
    extra: Evidence | None = None,
    settings: UnscentedSettings | None = None,
) -> Localization:
    """Localise by the MUPF, all contacts at hand; see touch.localization. Normals are not used, as published."""
    settings = settings or UnscentedSettings()
    if settings.window is None:
        settings = replace(settings, window=max(1, round(settings.window_share * len(contacts))))
    _thinned_lattice(model, settings.lattice)  # not part of the search's time
    begin = time.perf_counter()
    search = UnscentedParticleFilter(model, contacts.points[0], seed, settings, prior, extra)
    order = scattered_order(contacts.points) if settings.scattered else np.arange(len(contacts))
    for n in range(max(len(contacts), settings.fewest_updates)):
        search.update(contacts.points[order[n % len(contacts)]])
    pose = search.estimate()
    name = "upf" if settings.window == 1 else "mupf"
    return localization(model, contacts, pose, search.particles(), settings.sigma, begin, name, prior, extra)


def upf(
    model: ObjectModel, contacts: Contacts, seed: int = 0, prior: Prior | None = None, extra: Evidence | None = None
) -> Localization:
    """Localise by the Unscented Particle Filter, the MUPF without memory (m = 1): the published baseline."""
    return localize(model, contacts, seed, prior, extra, UnscentedSettings(window=1))
