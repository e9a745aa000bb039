"""The evidence for an object: how likely contacts are on it, summed over every pose that it may have.

Where one pose is as likely as any other that lets a first finger touch the object, the evidence is the likelihood's
mean over poses per area of the surface. Few contacts are met by whole families of poses, which no list of minima
describes: poses are drawn in which one contact lies on the surface, its normal met half of the time, and the others are
judged (importance sampling). More contacts leave narrow minima: poses are drawn from Student distributions about all of
them (touch.posterior). Both are one integral, of which either misses what it does not reach: the larger counts. Metres.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import lgamma

import numpy as np
from numpy.typing import NDArray

from scenes.evidence.align import Alignment, Prior, costs
from scenes.evidence.modes import ModeSettings, covariance_of
from scenes.evidence.table import Evidence
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from touch.identity.noise import ContactNoiseSettings, Noise
from touch.multistart import shortest_turn
from touch.posterior import Mixture, PosteriorSettings, drawn, normalised

Array = NDArray[np.float64]


@dataclass(frozen=True)
class EvidenceSettings:
    """How poses are drawn. Values by judgement; sizes of the samples on the sets that docs/evaluation.md names."""

    # Contacts up to which poses are drawn with one of them on the surface: of more, no draw meets them all.
    few: int = 7
    # Poses drawn then, and of these judged with every size of the noise: those whose contacts are nearest.
    draws: int = 8000
    judged: int = 500
    # Distance (m) from which on a contact counts as one that is off when the nearest are chosen.
    off: float = 0.02
    # How far (rad) normals that are met are turned in the draws: more than any finger's.
    turned: float = 0.35
    # Poses drawn about the minima of more contacts.
    about: int = 400
    mixture: PosteriorSettings = field(default_factory=PosteriorSettings)
    noise: ContactNoiseSettings = field(default_factory=ContactNoiseSettings)


class _Target:
    """Log density of poses for `touch.posterior.drawn`."""

    prior: Prior | None = None

    def __init__(self, model: ObjectModel, noise: Noise, extra: Evidence | None) -> None:
        self._model, self._noise, self._extra = model, noise, extra

    def logs(self, poses: Array) -> tuple[Array, Array]:
        """(n,) log densities, and nothing more of each."""
        return likelihoods(self._model, self._noise, poses, self._extra), np.zeros((len(poses), 0))


def likelihoods(model: ObjectModel, noise: Noise, poses: Array, extra: Evidence | None = None) -> Array:
    """(n,) log likelihood of contacts and extra rows at poses (n, 4, 4)."""
    logs = noise.at(model, poses)
    return logs if extra is None else logs - costs(model, extra, poses)


def log_evidence(
    model: ObjectModel,
    noise: Noise,
    minima: Alignment,
    rng: np.random.Generator,
    extra: Evidence | None = None,
    settings: EvidenceSettings | None = None,
) -> float:
    """Log evidence for an object. minima: refined poses, with Gauss-Newton Hessians of the likelihood."""
    s = settings or EvidenceSettings()
    about = about_minima(model, noise, minima.poses, minima.hessians, rng, extra, s)
    return about if len(noise.contacts) > s.few else max(about, by_first_contact(model, noise, rng, extra, s))


def about_minima(
    model: ObjectModel,
    noise: Noise,
    poses: Array,
    hessians: Array,
    rng: np.random.Generator,
    extra: Evidence | None = None,
    settings: EvidenceSettings | None = None,
) -> float:
    """Log evidence, from poses (k, 4, 4) of minima and their Gauss-Newton Hessians (k, 6, 6)."""
    s = settings or EvidenceSettings()
    m = s.mixture
    narrow = ModeSettings(widest_angle=m.widest_angle, widest_share=m.widest_share)
    wide = covariance_of(model, hessians, narrow)
    worth = likelihoods(model, noise, poses, extra) + 0.5 * np.linalg.slogdet(wide)[1]
    order = np.argsort(-worth, kind="stable")
    order = order[worth[order] > worth[order[0]] - m.margin]
    mixture = Mixture(poses[order], wide[order], normalised(m.temper * worth[order]))
    logs = drawn(model, mixture, _Target(model, noise, extra), s.about, rng, m)[1]
    return float(_log_mean(logs, s.about) - np.log(model.area)) + _unit(m.freedom)


def by_first_contact(
    model: ObjectModel,
    noise: Noise,
    rng: np.random.Generator,
    extra: Evidence | None = None,
    settings: EvidenceSettings | None = None,
) -> float:
    """Log evidence of few contacts, from poses in which one of them, by turns, lies on the surface."""
    s = settings or EvidenceSettings()
    contacts = noise.contacts
    first = rng.integers(len(contacts), size=s.draws)
    surface, outward = model.sample_surface(s.draws, int(rng.integers(2**31)))
    rotations = se3.random_rotations(s.draws, rng)
    logs = np.zeros(s.draws)
    known = contacts.has_normal[first]
    if known.any():
        # half of the draws meet the normal to within a few turns of it; each is worth its prior over its density
        kappa = s.turned**-2
        whole = 2.0 * kappa / (1.0 - np.exp(-2.0 * kappa))
        felt = np.where(known[:, None], contacts.normals[first], outward)
        cosine = 1.0 + np.log1p(-rng.random(s.draws) * (1.0 - np.exp(-2.0 * kappa))) / kappa
        met = known & (rng.random(s.draws) < 0.5)
        target = _beside(felt, np.clip(cosine, -1.0, 1.0), rng)
        source = np.einsum("nij,nj->ni", rotations, outward)
        rotations = np.where(met[:, None, None], shortest_turn(source, target) @ rotations, rotations)
        along = np.sum(np.einsum("nij,nj->ni", rotations, outward) * felt, axis=1)
        logs = np.where(known, -np.log(0.5 + 0.5 * whole * np.exp(kappa * (along - 1.0))), 0.0)
    turned = contacts.points[None] - contacts.points[first][:, None]
    local = surface[:, None] + np.einsum("nji,nkj->nki", rotations, turned)
    distance = np.abs(model.field.distance(local.reshape(-1, 3))).reshape(s.draws, -1)
    near = np.argsort(np.minimum(distance, s.off).sum(axis=1) - s.off * logs, kind="stable")[: s.judged]
    rotations = rotations[near]
    poses = se3.make_poses(rotations, contacts.points[first[near]] - np.einsum("nij,nj->ni", rotations, surface[near]))
    worth = noise.at(model, poses, first[near])
    if extra is not None:
        worth -= costs(model, extra, poses)
    # the first contact's own density is 1 along its normal
    return _log_mean(worth + logs[near], s.draws) + float(np.log(2.0 * noise.scales[0]))


def _unit(freedom: float) -> float:
    """What a mean over draws lacks of the evidence: constants of a Student density of six numbers (its scale is in the
    draws' weights), and that rotations are 8 pi^2.
    """
    density = lgamma(0.5 * freedom + 3.0) - lgamma(0.5 * freedom) - 3.0 * np.log(freedom * np.pi)
    return float(-density - np.log(8.0 * np.pi**2))


def _log_mean(logs: Array, count: int) -> float:
    """Logarithm of the mean of `count` numbers, of which those (n,) whose logarithms are given are not nothing."""
    top = float(logs.max())
    return top + float(np.log(np.exp(logs - top).sum() / count))


def _beside(directions: Array, cosine: Array, rng: np.random.Generator) -> Array:
    """(n, 3) unit vectors at angles of these cosines (n,) from directions (n, 3), any way round."""
    across = np.cross(directions, se3.random_unit_vectors(len(directions), rng))
    length = np.linalg.norm(across, axis=1, keepdims=True)
    across = across / np.maximum(length, 1e-12)
    return np.asarray(cosine[:, None] * directions + np.sqrt(1.0 - cosine**2)[:, None] * across)
