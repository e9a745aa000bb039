"""Hessians up to condition 1e16, weights and sigmas over 12 decades, noise of nothing and of everything."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cases.registry import Cases, apart, at_most, is_covariance, is_rigid, is_sound, need
from scenes.evidence.align import Alignment, Prior, align, costs, terms
from scenes.evidence.modes import Mode, ModeSettings, covariance_of, distinct_modes
from scenes.evidence.table import WEIGHT, Evidence, from_contacts
from scenes.geometry import poses as se3
from scenes.recordings.frames import Contacts
from scenes.synthesis import library
from scenes.synthesis.noise.presets import TouchNoise, observe_contacts
from touch.localization import localize

Array = NDArray[np.float64]

CASES = Cases()

TRUTH = se3.make_pose(se3.exp_rotation(np.array([-0.4, 0.9, 0.2])), [0.0, 0.1, 0.5])
CONDITIONS = (1e0, 1e4, 1e8, 1e12, 1e14, 1e16)


def _hessian(condition: float, seed: int, scale: float = 1e6) -> Array:
    """(6, 6) with that condition number once lengths are in radii, in random directions."""
    radius = library.make("l_block").radius
    basis = np.linalg.qr(np.random.default_rng(seed).normal(size=(6, 6)))[0]
    scaled = basis @ np.diag(scale * np.geomspace(1.0, 1.0 / condition, 6)) @ basis.T
    widths = np.array([1.0] * 3 + [radius] * 3)
    return 0.5 * (scaled + scaled.T) / widths / widths[:, None]


@CASES("Hessians", "worst relative error of the covariance", over=CONDITIONS)
def condition(number: float) -> float:
    """The covariance of a nearly singular Hessian is the exact inverse of it plus the widest prior."""
    model, settings = library.make("l_block"), ModeSettings()
    widths = np.array([settings.widest_angle] * 3 + [settings.widest_share * model.radius] * 3)
    worst = 0.0
    for seed in range(20):
        for scale in (1e-6, 1.0, 1e6, 1e12):
            hessian = _hessian(number, seed, scale)
            covariance = covariance_of(model, hessian)
            is_covariance(covariance)
            # in the widths' units no eigenvalue is above 1, and the largest is 1 / (1 + the least information)
            values = np.linalg.eigvalsh(covariance / widths / widths[:, None])
            least = scale / number
            # the Hessian itself is only known to its largest entry's last digit
            slack = 1e-9 + 1e-14 * scale
            worst = max(worst, at_most(abs(values[-1] * (1 + least) - 1) / (1 + slack), 0.05, "widest direction"))
            at_most(values, 1 + 1e-9, "wider than the prior")
    return worst


@CASES("Hessians", "worst negative eigenvalue of a covariance")
def singular_and_worse() -> float:
    """Zero, rank one, huge, tiny, slightly indefinite: every mode's covariance is finite and PSD, weights sum to 1."""
    model = library.make("l_block")
    v = np.array([1.0, -2, 3, 40, 50, -60])
    trials = [np.zeros((6, 6)), np.outer(v, v), 1e16 * np.outer(v, v), 1e-300 * np.eye(6), 1e20 * np.eye(6)]
    trials += [
        np.outer(v, v) - 1e-9 * np.eye(6),
        np.diag([1e12, 0, 0, 0, 0, 0.0]),
        np.diag([0, 0, 0, 1e18, 1e18, 1e-18]),
    ]
    poses = se3.perturb(np.eye(4), np.random.default_rng(0).normal(size=(len(trials), 6)), model.centroid)
    worst = 0.0
    for hessian in trials:
        worst = max(worst, is_covariance(covariance_of(model, hessian)))
    alignment = Alignment(
        poses, 0.5 * np.arange(len(trials), dtype=np.float64), np.array(trials), np.zeros(len(trials), dtype=np.int64)
    )
    modes = distinct_modes(model, alignment)
    for mode in modes:
        worst = max(worst, is_covariance(mode.covariance))
    at_most(abs(sum(m.weight for m in modes) - 1), 1e-12, "weights")
    return worst


@CASES("Hessians", "worst rise of a cost", over=(1e0, 1e4, 1e8, 1e12))
def priors_of_condition(number: float) -> float:
    """Alignment to a prior that holds one direction so much more than another: it arrives, and no cost rises."""
    model = library.make("l_block")
    rng = np.random.default_rng(1)
    worst = 0.0
    for seed in range(5):
        prior = Prior(TRUTH, _hessian(number, seed))
        start = se3.perturb(TRUTH, rng.normal(size=6) * ([0.1] * 3 + [0.01] * 3), model.centroid)[None]
        rows = from_contacts(Contacts(*model.sample_surface(3, seed=seed), 1e-3, 0.1).moved(TRUTH))
        for evidence in (rows, rows.take([])):
            before = costs(model, evidence, start, prior) if len(evidence) else np.array([np.inf])
            found = align(model, evidence, start, prior)
            is_rigid(found.poses)
            need(np.isfinite(found.hessians).all() and np.isfinite(found.costs).all(), "not finite")
            worst = max(worst, at_most(found.costs - before, 0.0, "rise of the cost"))
            is_covariance(covariance_of(model, found.hessians[0]))
    return worst


def _rows(count: int, sigma: float = 1e-3) -> Evidence:
    model = library.make("l_block")
    return from_contacts(Contacts(*model.sample_surface(count, seed=3), sigma, 0.1).moved(TRUTH))


def _starts(count: int) -> Array:
    rng = np.random.default_rng(2)
    model = library.make("l_block")
    return np.array([se3.displaced(TRUTH, np.deg2rad(8), 0.008, model.centroid, rng) for _ in range(count)])


@CASES("weights", "worst rise of a cost")
def weights_over_12_decades() -> float:
    """Rows that count 10^-6 and 10^6 in one table: aligned, finite, the heavy ones are met."""
    model = library.make("l_block")
    rng = np.random.default_rng(3)
    rows = _rows(40)
    worst = 0.0
    for _ in range(5):
        weights = 10.0 ** rng.uniform(-6, 6, len(rows))
        evidence = rows.reweighted(weights)
        starts = _starts(6)
        before = costs(model, evidence, starts)
        found = align(model, evidence, starts)
        is_rigid(found.poses)
        need(np.isfinite(found.costs).all() and np.isfinite(found.hessians).all(), "not finite")
        worst = max(worst, at_most(found.costs - before, 0.0, "rise of the cost"))
        best = found.poses[int(np.argmin(found.costs))]
        heavy = evidence.points[np.argsort(weights)[-3:]]
        at_most(np.abs(model.field.distance(se3.apply(se3.inverse(best), heavy))), 1e-3, "heaviest rows")
        is_covariance(covariance_of(model, found.hessians[0]))
    return worst


@CASES("weights", "difference of the pose, m")
def a_common_factor_changes_nothing() -> float:
    """All weights times 10^-6 to 10^6: the same minimum, the Hessian times that."""
    model = library.make("l_block")
    rows, start = _rows(30), _starts(1)
    reference = align(model, rows, start)
    worst = 0.0
    for power in (-6, -3, 3, 6):
        found = align(model, rows.reweighted(10.0**power), start)
        worst = max(worst, at_most(apart(model, found.poses[0], reference.poses[0])[1], 2e-5, f"10^{power}"))
        ratio = np.diag(found.hessians[0]) / np.diag(reference.hessians[0]) / 10.0**power
        at_most(np.abs(ratio - 1), 0.05, f"Hessian at 10^{power}")
    return worst


@CASES("weights", "worst rise of a cost", over=(1e-12, 1e-9, 1e-6, 1e-3, 1.0, 1e3, 1e9))
def sigma(value: float) -> float:
    """Every contact that sure or that unsure (m): aligned and judged, finite."""
    model = library.make("l_block")
    rows, starts = _rows(20, value), _starts(4)
    before = costs(model, rows, starts)
    found = align(model, rows, starts)
    is_rigid(found.poses)
    need(np.isfinite(found.costs).all() and np.isfinite(found.hessians).all(), "not finite")
    is_covariance(covariance_of(model, found.hessians[0]))
    return at_most(found.costs - before, 0.0, "rise of the cost")


@CASES("weights", "displacement, m")
def no_weight_at_all() -> float:
    """Rows of weight 0 say nothing: the pose stays, the covariance is as wide as can be."""
    model = library.make("l_block")
    rows = _rows(10)
    rows.rows[:, WEIGHT] = 0.0
    start = _starts(1)
    found = align(model, rows, start)
    covariance = covariance_of(model, terms(model, rows, start[0])[2])
    need(np.sqrt(covariance[0, 0]) > 0.9, "sure of a turn that nothing tells")
    return at_most(np.abs(found.poses - start), 1e-12, "moved by nothing")


NOISES = {
    "none": (TouchNoise(point=0.0, normal=0.0), "ok"),
    "0.1 mm": (TouchNoise(point=1e-4, normal=0.01), "ok"),
    "5 mm, 20 degrees": (TouchNoise(point=5e-3, normal=0.35), None),
    "10 cm, half a turn": (TouchNoise(point=0.1, normal=np.pi), "lost"),
    "1 m": (TouchNoise(point=1.0, normal=np.pi), "lost"),
}


@CASES("noise", "displacement, m", over=tuple(NOISES))
def contacts_with_noise(what: str) -> float:
    """From exact contacts to pure noise: sound answers, sure of the exact ones and never of noise."""
    model = library.make("l_block")
    noise, verdict = NOISES[what]
    exact = Contacts(*model.sample_surface(20, seed=7)).moved(TRUTH)
    displacement = 0.0
    for seed in range(3):
        felt = observe_contacts(exact, noise, np.random.default_rng(seed))
        found = localize(model, felt, seed=seed)
        is_sound(found)
        need(verdict is None or found.verdict == verdict, f"verdict {found.verdict} at noise {what}")
        displacement = max(displacement, apart(model, found.pose, TRUTH)[1])
    return at_most(displacement, 1e-3, "displacement") if verdict == "ok" else displacement


@CASES("Hessians", "most nats that a contact tells between two modes")
def another_touch_between_equal_modes() -> float:
    """What one more contact tells about which of two modes is true: at every place a number from nothing to log 2."""
    from fusion.advice.next_touch import gains
    from fusion.estimation.answer import Estimate

    model = library.make("mug")
    turned = TRUTH @ se3.make_pose(se3.exp_rotation(np.array([0.0, 0.0, 0.5 * np.pi])))
    sure = np.diag([1e-3**2] * 3 + [2e-4**2] * 3)
    modes = tuple(Mode(pose, 0.5, 0.0, sure) for pose in (TRUTH, turned))
    nats, between, _ = gains(model, Estimate(0, TRUTH, sure, modes, "ok"), *model.sample_surface(400, seed=0))
    need(np.isfinite(nats).all(), "nats: not finite")
    at_most(-between, 1e-9, "nats below nothing")
    return at_most(between, np.log(2.0) + 1e-9, "nats between two modes")


@CASES("noise", "share of NEES beyond 22.5 (99.9 % of a chi-square of 6)", slow=True)
def a_covariance_that_means_something() -> float:
    """200 trials of 25 contacts of 0.5 mm: the truth is beyond the 99.9 % region in at most 3 % of them."""
    model = library.make("l_block")
    exact = Contacts(*model.sample_surface(25, seed=7)).moved(TRUTH)
    beyond = []
    for seed in range(200):
        felt = observe_contacts(exact, TouchNoise(point=5e-4, normal=0.05), np.random.default_rng(seed))
        found = localize(model, felt, seed=seed)
        delta = se3.difference(found.pose, TRUTH, model.centroid)
        beyond.append(float(delta @ np.linalg.solve(found.covariance, delta)) > 22.46)
    return at_most(float(np.mean(beyond)), 0.03, "share")
