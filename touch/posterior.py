"""Draws from the posterior of a pose by touch alone: how much of what the contacts allow is near the answer.

Few contacts leave directions free along curved surfaces, on which a Gaussian about a minimum is no description, and
noise whose size nobody knows. So poses are drawn and weighed by what they are worth (population Monte Carlo: Cappe,
Guillin, Marin, Robert 2004): first from wide Student distributions about every minimum that the search has found, and
about the prior, then about the draws that were worth most. A draw's worth is the posterior density itself, with the
scale of the noise integrated out and every contact as likely a false one beyond a gate; its density under all that it
could have been drawn from is exact, on the rotations too. Contacts' frame, metres.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from scenes.evidence import table as tables
from scenes.evidence.align import AlignSettings, Prior, align, costs
from scenes.evidence.modes import Mode, ModeSettings, covariance_of
from scenes.evidence.search import distinct_first
from scenes.evidence.table import GATE_ABOVE, GATE_BELOW, SIGMA, SIGMA_NORMAL, TOUCH, Evidence
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Contacts
from touch.posterior_kernels import student_mixture

Array = NDArray[np.float64]

# Poses only judged where they are.
IN_PLACE = AlignSettings(iterations=0)
# Radii from the contacts' mean beyond which a candidate is none.
FARAWAY = 1e3
# Variance (rad^2, m^2) that keeps a covariance's factor one: of a hundredth of a micrometre.
TINY = 1e-16


@dataclass(frozen=True)
class PosteriorSettings:
    """What is believed of contacts beside their sigmas, and how the posterior is drawn from. Beliefs by judgement, as
    each says; the sizes of the sample are the least at which confidences of 400 generated contact sets keep their worth
    (a hand's 3 to 5 fingertips, pokes, patches, one side; 1 to 40 contacts of 0.2 to 3 mm).
    """

    # Standard deviation of the logarithm of contacts' true sigma over the one that they claim (no unit): a claim wrong
    # by two is 1.7 of them; and over the usual one where none is claimed: 0.2 to 4 mm are within two.
    told_spread: float = 0.4
    untold_spread: float = 0.8
    # Scales of the noise that are summed over, evenly out to so many standard deviations; and, where none is claimed,
    # these times the usual, which is beyond any (the last: `LocalizeSettings.largest_noise`).
    scales: int = 5
    farthest: float = 2.2
    beyond: tuple[float, ...] = (9.0, 15.0)
    # A contact this many sigmas off is as likely a false one, without a normal and with one: 2 in 100 are, anywhere in
    # 0.1 m and any direction, beside sigmas of 1 mm and 5 degrees.
    gate: float = 4.0
    gate_normal: float = 5.0
    # Contacts count at most for this many independent ones, as where objects are told apart: errors of the mesh and of
    # the calibration are shared. So many are looked at.
    independent: float = 25.0
    looked_at: int = 60
    # Sigma (m) below which the lattice, not the contact, says where the surface is: its RMS error.
    least_sigma: float = 1e-4
    # Minima that are drawn about at first (how many, and nats below the best), their weights to this power: what a
    # Laplace approximation has wrong by far is looked at, too. Of three to six contacts the truth is often at none of
    # the first 40. Draws that are drawn about in the next rounds.
    minima: int = 300
    margin: float = 30.0
    temper: float = 0.3
    centres: int = 60
    # Draws of the first rounds, and of the last, which is the answer.
    rounds: tuple[int, ...] = (600, 800, 1500)
    # Degrees of freedom of the Student distributions: heavy enough to reach what a Gaussian leaves out.
    freedom: float = 4.0
    # Shares of a round that are drawn about the first minima again, and from the prior.
    again: float = 0.2
    of_prior: float = 0.15
    # What is drawn about a draw: its own Gauss-Newton covariance, free directions no wider than this (rad, and share of
    # the radius), times this: many narrow ones follow a bent surface (Silverman's factor for 60 of them is 0.44).
    widest_angle: float = 0.5
    widest_share: float = 0.5
    band: float = 0.5
    # Draws that must carry weight: with fewer the weights are tempered, so that what they tell is a region, no point.
    enough: float = 100.0
    # Equally likely draws, and points of the surface, by which ADD-S is judged: half a per cent at 0.95 is chance.
    judged: int = 400
    points: int = 150


@dataclass(frozen=True)
class Posterior:
    """poses (n, 4, 4) contacts_frame_from_object; weights (n,), 1 in all; effective: how many draws carry weight before
    tempering (Kish's effective sample size).
    """

    poses: Array
    weights: Array
    effective: float

    def within(self, model: ObjectModel, pose: Array, tolerance: float, settings: PosteriorSettings) -> float:
        """Probability that a pose (4, 4) has an ADD-S below tolerance (m): points of the surface from the surface."""
        picked, counts = np.unique(_evenly_drawn(self.weights, settings.judged, 0.5), return_counts=True)
        points = model.sample_surface(settings.points, seed=2)[0]
        there = se3.inverse(self.poses[picked]) @ pose
        moved = points @ np.swapaxes(there[:, :3, :3], -1, -2) + there[:, None, :3, 3]
        away = np.abs(model.field.distance(moved.reshape(-1, 3))).reshape(len(picked), -1).mean(axis=1)
        return float(counts[away < tolerance].sum() / counts.sum())

    def covariance_about(self, model: ObjectModel, pose: Array, chosen: NDArray[np.bool_] | None = None) -> Array:
        """(6, 6) second moments about a pose (4, 4), modulo the object's symmetries, of the chosen draws (n,)."""
        weights = self.weights if chosen is None else np.where(chosen, self.weights, 0.0)
        away = se3.difference(model.symmetries.nearest(self.poses, pose), pose, model.centroid)
        return np.asarray((away * (weights / weights.sum())[:, None]).T @ away)


def posterior_of(
    model: ObjectModel,
    contacts: Contacts,
    candidates: Array,
    sigma: float,
    rng: np.random.Generator,
    prior: Prior | None = None,
    extra: Evidence | None = None,
    settings: PosteriorSettings | None = None,
) -> Posterior:
    """Draws from what contacts, prior and extra rows say of the pose.

    candidates (k, 4, 4): refined poses, all minima that are known among them. sigma (m): the contacts' noise as the
    search had it. Weights are of the draws modulo nothing: a symmetric object's equivalents are drawn as others are.
    """
    s = settings or PosteriorSettings()
    target = _Target(model, contacts, prior, extra, s)
    # where a local method has run away to, no contact is near
    away = np.abs(candidates[:, :3, :3] @ model.centroid + candidates[:, :3, 3] - contacts.points.mean(axis=0)).max(
        axis=1
    )
    candidates = candidates[away <= max(float(away.min()), FARAWAY * model.radius)]
    found = align(model, target.rows(max(sigma / target.claimed, 1.0)), candidates, prior, IN_PLACE)
    found = found.take(distinct_first(model, found, 4 * s.minima))
    wide = covariance_of(model, found.hessians)
    worth = target.logs(found.poses)[0] + 0.5 * np.linalg.slogdet(wide)[1]
    order = np.argsort(-worth, kind="stable")[: s.minima]
    order = order[worth[order] > worth[order[0]] - s.margin]
    first = Mixture(found.poses[order], wide[order], normalised(s.temper * worth[order]))
    narrow = ModeSettings(widest_angle=s.widest_angle, widest_share=s.widest_share)
    mixture = first
    for count in s.rounds[:-1]:
        draws, logs, scales = drawn(model, mixture, target, count, rng, s)
        weights = _tempered(logs, s.centres)
        centres, times = np.unique(_evenly_drawn(weights, s.centres, rng.random()), return_counts=True)
        scale = target.narrowed(normalised(logs) @ scales)
        about = align(model, target.rows(scale), draws[centres], prior, IN_PLACE)
        bands = s.band * covariance_of(model, about.hessians, narrow)
        mixture = Mixture(draws[centres], bands, times / times.sum()).joined(first, s.again)
    draws, logs, _ = drawn(model, mixture, target, s.rounds[-1], rng, s)
    effective = float(1.0 / np.square(normalised(logs)).sum())
    return Posterior(draws, _tempered(logs, s.enough), effective)


def draws_of(model: ObjectModel, modes: tuple[Mode, ...], rng: np.random.Generator, count: int = 1000) -> Posterior:
    """Draws from modes (one at least) as they say of themselves: by their weights, each a Gaussian."""
    poses, covariances = np.array([mode.pose for mode in modes]), np.array([mode.covariance for mode in modes])
    which = np.sort(rng.choice(len(modes), size=count, p=normalised(np.log([max(m.weight, 1e-300) for m in modes]))))
    factors = np.linalg.cholesky(covariances + TINY * np.eye(6))
    delta = np.einsum("nij,nj->ni", factors[which], rng.normal(size=(count, 6)))
    draws = se3.perturb(poses[which], delta, model.centroid)
    return Posterior(draws, np.full(count, 1.0 / count), float(count))


class Target(Protocol):
    """What draws are worth, and the prior among what they are drawn from."""

    prior: Prior | None

    def logs(self, poses: Array) -> tuple[Array, Array]:
        """Log density (n,) of poses (n, 4, 4), up to a constant, and a row (n, k) more of each."""
        ...


class _Target:
    """The posterior density, the scale of the contacts' noise integrated out."""

    def __init__(
        self,
        model: ObjectModel,
        contacts: Contacts,
        prior: Prior | None,
        extra: Evidence | None,
        settings: PosteriorSettings,
    ) -> None:
        s = settings
        count = len(contacts)
        if count > s.looked_at:
            contacts = contacts.take(np.linspace(0, count - 1, s.looked_at).astype(np.intp))
        rows = tables.from_contacts(contacts).reweighted(min(1.0, s.independent / len(contacts)))
        rows.rows[:, SIGMA] = np.maximum(rows.rows[:, SIGMA], s.least_sigma)
        self.model, self.prior, self.extra, self.settings, self._contacts = model, prior, extra, s, rows
        self.claimed = float(np.sqrt(np.mean(np.square(rows.rows[:, SIGMA]))))
        self._has_normal = rows.rows[:, SIGMA_NORMAL] > 0
        # numbers that noise has moved, each of which makes a density of 1 / scale
        self._numbers = min(1.0, s.independent / len(contacts)) * (len(contacts) + 2 * int(self._has_normal.sum()))
        spread = s.told_spread if contacts.sigma_known else s.untold_spread
        nodes = np.linspace(-s.farthest * spread, s.farthest * spread, s.scales)
        if not contacts.sigma_known:
            nodes = np.append(nodes, np.log(s.beyond))
        self._nodes = nodes
        self._beliefs = -0.5 * np.square(nodes / spread) + np.log(np.gradient(nodes))
        self._tables = [self.rows(float(scale)) for scale in np.exp(nodes)]

    def rows(self, scale: float) -> Evidence:
        """All rows, with contacts whose noise is `scale` times what they claim."""
        s = self.settings
        rows = self._contacts.rows.copy()
        rows[:, SIGMA] *= scale
        rows[self._has_normal, SIGMA_NORMAL] *= scale
        # what is as likely elsewhere is so at fewer sigmas where the noise is larger: one number less sharp, or three
        gates = np.where(self._has_normal, s.gate_normal**2 - 6.0 * np.log(scale), s.gate**2 - 2.0 * np.log(scale))
        rows[:, GATE_ABOVE] = rows[:, GATE_BELOW] = np.sqrt(np.maximum(gates, 2.0))
        evidence = Evidence(rows, np.full(len(rows), TOUCH, dtype=np.uint8))
        return evidence if self.extra is None else tables.stack(evidence, self.extra)

    def logs(self, poses: Array) -> tuple[Array, Array]:
        """Log density (n,) of poses (n, 4, 4), up to a constant, and the share (n, scales) of each scale in it."""
        by_scale = np.stack([-costs(self.model, rows, poses, self.prior) for rows in self._tables], axis=1)
        by_scale += self._beliefs - self._numbers * self._nodes
        top = by_scale.max(axis=1)
        shares = np.exp(by_scale - top[:, None])
        total = shares.sum(axis=1)
        return top + np.log(total), shares / total[:, None]

    def narrowed(self, shares: Array) -> float:
        """The scale that shares (scales,) speak of; those that none does are left out from now on."""
        scale = float(np.exp(shares @ self._nodes / shares.sum()))
        kept = shares > 1e-4
        self._tables = [rows for rows, keep in zip(self._tables, kept) if keep]
        self._nodes, self._beliefs = self._nodes[kept], self._beliefs[kept]
        return scale


@dataclass(frozen=True)
class Mixture:
    """Student distributions: centres (k, 4, 4), scale matrices (k, 6, 6), shares (k,)."""

    poses: Array
    wide: Array
    shares: Array

    def joined(self, other: Mixture, share: float) -> Mixture:
        """With the other's, which has this share of all."""
        parts = (1.0 - share) * self.shares, share * other.shares
        return Mixture(
            np.concatenate([self.poses, other.poses]),
            np.concatenate([self.wide, other.wide]),
            np.concatenate(parts),
        )


def drawn(
    model: ObjectModel,
    mixture: Mixture,
    target: Target,
    count: int,
    rng: np.random.Generator,
    settings: PosteriorSettings,
) -> tuple[Array, Array, Array]:
    """About `count` poses (n, 4, 4), the log (n,) of what each is worth, and what the target has more of each."""
    s, prior = settings, target.prior
    if prior is not None:
        told = Mixture(prior.pose[None], covariance_of(model, prior.information)[None], np.ones(1))
        mixture = mixture.joined(told, s.of_prior)
    factors = np.linalg.cholesky(mixture.wide + TINY * np.eye(6))
    which = np.sort(rng.choice(len(factors), size=count, p=mixture.shares / mixture.shares.sum()))
    stretch = np.sqrt(s.freedom / rng.chisquare(s.freedom, size=count))
    delta = np.einsum("nij,nj->ni", factors[which], rng.normal(size=(count, 6))) * stretch[:, None]
    whole = np.linalg.norm(delta[:, :3], axis=1) < np.pi  # beyond half a turn the chart covers the rotations again
    delta, which = delta[whole], which[whole]
    middles = mixture.poses[:, :3, :3] @ model.centroid + mixture.poses[:, :3, 3]
    turned = se3.exp_rotation(delta[:, :3]) @ mixture.poses[which, :3, :3]
    placed = middles[which] + delta[:, 3:]
    logs = np.log(np.maximum(mixture.shares, 1e-300)) - np.log(np.einsum("kii->ki", factors)).sum(axis=1)
    drawn_from = np.zeros(len(delta))
    rotations = np.ascontiguousarray(mixture.poses[:, :3, :3])
    roots = np.ascontiguousarray(np.linalg.inv(factors))
    widths = np.stack([np.einsum("kii->k", mixture.wide[:, k : k + 3, k : k + 3]) for k in (0, 3)], axis=1) + TINY
    student_mixture(rotations, middles, roots, widths, logs, float(s.freedom), turned, placed, drawn_from)
    poses = se3.make_poses(turned, placed - turned @ model.centroid)
    worth, scales = target.logs(poses)
    return poses, worth - drawn_from, scales


def normalised(logs: Array) -> Array:
    """Shares (n,) of logarithms (n,)."""
    shares = np.exp(logs - np.max(logs))
    return np.asarray(shares / shares.sum())


def _tempered(logs: Array, enough: float) -> Array:
    """Shares (n,) of logarithms, to the largest power up to 1 at which so many carry weight."""
    for power in (1.0, 0.85, 0.7, 0.5, 0.35, 0.25, 0.15):
        shares = normalised(power * logs)
        if 1.0 / np.square(shares).sum() >= enough:
            break
    return shares


def _evenly_drawn(weights: Array, count: int, offset: float) -> NDArray[np.intp]:
    """(count,) indices by weights (n,): systematic resampling with an offset in 0..1."""
    edges = np.cumsum(weights)
    return np.minimum(np.searchsorted(edges, (offset + np.arange(count)) / count * edges[-1]), len(weights) - 1)
