"""How likely an answer is right: the probability that its error is below a tolerance the caller names.

A covariance speaks of one minimum; it says nothing of answers in another, or of a picture that no pose explains. What
does is how the predicted picture and the contacts agree, and with what. A logistic regression on these, fitted once to
answers whose truth is known, turns them into a probability (Platt 1999; Niculescu-Mizil and Caruana 2005).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fusion.estimation.answer import ContactResidual, Mode
from scenes.geometry.objects import ObjectModel
from vision.predicted import Prediction

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ConfidenceSettings:
    """The regression. Tuned on 559 answers of the families `clean`, `lab`, `loose`, `d435` and `desk`
    (docs/evaluation.md), both senses and vision alone, with a start and without. In five-fold cross-validation answers
    above 0.8 were right in 98 %, between 0.8 and 0.9 in 94 %.
    """

    # Error (ADD-S, m) that is good enough when the caller does not say.
    tolerance: float = 0.005
    # Confidence (a probability, no unit) from which an answer is `ok`.
    sure: float = 0.80
    # Factors, no unit, of the first mode's weight and of the shares of the predicted picture that agree, are seen past,
    # are hidden by something unknown, by the robot's hand, and of the outline that runs on.
    weight: float = 0.58
    agree: float = 6.36
    past: float = -10.78
    hidden: float = 4.61
    behind_hand: float = 4.99
    outline: float = -6.87
    # Of the share of contacts that are outliers, of their cost (nats each, at most `most_nats`), and of there being
    # any.
    outliers: float = -0.68
    contact_nats: float = -0.77
    most_nats: float = 8.0
    touch: float = 5.43
    # Of the logarithm of the pose's spread (as metres of its surface) over the tolerance, which is held between two
    # bounds; and the constant.
    spread: float = -1.11
    narrowest: float = 0.02
    widest: float = 20.0
    constant: float = -3.52


def spread_of(model: ObjectModel, pose: Array, covariance: Array) -> float:
    """Standard deviation (m) of where the object's surface is, from a covariance (6, 6) about the centroid of a pose
    (4, 4); turns about the object's own axes move nothing.
    """
    known = model.symmetries.quotient(pose[:3, :3], model.centroid)
    held = known @ covariance @ known.T
    variance = np.trace(held[3:, 3:]) + 2.0 / 3.0 * model.radius**2 * np.trace(held[:3, :3])
    return float(np.sqrt(max(float(variance), 0.0)))


def confidence(
    model: ObjectModel,
    modes: tuple[Mode, ...],
    picture: Prediction | None,
    contacts: tuple[ContactResidual, ...],
    contact_nats: float,
    tolerance: float | None = None,
    settings: ConfidenceSettings | None = None,
) -> float:
    """Probability that the first mode's ADD-S is below tolerance (m).

    picture: the predicted one at the answer, None without a depth image: then only the posterior speaks. contact_nats:
    what the contacts cost there, in all.
    """
    s = settings or ConfidenceSettings()
    tolerance = s.tolerance if tolerance is None else tolerance
    ratio = spread_of(model, modes[0].pose, modes[0].covariance) / max(tolerance, 1e-9)
    if picture is None or picture.count[0] == 0:
        # the surface's error is about a normal vector's length: its mean square is the spread's
        inside = math.erf(1.0 / (math.sqrt(2.0) * max(ratio, 1e-9)))
        return float(np.clip(modes[0].weight * inside, 0.0, 1.0))
    score = s.constant + s.weight * modes[0].weight
    score += s.agree * picture.agree[0] + s.past * picture.past[0] + s.outline * picture.outline[0]
    score += s.hidden * picture.hidden[0] + s.behind_hand * picture.behind_hand[0]
    score += s.spread * float(np.log(np.clip(ratio, s.narrowest, s.widest)))
    if contacts:
        score += s.touch + s.outliers * float(np.mean([c.outlier for c in contacts]))
        score += s.contact_nats * min(contact_nats / len(contacts), s.most_nats)
    return float(1.0 / (1.0 + np.exp(-np.clip(score, -40.0, 40.0))))
