"""Random input by the thousand: no NaN, no exception but ours, and no step of the aligner that raises the cost."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cases.registry import Cases, at_most, is_covariance, is_rigid, is_sound, need, survives
from scenes.errors import PalpateError
from scenes.evidence.align import AlignSettings, Prior, align, costs
from scenes.evidence.modes import covariance_of
from scenes.evidence.table import TOUCH, VISION, Evidence, make, stack
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Contacts, EmptyRegions, Frame
from scenes.synthesis import library
from touch.localization import localize

Array = NDArray[np.float64]

CASES = Cases()

NAMES = ("box", "l_block", "cylinder", "mug")
# Values that a random input is salted with.
SALT = (0.0, -0.0, 1e-300, 5e-324, 1e-9, 1.0, -1.0, 1e3, 1e8, 1e20, np.inf, -np.inf, np.nan)


def _scale(rng: np.random.Generator) -> float:
    """A length from 1 um to 100 m, mostly that of an object."""
    return float(10.0 ** rng.choice([-6, -3, -1.5, -1, -1, -1, 0, 2]))


def _points(model: ObjectModel, rng: np.random.Generator, count: int) -> Array:
    """(count, 3): on the surface, about it, on a line, in one place, anywhere."""
    kind = rng.integers(5)
    if kind == 0:
        return model.sample_surface(count, seed=int(rng.integers(2**31)))[0]
    if kind == 1:
        surface = model.sample_surface(count, seed=int(rng.integers(2**31)))[0]
        return surface + rng.normal(size=(count, 3)) * _scale(rng) * 0.1
    if kind == 2:
        return rng.normal(size=3) * 0.05 + np.linspace(-1, 1, count)[:, None] * rng.normal(size=3) * 0.1
    if kind == 3:
        return np.tile(rng.normal(size=3) * _scale(rng), (count, 1))
    return rng.normal(size=(count, 3)) * _scale(rng)


def random_rows(model: ObjectModel, rng: np.random.Generator) -> Evidence:
    """A table of 1 to 30 rows of every kind."""
    parts = []
    for _ in range(int(rng.integers(1, 4))):
        count = int(rng.integers(1, 11))
        points = _points(model, rng, count)
        directions = se3.random_unit_vectors(count, rng)
        normals = directions if rng.random() < 0.5 else None
        options: dict[str, Any] = {
            "weight": 10.0 ** rng.uniform(-6, 6, count) if rng.random() < 0.3 else 1.0,
            "gate_above": float(rng.choice([0.0, 2.0, 4.0, 1e6])),
            "gate_below": float(rng.choice([0.0, 2.0, 4.0, 1e6])),
            "offset": float(rng.choice([0.0, 0.01, -0.01])),
        }
        sense = int(rng.choice([VISION, TOUCH]))
        rays = directions if normals is None and rng.random() < 0.5 else None
        parts.append(
            make(
                points,
                10.0 ** rng.uniform(-6, 0, count),
                sense,
                normals=normals,
                sigma_normal=float(10.0 ** rng.uniform(-3, 0.5)),
                rays=rays,
                from_outside=bool(rng.random() < 0.5),
                **options,
            )
        )
    return stack(*parts)


def random_start(model: ObjectModel, rng: np.random.Generator) -> Array:
    """(1, 4, 4): anywhere, near the identity, half a turn away."""
    angle = rng.choice([0.0, 1e-9, 0.1, 1.0, np.pi])
    turn = se3.exp_rotation(angle * se3.random_unit_vectors(1, rng)[0])
    return se3.make_pose(turn, rng.normal(size=3) * _scale(rng) * 0.1)[None]


def one_alignment(seed: int) -> float:
    """A random table, start, prior and settings: every further step keeps or lowers the cost; nothing is NaN."""
    rng = np.random.default_rng([1, seed])
    model = library.make(NAMES[seed % len(NAMES)])
    rows, start = random_rows(model, rng), random_start(model, rng)
    prior = None
    if rng.random() < 0.4:
        prior = Prior.isotropic(
            random_start(model, rng)[0], float(10.0 ** rng.uniform(-4, 1)), float(10.0 ** rng.uniform(-5, 1))
        )
    blur, blur_normal = float(rng.choice([0.0, 0.01])), float(rng.choice([0.0, 0.3]))
    huber = float(rng.choice([0.0, 0.0, 0.5, 3.0]))
    before = costs(model, rows, start, prior, AlignSettings(blur, blur_normal, huber))[0]
    need(np.isfinite(before), f"seed {seed}: cost {before}")
    worst = 0.0
    for steps in (1, 2, 3, 8, 30):
        settings = AlignSettings(blur, blur_normal, huber, iterations=steps)
        found = align(model, rows, start, prior, settings)
        is_rigid(found.poses, f"seed {seed}")
        need(np.isfinite(found.costs).all() and np.isfinite(found.hessians).all(), f"seed {seed}: not finite")
        rise = float(found.costs[0] - before)
        # rows are summed in another order where some of them are left out
        rounding = 1e-12 * (1.0 + abs(float(before)))
        worst = max(worst, at_most(rise, rounding, f"seed {seed}, step {steps}: rise of the cost"))
        # the cost that is told is the cost of the pose that is told, but for the rotation's last digits
        # (a one-sided row may end on its wall, where they decide whether it counts: then a hair's breadth aside)
        aside = 1e-12 * np.concatenate([np.zeros((1, 6)), np.eye(6), -np.eye(6)])
        near = np.array([se3.perturb(found.poses[0], step, model.centroid) for step in aside])
        again = costs(model, rows, near, prior, settings)
        off = float((np.abs(again - found.costs[0]) / (1 + np.abs(again))).min())
        at_most(off, 1e-6, f"seed {seed}, step {steps}: cost told and cost")
        before = found.costs[0]
        is_covariance(covariance_of(model, found.hessians[0]), f"seed {seed}")
    return worst


def _salted(array: Array, rng: np.random.Generator) -> Array:
    out = np.array(array)
    if out.size and rng.random() < 0.3:
        out.ravel()[rng.integers(out.size, size=int(rng.integers(1, 4)))] = rng.choice(SALT)
    return out


def random_contacts(model: ObjectModel, rng: np.random.Generator) -> Contacts:
    """Contacts that may be refused."""
    count = int(rng.choice([0, 1, 2, 3, 5, 8, 20]))
    points = _salted(_points(model, rng, max(count, 1))[:count], rng)
    normals = _salted(rng.normal(size=(count, 3)), rng) if rng.random() < 0.5 else None
    sigma = float(rng.choice([1e-6, 1e-4, 1e-3, 1e-2, 1.0, 1e3, *SALT])) if rng.random() < 0.7 else None
    sigma_normal = float(rng.choice([1e-3, 0.1, 1.0, 10.0])) if rng.random() < 0.5 else None
    return Contacts(points, normals, sigma, sigma_normal)


def one_answer(seed: int) -> float:
    """Random contacts, salted with NaN and worse, through the public functions: a sound answer or one of our errors."""
    from fusion.estimation.estimate import estimate

    rng = np.random.default_rng([2, seed])
    model = library.make(NAMES[seed % len(NAMES)])
    try:
        contacts = random_contacts(model, rng)
    except PalpateError:
        return 1.0
    prior = _salted(random_start(model, rng)[0], rng) if rng.random() < 0.5 else None
    empty = None
    if rng.random() < 0.3:
        count = int(rng.integers(1, 5))
        balls = _salted(_points(model, rng, count), rng), np.abs(_salted(rng.normal(size=count) * 0.01, rng))
        empty = survives(lambda: EmptyRegions(*balls, ["e"] * count), f"seed {seed}, EmptyRegions")
    frame = Frame(0, contacts=contacts, no_contact=empty)
    answer = survives(lambda: estimate(frame, model, prior=prior, seed=seed), f"seed {seed}, estimate")
    if answer is not None:
        is_sound(answer, f"seed {seed}, estimate")
    found = survives(lambda: localize(model, contacts, seed=seed), f"seed {seed}, localize")
    if found is not None:
        is_sound(found, f"seed {seed}, localize")
    return float(answer is None and found is None)


@CASES("fuzz", "largest rise of a cost")
def aligner_on_300_tables(count: int = 300) -> float:
    """Steps 1, 2, 3, 8 and 30 on random tables, starts and priors."""
    return max(one_alignment(seed) for seed in range(count))


@CASES("fuzz", "share refused")
def public_functions_on_60_inputs(count: int = 60) -> float:
    """Estimate and localize on random contacts, salted."""
    return float(np.mean([one_answer(seed) for seed in range(count)]))


@CASES("fuzz", "largest rise of a cost", slow=True)
def aligner_on_100000_tables() -> float:
    """10^5 of them."""
    return aligner_on_300_tables(100_000)


@CASES("fuzz", "share refused", slow=True)
def public_functions_on_3000_inputs() -> float:
    """3000 of them."""
    return public_functions_on_60_inputs(3000)
