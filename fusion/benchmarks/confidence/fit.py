"""The regression of the confidence fitted to answers whose truth is known: by maximum likelihood, with a penalty.

The confidence is a product: that the mode is the right one, a logistic regression (Platt 1999), times that the answer
is then within a tolerance, a gamma distribution (see `fusion.estimation.posterior.confidence`). Nobody sees which of
the two an answer failed by, so both are fitted together, to whether answers are within three tolerances. A factor of
the regression keeps the sign that its feature must have; the penalty is Gaussian, on factors of standardised features
(Hoerl and Kennard 1970).
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from fusion.benchmarks.confidence.answers import Told
from fusion.estimation.posterior.confidence import FEATURES, ConfidenceSettings, Feature, Regression, below
from scenes.errors import InputError

Array = NDArray[np.float64]

# Tolerances (m) that are fitted, and what an answer counts at each: most at the one that is the default.
TOLERANCES, COUNTS = (0.003, 0.005, 0.010), (0.25, 1.0, 0.5)
# Deviation that is believed of a standardised factor, log odds, weak as in Gelman et al. (Annals of Applied Statistics
# 2008); features that vary less than the second number are left out.
FACTOR_SIGMA, LEAST_VARIED = 1.5, 1e-6
# Share of answers that are right or wrong for no reason that a feature tells: none costs more than 9 nats.
LAPSE = 1e-4
# Believed of `nearest`: ADD-S over the root mean square, the deviation of its logarithm, and bounds.
NEAREST, NEAREST_SIGMA, NEAREST_BOUNDS = 0.7, 0.5, (0.1, 1.5)
# Fewest answers, and of either kind, that anything is fitted to.
FEWEST, FEWEST_OF_A_KIND = 30, 5
# Steps of the search, and the one in ln(nearest) by which its slope is taken.
STEPS, SLOPE_STEP = 500, 1e-4


@dataclass(frozen=True)
class Sample:
    """n answers of one model, with a picture or by touch alone. values (n, k): features; add_s (n,) m; mean, variance
    (n,) m^2, m^4.
    """

    features: tuple[Feature, ...]
    values: Array
    add_s: Array
    mean: Array
    variance: Array

    @staticmethod
    def of(answers: Sequence[Told], seen: bool) -> Sample:
        """The answers, all of the same kind."""
        features = tuple(f for f in FEATURES if (f.seen if seen else f.felt))
        names = [f.name for f in features]
        values = np.array([a.values(names) for a in answers], dtype=np.float64).reshape(len(answers), len(names))
        numbers = np.array([(a.add_s, a.mean, a.variance) for a in answers], dtype=np.float64).reshape(-1, 3)
        return Sample(features, values, *numbers.T)

    def part(self, which: NDArray[np.bool_]) -> Sample:
        """Some of the answers."""
        return Sample(self.features, self.values[which], self.add_s[which], self.mean[which], self.variance[which])

    def score(self, factors: Regression) -> Array:
        """(n,) log odds that the mode is the right one."""
        return self.values @ np.array([getattr(factors, f.name) for f in self.features])

    def confidence(self, factors: Regression, tolerance: float) -> Array:
        """(n,) as `chances` has it: both factors of the probability."""
        near = below(self.mean, self.variance, tolerance, factors.nearest)
        return _logistic(self.score(factors)) * near


def _logistic(score: Array) -> Array:
    return np.asarray(1.0 / (1.0 + np.exp(-np.clip(score, -40.0, 40.0))), dtype=np.float64)


def fit(sample: Sample, held: Regression | None = None, only: Collection[str] = ()) -> Regression:
    """The regression that makes the answers most likely. Features that none of them tells keep a factor of 0.

    held: with the names of factors in `only`, these alone are fitted, and the others stay as there. Raises InputError
    for too few answers, right or wrong.
    """
    from scipy.optimize import minimize

    right = int((sample.add_s < ConfidenceSettings().tolerance).sum())
    if len(sample.add_s) < FEWEST or min(right, len(sample.add_s) - right) < FEWEST_OF_A_KIND:
        raise InputError(
            f"fit-confidence: expected {FEWEST} answers or more, {FEWEST_OF_A_KIND} of them right and as many wrong,"
            f" got {len(sample.add_s)}, {right} of them right: more trials, objects, levels or families"
        )
    # the constant does not vary, and is no feature to be shrunk
    constant = np.array([f.name == "constant" for f in sample.features])
    spread = sample.values.std(axis=0)
    used = constant | (spread > LEAST_VARIED)
    scale = np.where(constant, 1.0, spread)[used]
    values = sample.values[:, used] / scale
    shrunk = ~constant[used]
    features = [f for f, there in zip(sample.features, used) if there]
    right_at = np.array([sample.add_s < tolerance for tolerance in TOLERANCES], dtype=np.float64)
    cost = _Cost(values, right_at, sample, shrunk)
    least = [f.sign * f.least * one for f, one in zip(features, scale)]
    bounds = [(one if f.sign > 0 else None, one if f.sign < 0 else None) for f, one in zip(features, least)]
    start = np.append(least, np.log(NEAREST))
    limits = [*bounds, tuple(np.log(NEAREST_BOUNDS))]
    if held is not None:
        names = [*(f.name for f in features), "nearest"]
        stands = np.array([getattr(held, name) for name in names])
        stands = np.append(stands[:-1] * scale, np.log(stands[-1]))
        stays = np.array([name not in only for name in names])
        start = np.where(stays, stands, start)
        limits = [(at, at) if stay else limit for at, stay, limit in zip(stands, stays, limits)]
    found = minimize(cost, start, jac=True, method="L-BFGS-B", bounds=limits, options={"maxiter": STEPS})
    named = {f.name: float(value) for f, value in zip(features, found.x[:-1] / scale)}
    nearest = float(np.exp(found.x[-1]))
    if held is None:
        return Regression(**named, nearest=nearest)
    return replace(held, **{name: value for name, value in {**named, "nearest": nearest}.items() if name in only})


@dataclass(frozen=True)
class _Cost:
    """Nats of the answers and of the penalty, with their slope. values (n, k) standardised; right_at (t, n): whether an
    answer is within each tolerance.
    """

    values: Array
    right_at: Array
    sample: Sample
    shrunk: NDArray[np.bool_]

    def __call__(self, x: Array) -> tuple[float, Array]:
        """At (k + 1,) factors and ln(nearest)."""
        factors, log_nearest = x[:-1], x[-1]
        mode = _logistic(self.values @ factors)
        nats, by_score, by_nearest = 0.0, np.zeros(len(mode)), 0.0
        for right, tolerance, count in zip(self.right_at, TOLERANCES, COUNTS):
            near, slope = self._near(tolerance, log_nearest)
            sure = LAPSE + (1.0 - 2.0 * LAPSE) * mode * near
            nats -= count * float(np.sum(right * np.log(sure) + (1.0 - right) * np.log1p(-sure)))
            by_sure = -count * (right / sure - (1.0 - right) / (1.0 - sure)) * (1.0 - 2.0 * LAPSE)
            by_score += by_sure * mode * (1.0 - mode) * near
            by_nearest += float(np.sum(by_sure * mode * slope))
        weight = 0.5 / FACTOR_SIGMA**2
        nats += weight * float(np.sum(factors[self.shrunk] ** 2))
        off = (log_nearest - np.log(NEAREST)) / NEAREST_SIGMA
        nats += 0.5 * off**2
        slope_of_factors = by_score @ self.values + 2.0 * weight * np.where(self.shrunk, factors, 0.0)
        return nats, np.append(slope_of_factors, by_nearest + off / NEAREST_SIGMA)

    def _near(self, tolerance: float, log_nearest: float) -> tuple[Array, Array]:
        """(n,) probability of being near, and its slope in ln(nearest)."""
        low, here, high = (
            below(self.sample.mean, self.sample.variance, tolerance, float(np.exp(log_nearest + step)))
            for step in (-SLOPE_STEP, 0.0, SLOPE_STEP)
        )
        return here, (high - low) / (2.0 * SLOPE_STEP)


@dataclass(frozen=True)
class Fitted:
    """One model. seen: with a picture; answers that it was fitted to; factors of all; left_out: of all but one family,
    by the family; held (n,): confidence at the default tolerance that the fit without an answer's own family gives it.
    """

    seen: bool
    answers: tuple[Told, ...]
    factors: Regression
    left_out: dict[str, Regression]
    held: Array
    sample: Sample

    @property
    def name(self) -> str:
        """As the settings have it."""
        return "seen" if self.seen else "felt"

    def between(self, feature: str) -> tuple[float, float]:
        """Least and largest of its factor, one family left out."""
        found = [getattr(one, feature) for one in self.left_out.values()] or [getattr(self.factors, feature)]
        return min(found), max(found)


def fit_model(
    answers: Sequence[Told], seen: bool, held: Regression | None = None, only: Collection[str] = ()
) -> Fitted:
    """The regression of the answers with a picture, or of those without, of all and with each family left out in turn.
    held, only: see `fit`.

    With one family alone none can be left out: what it holds is then what it was fitted to.
    """
    mine = tuple(sorted((a for a in answers if a.seen == seen and a.sense != "none"), key=_order))
    sample = Sample.of(mine, seen)
    factors = fit(sample, held, only)
    families = np.array([a.family for a in mine])
    tolerance = ConfidenceSettings().tolerance
    stated, left_out = sample.confidence(factors, tolerance), {}
    names = sorted(set(families.tolist()))
    for name in names if len(names) > 1 else []:
        own = families == name
        left_out[name] = fit(sample.part(~own), held, only)
        stated[own] = sample.part(own).confidence(left_out[name], tolerance)
    return Fitted(seen, mine, factors, left_out, stated, sample)


def _order(told: Told) -> tuple[object, ...]:
    """Not by who was done first: sums must come out the same."""
    return (*told.place, told.sense, told.start)


def as_literal(factors: Regression) -> str:
    """The regression as it stands in the settings, to four digits; factors of 0 are left out."""
    named = {f.name: getattr(factors, f.name) for f in fields(Regression)}
    told = ", ".join(f"{name}={float(f'{value:.4g}')!r}" for name, value in named.items() if value != 0.0)
    return f"Regression({told})"
