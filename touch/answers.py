"""What every method that works on touch alone answers: a pose, its modes, how well it fits, how sure it is."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from scenes.evidence.modes import Mode
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Contacts
from touch.posterior import PosteriorSettings

Array = NDArray[np.float64]

# Contacts measured at a time against the mesh: some 20 numbers each, 16 MB.
BLOCK = 100_000


@dataclass(frozen=True)
class LocalizeSettings:
    """The multi-start search over contacts. Values tuned on generated contacts where no reason is named."""

    # A prior narrower than this (rad, and share of the object's radius, per axis) is drawn from: how often, and the
    # blurs (shares of the radius, rad), steps and survivors of the passes. With 60 draws and 12 survivors a minimum
    # that costs up to 30 nats less was passed over, where fingertips lie in patches.
    narrow_angle: float = 0.5
    narrow_share: float = 0.7
    draws: int = 200
    draw_passes: tuple[tuple[float, float, int, int], ...] = ((0.07, 0.25, 8, 40),)
    # With normals on at least this many contacts: poses hypothesised from pairs of them, the blurs they are ranked with
    # (share of the radius, rad), and of those the ones refined, with their one pass as above.
    least_normals: int = 3
    hypotheses: int = 8000
    rank_blur: tuple[float, float] = (0.07, 0.25)
    ranked: int = 500
    pair_pass: tuple[float, float, int, int] = (0.04, 0.15, 8, 400)
    # The best so many times as many are looked through for those that differ by more than they are shaken, modulo
    # symmetry: of a bottle every turn about its axis was a start, and its other end none.
    looked_through: int = 4
    # They are shaken by this much (rad, and share of the radius), a fraction of the table's grid: other seeds then look
    # at other places.
    jitter: float = 0.03
    # Row evaluations that ranking and refining may spend: with many contacts a few starts do.
    budget_rank: int = 100_000
    budget_ranked: int = 20_000
    # Otherwise: starts everywhere; each costs about 10 microseconds with five contacts.
    starts: int = 3000
    # Blur of the first pass as a share of the object's radius: its basins are as wide as the object's features.
    widest_blur: float = 0.25
    # Blur on normals in the first pass, radians.
    widest_blur_normal: float = 0.6
    # Survivors of the passes. Few contacts leave hundreds of minima: with 120 of pairs and 100 of these the regions of
    # 95 % of three contacts with normals held 84 % of 204 poses, of six without 86 %; so 92 % and more.
    keep: tuple[int, int, int] = (800, 400, 300)
    # Row evaluations that the first pass may spend: with many contacts the starts are fewer, and each is led better.
    budget_rows: int = 400_000
    # Residuals this many times above the claimed sigma mean that the claim is wrong: the noise is then inferred.
    surprise: float = 1.5
    # Nor does what that many standard deviations of their mean size may be by chance, which is more for fewer contacts.
    surprise_sigmas: float = 3.0
    # Then some contacts may be false: as likely false as true at this many sigmas. At least this share of them, and
    # this many, must agree with one pose to within three sigmas: six contacts can always be met.
    false_gate: float = 4.0
    agreeing_share: float = 0.5
    agreeing_least: int = 8
    # Contacts that the answer calls false, but another pose explains: from so many on, and this share of them, they may
    # be those that tell where the object is. A pose can meet six distances by chance, or the distances and normals of
    # two contacts; these are two and three more. Without normals those that agree with the answer, but for the six that
    # any pose meets, must be so many times as many as those that do not: the best of many poses meets more.
    met_anyway: int = 6
    outnumbered: float = 2.0
    rivals: int = 8
    rivals_normal: int = 5
    rivals_share: float = 0.6
    # Inferred noise beyond so many times what was claimed is no noise: two places of the object, another mesh, another
    # unit. Of contacts 5 times as noisy as they claim 4.9 is inferred at most, and their answers were right.
    misclaimed: float = 5.5
    # Noise of a contact (m) that no finger exceeds, as when objects are told apart: contacts that are farther off any
    # pose are of something else. Of random points in a hand's reach on a drill 12 mm is the least median, of true ones,
    # a fifth of them false by centimetres, 7 the largest.
    largest_noise: float = 0.015
    # Inferred noise has an unknown shape: residuals beyond this many sigmas count linearly.
    huber: float = 0.3
    # So many standard deviations above its usual, what contacts leave over contradicts the answer: 1 in 1000 by chance.
    contradicted_sigmas: float = 3.09
    # Error (ADD-S, m) that is good enough when the caller does not say, and the confidence (a probability, no unit)
    # from which an answer is `ok`: as for both senses.
    sure_within: float = 0.005
    sure: float = 0.95
    # Most that is said of an answer that the contacts contradict (a probability, no unit): of 37 such answers to 400
    # generated contact sets 24 were right.
    doubted: float = 0.6
    # Whether an answer is `ok` only where its first mode holds nearly all of the posterior (this share, no unit): then
    # a way round that looks alike, as of a box that nobody called symmetric, leaves it ambiguous.
    way_round: bool = False
    sure_share: float = 0.9
    # A region of 95 % need not hold this share of the probability.
    left_out: float = 0.05
    # Factor on the second moments of draws (no unit): what the posterior has far out is drawn less often than it is so.
    # Regions of 95 % of 171 `ok` answers to generated contact sets hold 93 % with it, 89 without.
    widening: float = 1.5
    # Standard deviations (rad, m) of directions beyond which a mode by itself is no answer, where nothing is drawn from
    # the posterior (`verdict_of`): those as in the verdict on both senses.
    unknown_angle: float = float(np.deg2rad(20.0))
    unknown_distance: float = 0.015
    # Whether the posterior is drawn from, which costs some 60 ms: without, an answer has no confidence, and a verdict
    # by its modes alone.
    drawn: bool = True
    # How the posterior is drawn from.
    posterior: PosteriorSettings = field(default_factory=PosteriorSettings)
    # More contacts than this are searched with by so many of them, and settled with all (see thinning): 400 spread over
    # a hand tool tell its basins apart (bench scaling), and cost a third of a second.
    most_contacts: int = 400
    # Modes of the thinned search that are settled with all contacts, and Gauss-Newton steps that each may take.
    settled_modes: int = 6
    settling_steps: int = 6
    # Contacts finer than this share of the lattice's spacing are finished on the exact mesh.
    exact_below: float = 0.2
    # More of those than this share that disagree with the answer, by three spacings or in their normals, contradict it;
    # fewer may lie at an edge, where a normal is of either face.
    unlike_share: float = 0.25


@dataclass(frozen=True, eq=False)
class Localization:
    """pose (4, 4) contacts_frame_from_object of the first mode; modes; index: mean |distance| of all contacts to the
    surface there (m, the measure of T2 section 4.4); sigma: noise of the contacts, claimed or inferred (m); verdict;
    notes: what was not done with every contact, in words.

    confidence: probability that the pose's ADD-S is below sure_within (m), NaN where it was not asked for.
    contradicted: the contacts speak against every pose, or for two. posterior_covariance (6, 6) about the centroid: of
    what was drawn from the posterior, None where nothing was. candidates (k, 4, 4): where the search has been.
    """

    pose: Array
    modes: tuple[Mode, ...]
    index: float
    sigma: float
    verdict: str
    time_s: float
    method: str = "multistart"
    notes: tuple[str, ...] = ()
    confidence: float = float("nan")
    sure_within: float = float("nan")
    contradicted: bool = False
    posterior_covariance: Array | None = field(default=None, repr=False, compare=False)
    candidates: Array | None = field(default=None, repr=False, compare=False)

    @property
    def covariance(self) -> Array:
        """(6, 6) of an `ok` answer about its pose; of another one of all that may be the case; of the first mode where
        nothing was drawn from the posterior.
        """
        return self.modes[0].covariance if self.posterior_covariance is None else self.posterior_covariance


def contact_index(model: ObjectModel, contacts: Contacts, pose: Array) -> float:
    """Mean |distance| (m) of the contacts to the surface of the object at `pose`; T2 section 4.4."""
    object_from_contacts = se3.inverse(pose)
    away = np.zeros(len(contacts))
    for low in range(0, len(contacts), BLOCK):
        block = slice(low, low + BLOCK)
        away[block] = model.surface.closest(se3.apply(object_from_contacts, contacts.points[block]))[0]
    return float(np.abs(away).mean())


def noise_at(model: ObjectModel, contacts: Contacts, pose: Array, covariance: Array) -> tuple[float, float]:
    """Sigma (m) of the contacts' noise that their distances at a fitted `pose` speak of, and the degrees of freedom
    that the fit left them.

    covariance (6, 6) of the pose under the contacts' own sigmas, with all else that held it. A fit takes the leverage
    h_i = j_i C j_i^T from the variance of residual i, so that E|r_i| = sigma sqrt(2 / pi) sqrt(1 - h_i): sums of these
    suffer less from a few wild contacts than squares do.
    """
    distance, normal, _ = model.surface.closest(se3.apply(se3.inverse(pose), contacts.points))
    outward = normal @ pose[:3, :3].T
    lever = contacts.points - se3.apply(pose, model.centroid[None])
    jacobian = np.concatenate([np.cross(outward, lever), -outward], axis=1) / contacts.sigma_point[:, None]
    leverage = np.clip(np.einsum("ni,ij,nj->n", jacobian, covariance, jacobian), 0.0, 1.0)
    # at most six parameters were fitted, whatever a covariance far from the contacts' optimum says
    leverage *= min(1.0, 6.0 / max(float(leverage.sum()), 1e-9))
    return float(noise_of(distance, leverage)), float(len(contacts) - leverage.sum())


def noise_of(residuals: Array, leverage: Array) -> float:
    """Sigma of Gaussian noise before a fit that took `leverage` (n,) of the variance of each of its residuals (n,)."""
    expected = np.sqrt(2 / np.pi) * np.sqrt(np.maximum(1.0 - leverage, 0.0)).sum()
    return float(np.abs(residuals).sum() / max(expected, 1e-9))


def verdict_of(
    modes: tuple[Mode, ...], model: ObjectModel | None = None, settings: LocalizeSettings | None = None
) -> str:
    """Ok when the first mode holds nearly all of the posterior, else ambiguous.

    With a model, a mode so wide that it leaves a direction open is ambiguous too, but for the object's own symmetry.
    """
    settings = settings or LocalizeSettings()
    if not modes or modes[0].weight < settings.sure_share:
        return "ambiguous"
    if model is None:
        return "ok"
    own = model.symmetries.quotient(modes[0].pose[:3, :3], model.centroid)
    covariance = own @ modes[0].covariance @ own.T
    widest = np.sqrt([max(np.linalg.eigvalsh(covariance[k : k + 3, k : k + 3])[-1], 0.0) for k in (0, 3)])
    return "ok" if widest[0] < settings.unknown_angle and widest[1] < settings.unknown_distance else "ambiguous"
