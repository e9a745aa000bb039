"""What a case of the stability suite is, how it judges, and the one list that both the tests and the bench run through.

A case tries to break one thing: it raises `Unstable` when it succeeds, and otherwise returns the worst number that it
met (an error, an eigenvalue, a count). Cases live in the modules below, one or a few themes each.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scenes.errors import PalpateError
from scenes.geometry import poses as se3

Array = NDArray[np.float64]

# Modules with cases, in the order of the table.
MODULES = tuple(
    f"cases.{name}" for name in ("poses", "objects", "contacts", "numbers", "values", "invariance", "fuzz", "files")
)
# How far a rotation may be from orthonormal, and how far a covariance from symmetric (share of its largest entry).
ORTHONORMAL = 1e-9
SYMMETRIC = 1e-9
# Eigenvalues of a covariance may be this much below zero (share of the largest): round-off of a 6x6 product.
NEGATIVE = 1e-12


class Unstable(AssertionError):
    """A case that broke what it tried to break, and with what number."""


@dataclass(frozen=True)
class Case:
    """theme, what is tried and on which of several inputs, for the table; run() -> worst number, or Unstable; number:
    what that is, with its unit; slow: a minute rather than a second.
    """

    theme: str
    what: str
    argument: str
    run: Callable[[], float]
    number: str
    slow: bool = False

    def __str__(self) -> str:
        return f"{self.theme}: {self.what} {self.argument}".strip()


class Cases:
    """The cases of one module, filled by a decorator: `@CASES("theme", "worst error, m")`."""

    def __init__(self) -> None:
        self.found: list[Case] = []

    def __call__(
        self, theme: str, number: str, over: Sequence[Any] = (None,), slow: bool = False
    ) -> Callable[[Callable[..., float]], Callable[..., float]]:
        """One case, named after the function; or one for each argument of `over`, named by it."""

        def add(function: Callable[..., float]) -> Callable[..., float]:
            name = function.__name__.strip("_").replace("_", " ")
            for argument in over:
                run = function if argument is None else partial(function, argument)
                label = "" if argument is None else str(argument)
                self.found.append(Case(theme, name, label, run, number, slow))
            return function

        return add


def all_cases(slow: bool | None = None) -> list[Case]:
    """Every case of every module; only the slow or only the fast ones when asked for."""
    found = [case for module in MODULES for case in import_module(module).CASES.found]
    return [case for case in found if slow is None or case.slow == slow]


def need(good: bool | np.bool_, message: str) -> None:
    """Raise Unstable with the message unless `good`."""
    if not good:
        raise Unstable(message)


def at_most(value: ArrayLike, limit: float, what: str) -> float:
    """The largest of the values; Unstable when it is above the limit or not a number."""
    array = np.asarray(value, dtype=np.float64).ravel()
    if not array.size:
        return 0.0
    largest = float(array.max())  # NaN when there is one, and that is not at most anything
    if not largest <= limit:
        raise Unstable(f"{what}: expected at most {limit:.3g}, got {largest:.6g}")
    return largest


def is_rigid(pose: Array, what: str = "pose") -> float:
    """Unstable unless pose(s) (..., 4, 4) are finite rigid transforms; returns how far off orthonormal they are."""
    need(np.isfinite(pose).all(), f"{what}: not finite")
    need(np.array_equal(pose[..., 3, :], np.broadcast_to([0.0, 0, 0, 1], pose[..., 3, :].shape)), f"{what}: last row")
    rotation = pose[..., :3, :3]
    error = np.abs(np.swapaxes(rotation, -1, -2) @ rotation - np.eye(3)).max(initial=0.0)
    need(bool((np.linalg.det(rotation) > 0).all()), f"{what}: mirrored")
    return at_most(error, ORTHONORMAL, f"{what}: off orthonormal")


def is_covariance(covariance: Array, what: str = "covariance") -> float:
    """Unstable unless (6, 6) is finite, symmetric and positive semidefinite; returns its most negative share (>= 0)."""
    need(covariance.shape == (6, 6) and np.isfinite(covariance).all(), f"{what}: not a finite 6x6 matrix")
    largest = float(np.abs(covariance).max())
    at_most(np.abs(covariance - covariance.T).max(), SYMMETRIC * largest, f"{what}: asymmetry")
    # judged in its own units: radians and metres differ by orders of magnitude
    scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    values = np.linalg.eigvalsh(0.5 * (covariance + covariance.T) / scale / scale[:, None])
    return at_most(max(0.0, -values[0]), 1e3 * NEGATIVE, f"{what}: negative eigenvalue")


def is_sound(answer: Any, what: str = "answer") -> float:
    """Unstable unless an Estimate or Localization has rigid poses, covariances, weights that sum to 1, a verdict."""
    worst = is_rigid(answer.pose, what)
    need(answer.verdict in ("ok", "ambiguous", "lost"), f"{what}: verdict {answer.verdict!r}")
    need(len(answer.modes) > 0, f"{what}: no mode")
    for mode in answer.modes:
        worst = max(worst, is_rigid(mode.pose, f"{what}, mode"))
        is_covariance(mode.covariance, f"{what}, mode")
        need(0.0 <= mode.weight <= 1.0 + 1e-12, f"{what}: weight {mode.weight}")
        need(not np.isnan(mode.cost), f"{what}: cost is not a number")
    is_covariance(answer.covariance, what)
    at_most(abs(sum(mode.weight for mode in answer.modes) - 1.0), 1e-9, f"{what}: weights off 1")
    return worst


def refuses(call: Callable[[], object], what: str, words: Iterable[str] = ()) -> float:
    """Unstable unless the call raises one of our errors, in one line that says what was expected (or the words)."""
    try:
        call()
    except PalpateError as error:
        text = str(error)
        for word in words or ("expected",):
            need(word in text, f"{what}: expected {word!r} in the message, got {text!r}")
        return 0.0
    except Exception as error:
        raise Unstable(f"{what}: raised {type(error).__name__}: {error}") from error
    raise Unstable(f"{what}: accepted")


def survives(call: Callable[[], Any], what: str) -> Any:
    """What the call returns, None when it raises one of our errors; Unstable for any other exception."""
    try:
        return call()
    except PalpateError:
        return None
    except Exception as error:
        raise Unstable(f"{what}: raised {type(error).__name__}: {error}") from error


def apart(model: Any, pose: Array, other: Array) -> tuple[float, float]:
    """Rotation (rad) and displacement of the centroid (m) between two poses, modulo the object's symmetries."""
    delta = se3.difference(model.symmetries.nearest(pose, other), other, model.centroid)
    return float(np.linalg.norm(delta[:3])), float(np.linalg.norm(delta[3:]))
