"""How likely an answer is right: the probability that its error is below a tolerance the caller names.

A covariance speaks of one minimum; it says nothing of answers in another, or of a picture that no pose explains. So
the probability has two factors. That the first mode is the right one is told by how the predicted picture and the
contacts agree with it: a logistic regression, fitted once to answers whose truth is known (Platt 1999;
Niculescu-Mizil and Caruana 2005). How near the answer then is, its covariance says: the mean square of the surface's
error along its normals is a quadratic form of Gaussians, here a gamma distribution of the same mean and variance
(Satterthwaite 1946). Modes between which no part of the surface moves by more than the tolerance are one answer.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fusion.estimation.answer import ContactResidual, Mode
from fusion.estimation.posterior.spread import mean_square, spread_of
from scenes.errors import check_above
from scenes.evidence.align import Prior
from scenes.evidence.symmetry.alike import Alike, alike
from scenes.geometry.objects import ObjectModel
from vision.picture.prediction import Prediction

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Regression:
    """Factors of a logistic regression, no unit: what each observation adds to the log odds that a mode is right.

    Tuned on answers to frames of all tuning families (docs/evaluation.md; `palpate fit-confidence`), with a start and
    without: the product of both factors of the probability, at tolerances of 3, 5 and 10 mm, by maximum likelihood,
    factors held to the sign that they must have. With a picture: 5284 answers, to 1321 frames; that of touch, when what
    it counts was changed, alone (`--only touch`), to 8855 others, to 1563 frames, a third of which tell little (a few
    contacts, of unknown sharpness, a hand without a model), which the others' factors explain as well as factors of
    their own. By touch alone 2619 answers, to 1308 frames. What it states of families that were left out is 0.8 % off,
    of a single family 6 % at most, but for `crude`, of which it states 11 too much.
    """

    # Of the logarithm of the first mode's odds, with those that look like it, against the others, within `most_odds`.
    weight: float = 0.0
    # Of nothing else being left beside them.
    alone: float = 0.0
    # Of the logarithm of the odds of all of which most of the surface is where the first has it (`Alike.near`).
    near: float = 0.0
    # Of the share of the predicted picture that agrees, above `agreeing`.
    agree: float = 0.0
    # Of the logarithm of that share, from `least_agreeing` on, and of how sharply it agrees: 1 is to the millimetre.
    visible: float = 0.0
    sharp: float = 0.0
    # Of the shares that are seen past, hidden by something unknown, by the robot's hand; and of the outline that runs
    # on, beside which of the borders within. Those against are capped.
    past: float = 0.0
    hidden: float = 0.0
    behind_hand: float = 0.0
    outline: float = 0.0
    within: float = 0.0
    # Of the share of the outline at which what agrees ends in a step of depth: there the object's own shape is seen.
    ends: float = 0.0
    # Of how much is felt: the logarithm of one more than how many numbers fingers tell, one of a place and two of a
    # normal, each as sharp as its contacts are beside the finest (`finest` over sigma, 1 at most); of the share of
    # contacts that are outliers, and of their cost (nats each).
    touch: float = 0.0
    outliers: float = 0.0
    contact_nats: float = 0.0
    # Of how blunt the fingertips are said to be: logarithm of a contact's sigma over the finest (see
    # ConfidenceSettings). What carries blunt ones is as badly calibrated, of which contacts alone show nothing.
    blunt: float = 0.0
    # Of the logarithm of the spread over the object's radius, held within bounds (see ConfidenceSettings).
    spread: float = 0.0
    # Of the logarithm of the spread over `far_share` of the radius, 0 at least.
    far: float = 0.0
    # Of there having been no start: it was looked for everywhere.
    anywhere: float = 0.0
    constant: float = 0.0
    # ADD-S over the root mean square of how far points of the surface are off along their normals.
    nearest: float = 0.7


@dataclass(frozen=True)
class Feature:
    """One thing that `observations` tells of an answer, named as its factor in `Regression`. sign: the one that its
    factor must have, 0 for any; seen, felt: whether it has one when there is a picture, and by touch alone. least: size
    of its factor at least, whatever the answers ask for.
    """

    name: str
    sign: int = 0
    seen: bool = True
    felt: bool = False
    least: float = 0.0


# What `palpate fit-confidence` fits. A new one is a line here, a field of `Regression` and a value in `observations`.
FEATURES = (
    Feature("weight", +1, felt=True),
    Feature("alone", +1),
    Feature("near", +1, felt=True),
    Feature("agree", +1),
    Feature("visible", +1),
    Feature("sharp", +1),
    # What is seen past contradicts a pose. It widens one, too, which makes up for it on the tuning families (a factor
    # of 0 is likeliest there, by 0.002 nats an answer); what is wrong elsewhere is not to be ok for that: by judgement.
    Feature("past", -1, least=8.0),
    Feature("hidden", -1),
    Feature("behind_hand"),
    Feature("outline", -1),
    Feature("within", -1),
    Feature("ends", +1),
    Feature("touch", +1),
    Feature("outliers", -1, felt=True),
    Feature("contact_nats", -1, felt=True),
    Feature("blunt", -1, seen=False, felt=True),
    Feature("spread", -1),
    # far off the nearest surface is another part of the object: ADD-S is less than the spread has it
    Feature("far", +1, seen=False, felt=True),
    Feature("anywhere"),
    Feature("constant", felt=True),
)


@dataclass(frozen=True)
class ConfidenceSettings:
    """How sure is sure. Tuned on the tuning families (docs/evaluation.md)."""

    # Error (ADD-S, m) that is good enough when the caller does not say.
    tolerance: float = 0.005
    # Confidence (a probability, no unit) from which an answer is `ok`.
    sure: float = 0.95
    # Whether the first mode is the right one, with a picture of it and by touch alone.
    seen: Regression = Regression(
        weight=0.07318,
        near=0.2299,
        agree=7.975,
        sharp=0.1815,
        past=-8.0,
        hidden=-0.2962,
        behind_hand=-0.06245,
        outline=-23.12,
        within=-9.356,
        ends=9.406,
        touch=1.233,
        outliers=-4.815,
        contact_nats=-0.2552,
        spread=-0.3225,
        anywhere=-1.337,
        constant=-0.6855,
        nearest=0.5335,
    )
    felt: Regression = Regression(
        weight=0.3457,
        near=0.5692,
        outliers=-6.55,
        contact_nats=-0.1741,
        blunt=-2.195,
        far=4.163,
        constant=1.137,
        nearest=0.6868,
    )
    # Share of the picture above which agreement speaks for an answer, and the most of what is seen past, of the outline
    # that runs on and of borders within it (shares) that speaks against one: cameras that blend edges draw surfaces on.
    agreeing: float = 0.8
    most_past: float = 0.3
    most_outline: float = 0.15
    most_within: float = 0.3
    # Share that agrees whose logarithm counts at least.
    least_agreeing: float = 0.02
    # Weight of the first mode and of those like it (no unit) from which nothing else is left beside them.
    alone: float = 0.9999
    # Bounds on the log odds of modes, on nats a contact, and on the spread over the radius, whose logarithm counts.
    most_odds: float = 12.0
    most_nats: float = 8.0
    # Bounds (m) on the sigma of contacts whose logarithm counts: those of the answers that were fitted, beyond which
    # nothing is known.
    finest: float = 0.9e-3
    bluntest: float = 1.6e-3
    narrowest: float = 0.03
    widest: float = 1.0
    # Spread over the radius (no unit) from which ADD-S is less than it: half the answers of touch alone have 0.09.
    far_share: float = 0.1
    # Where the object is, as far as is known, when the first mode is not the right one: rad, and shares of its radius,
    # when no prior says so.
    anywhere_angle: float = 1.5
    anywhere_share: float = 2.0
    # By how much (a factor of variance) an answer is off, beside what its Gaussian says: a factor, and powers of what
    # the frame shows. The share of the picture that is seen past, in units of `least_past` beyond none: what
    # contradicts a pose, however little, tells of errors that no belief describes. The share that agrees,
    # `least_agreeing` at least: what hides the rest smears the pixels beside it. How well the best known turn is
    # known, in units of `usual_turn` (rad) and within bounds: what is known well is known better than is counted of
    # it, what is known badly bends within its own spread. And how far whole blocks of the outline are off, in units
    # of `least_beside` (m) beyond none: the mesh is bent across the rays. Blocks of depth that are off together tell
    # nothing more; a ragged mask does that. The powers make the true errors of 284 answers with a start to 161 frames
    # of the tuning families, within 8 mm, likeliest as a Student distribution of 3.5 degrees of freedom; each family
    # left out, an answer is 0.27 nats likelier than by one factor for all. The likeliest factor is 0.18; with this
    # one regions of 95 % hold 94 % of 410 answers to all tuning families, at a mean NEES of 0.87 per degree of freedom
    # (before what `DepthModel.shift_sigma` adds across the rays). Turns known better than to `least_turn` are seldom
    # there, half a metre off; close up they are usual, and by their own power regions held two thirds.
    widening: float = 0.45
    by_past: float = 1.0
    least_past: float = 0.01
    by_share: float = -0.25
    by_turn: float = 0.9
    usual_turn: float = 0.01
    least_turn: float = 0.006
    most_turn: float = 0.05
    by_beside: float = 0.9
    least_beside: float = 0.1e-3
    most_beside: float = 1e-3
    # Most that is ever said of a mode being the right one (a probability, no unit): 2556 answers tell no more.
    surest: float = 0.999
    # Share of the probability that a region of 95 % need not hold: of what looks like an answer that is ok, and of a
    # track's. Any other frame by itself leaves none out: so regions of 799 such answers of all tuning families hold
    # 96 % and not 94, at a mean NEES of 0.55 per degree of freedom and not 0.84; of `crude` 94 % and not 88.
    left_out: float = 0.05

    def __post_init__(self) -> None:
        """Refuse bounds of logarithms that are none, and what is no tolerance."""
        check_above(self, ("tolerance", "finest", "bluntest", "narrowest", "widest", "least_agreeing"))

    def none_of(self, right: float) -> float:
        """Probability that the first mode is not the right one, less what a region of 95 % need not hold."""
        return max(1.0 - right - self.left_out, 0.0)


def observations(
    model: ObjectModel,
    modes: tuple[Mode, ...],
    picture: Prediction | None,
    contacts: tuple[ContactResidual, ...],
    contact_nats: float,
    settings: ConfidenceSettings,
    anywhere: bool = False,
    same: Alike | None = None,
) -> dict[str, float]:
    """What the regression reads of an answer, by the names of its factors; see `Regression` and `chances`.

    There is "agree" when there is a picture that shows anything.
    """
    s = settings
    same = same or alike(model, modes, s.tolerance)
    weight = float(np.clip(same.weight, 0.0, 1.0))
    ratio = spread_of(model, modes[0].pose, modes[0].covariance) / max(model.radius, 1e-9)
    found = {
        "weight": float(np.clip(_odds(weight), -s.most_odds, s.most_odds)),
        "alone": float(weight > s.alone),
        "near": float(np.clip(_odds(same.near_weight), -s.most_odds, s.most_odds)),
        "spread": float(np.log(np.clip(ratio, s.narrowest, s.widest))),
        "far": max(float(np.log(min(max(ratio, s.narrowest), s.widest) / s.far_share)), 0.0),
        "anywhere": float(anywhere),
        "constant": 1.0,
    }
    if contacts:
        found["touch"] = math.log1p(sum(c.of_finger * _numbers(c) * _sharp(c, s) for c in contacts))
        found["outliers"] = float(np.average([c.outlier for c in contacts], weights=[c.of_finger for c in contacts]))
        found["contact_nats"] = min(contact_nats / len(contacts), s.most_nats)
        found["blunt"] = _blunt(contacts, s)
    if picture is not None and picture.count[0] > 0:
        found["agree"] = max(float(picture.agree[0]) - s.agreeing, 0.0)
        found["visible"] = float(np.log(max(float(picture.agree[0]), s.least_agreeing)))
        found["sharp"] = float(picture.seen[0]) / max(float(picture.agree[0]), s.least_agreeing)
        found["past"] = min(float(picture.past[0]), s.most_past)
        found["outline"] = min(float(picture.outline[0]), s.most_outline)
        found["within"] = min(float(picture.within[0]), s.most_within)
        found["ends"] = float(picture.ends[0])
        found["hidden"], found["behind_hand"] = float(picture.hidden[0]), float(picture.behind_hand[0])
    return found


def _odds(weight: float) -> float:
    """Logarithm of the odds of a share, of neither less than 1e-12."""
    return math.log(max(weight, 1e-12)) - math.log(max(1.0 - weight, 1e-12))


def _numbers(contact: ContactResidual) -> float:
    """How many numbers of a pose a contact ties: one by its place, two more by its normal."""
    return 3.0 if math.isfinite(contact.normal_deg) else 1.0


def _sharp(contact: ContactResidual, settings: ConfidenceSettings) -> float:
    """How sharp a contact is beside the finest, from 0 to 1; one without a sigma is as the bluntest that was fitted."""
    sigma = 1e-3 * contact.sigma_mm if math.isfinite(contact.sigma_mm) else settings.bluntest
    return settings.finest / max(sigma, settings.finest)


def _blunt(contacts: tuple[ContactResidual, ...], settings: ConfidenceSettings) -> float:
    """Logarithm of the contacts' sigma (root mean square) over the finest; 0 where none tells of one."""
    told = [contact.sigma_mm**2 for contact in contacts if math.isfinite(contact.sigma_mm)]
    if not told:
        return 0.0
    sigma = 1e-3 * math.sqrt(sum(told) / len(told))
    return math.log(min(max(sigma, settings.finest), settings.bluntest) / settings.finest)


def chances(
    model: ObjectModel,
    modes: tuple[Mode, ...],
    picture: Prediction | None,
    contacts: tuple[ContactResidual, ...],
    contact_nats: float,
    settings: ConfidenceSettings | None = None,
    anywhere: bool = False,
    same: Alike | None = None,
    read: dict[str, float] | None = None,
) -> tuple[float, float]:
    """Probability that the first mode is the right one, whatever its spread, and that its ADD-S is below the settings'
    tolerance if it is. The first is bounded by what the modes near it hold of the posterior, whose odds are those of
    weights that were tempered: they count twice.

    picture: the predicted one at the answer, None without a depth image. contact_nats: what the contacts cost there, in
    all. anywhere: there was no start. same: the modes that are one answer within that tolerance, None to find them.
    read: the `observations` of all that, None to make them.
    """
    s = settings or ConfidenceSettings()
    same = same or alike(model, modes, s.tolerance)
    read = read or observations(model, modes, picture, contacts, contact_nats, s, anywhere, same)
    factors = s.seen if "agree" in read else s.felt
    score = sum(getattr(factors, name) * value for name, value in read.items())
    right = min(float(1.0 / (1.0 + np.exp(-np.clip(score, -40.0, 40.0)))), s.surest, _held(same.near_weight))
    return right, within_of(model, same, s.tolerance, factors.nearest)


def _held(weight: float) -> float:
    """Most that a mode's chance may be where those near it hold `weight` of the posterior. Of 11 fused answers of the
    tuning families without a start that this takes the `ok` from two were wrong; of 15 that left 5 to 19 % to others
    one was.
    """
    share = min(max(weight, 0.0), 1.0)
    return share**2 / (share**2 + (1.0 - share) ** 2)


def within_of(model: ObjectModel, same: Alike, tolerance: float, nearest: float) -> float:
    """Probability that ADD-S is below tolerance (m) if the right one is the first mode, the same as it or near it. What
    a mode is off by itself comes beside how far it is from the first: in full where all of the surface is as far, by
    its square where a part of it alone, as a handle, is elsewhere. nearest: see `Regression`.
    """
    if not same.near_weight > 0.0:
        return within(model, same.modes[0].pose, same.modes[0].covariance, tolerance, nearest)
    chance = 0.0
    for mode, mean in zip(same.near, same.near_means.tolist()):
        everywhere = any(mode is one for one in same.modes)
        left = tolerance - mean if everywhere else math.sqrt(max(tolerance * tolerance - mean**2, 0.0))
        chance += mode.weight * within(model, mode.pose, mode.covariance, left, nearest)
    return chance / same.near_weight


def within(model: ObjectModel, pose: Array, covariance: Array, tolerance: float, nearest: float) -> float:
    """Probability that ADD-S is below tolerance (m) for an error drawn from a covariance (6, 6) about the centroid.

    nearest: see `Regression`.
    """
    return float(below(*mean_square(model, pose, covariance), tolerance, nearest))


def near_enough(model: ObjectModel, mode: Mode, settings: ConfidenceSettings) -> float:
    """Probability that a mode of what is seen is within the tolerance, by its covariance, if it is the right one."""
    return within(model, mode.pose, mode.covariance, settings.tolerance, settings.seen.nearest)


def below(mean: ArrayLike, variance: ArrayLike, tolerance: float, nearest: float) -> Array:
    """Probability (n,) that ADD-S is below tolerance (m) where the mean square of how far the surface's points are off
    has mean (n,) (m^2) and variance (n,) (m^4): a gamma distribution, by Wilson and Hilferty (1931).

    nearest: see `Regression`.
    """
    mean, variance = np.asarray(mean, dtype=np.float64), np.asarray(variance, dtype=np.float64)
    usual = np.isfinite(mean) & (mean > 0.0) & (variance > 0.0)
    mean, variance, sure = np.where(usual, mean, 1.0), np.where(usual, variance, 1.0), mean <= 0.0
    root = np.sqrt(variance) / (3.0 * mean)
    reach = max(tolerance, 0.0) / nearest
    high = (reach * reach / mean) ** (1.0 / 3.0)  # a power of a huge number is an error, a product infinite
    return np.where(usual, _standard_normal((high - 1.0 + root**2) / root), sure)


def _standard_normal(x: Array) -> Array:
    """Probability that a standard normal number is below x (n,) or (); of one without SciPy, a tenth of a second to
    load.
    """
    if x.ndim == 0:
        return np.asarray(0.5 * math.erfc(-float(x) / math.sqrt(2.0)))
    from scipy.special import ndtr

    return np.asarray(ndtr(x))


def as_shown(
    mode: Mode,
    picture: Prediction | None,
    prior: Prior | None,
    settings: ConfidenceSettings | None = None,
    beside: float = 0.0,
    least: float = 0.0,
) -> Mode:
    """The mode as wide as answers are that fit as well and are known as well; what a prior says stays as it is.

    picture: the predicted one at the mode, None without a depth image: then nothing changes. beside (m): by how much
    whole blocks of the outline are off, 0 where that is not known. least: of the factor on the variance.
    """
    s = settings or ConfidenceSettings()
    if picture is None or not picture.count[0]:
        return mode
    wider = max(_wider(mode, picture, beside, s), least)
    if prior is None:
        return replace(mode, covariance=wider * mode.covariance)
    # in units of its own standard deviations the mode's information is the identity, of which the prior is a part
    width = np.sqrt(np.maximum(np.diag(mode.covariance), 1e-300))
    spread, axes = np.linalg.eigh(mode.covariance / width / width[:, None])
    lower = width[:, None] * axes * np.sqrt(np.maximum(spread, 0.0))
    values, vectors = np.linalg.eigh(lower.T @ prior.information @ lower)
    told = np.clip(values, 0.0, 1.0)
    root = lower @ vectors / np.sqrt(told + (1.0 - told) / wider)
    return replace(mode, covariance=np.asarray(root @ root.T, dtype=np.float64))


def _wider(mode: Mode, picture: Prediction, beside: float, settings: ConfidenceSettings) -> float:
    """Factor on a mode's variance (no unit), see `ConfidenceSettings.widening`."""
    s = settings
    past = 1.0 + min(float(picture.past[0]), s.most_past) / s.least_past
    share = max(float(picture.agree[0]), s.least_agreeing)
    best_known = math.sqrt(max(float(np.linalg.eigvalsh(mode.covariance[:3, :3])[0]), 0.0))
    turn = min(max(best_known, s.least_turn), s.most_turn) / s.usual_turn
    off = 1.0 + min(beside, s.most_beside) / s.least_beside
    return float(s.widening * past**s.by_past * share**s.by_share * turn**s.by_turn * off**s.by_beside)
