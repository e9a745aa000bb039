"""How sure an answer by contacts alone is, by draws of what they allow.

The regression of the confidence knows answers by their modes and by how well contacts fit. A few contacts leave bent
valleys, which no Gaussian about a mode describes, and minima that no search for the best one keeps. So where nothing is
seen poses are drawn from the posterior itself (`touch.posterior`, as `localize` does): what share of them is as near as
is asked bounds the confidence, and where they are wider than the answer, so is it. Camera frame, metres.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenes.evidence.align import Prior
from scenes.evidence.modes import Mode
from scenes.evidence.table import SIGMA
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Contacts
from touch.confidence import DRAWING, posterior_about
from touch.contacts import Felt
from touch.posterior import PosteriorSettings

Array = NDArray[np.float64]


def why_not_drawn(felt: Felt, slack: float, seen: int, word: str, spent: bool) -> str:
    """Why what the contacts allow is not drawn from; "" where it is. slack (m): what a calibration may add to where
    they are; seen: how many rows vision has, of pixels or of a cloud; word: the verdict so far; spent: no time is left.

    What a calibration adds all contacts share, and draws take it for each one's own: they are then asked about an
    answer that is about to be `ok`, and of nothing else.
    """
    if seen:
        return "something is seen"
    if not len(felt.contacts):
        return "nothing is felt at points"
    if slack and word != "ok":
        return "it is in doubt, and how the robot is calibrated is not told by draws"
    return "the time budget is spent" if spent else ""


def drawn_by_touch(
    model: ObjectModel,
    felt: Felt,
    slack: float,
    modes: tuple[Mode, ...],
    prior: Prior | None,
    seed: int,
    tolerance: float,
) -> tuple[float, Array]:
    """Share of what the contacts allow whose ADD-S from the first mode is below tolerance (m), and its second moments
    (6, 6) about that mode.

    slack (m): how far what the robot reports may be from where it is, beside the contacts' own sigmas.
    """
    reported, rows, first = felt.contacts, felt.rows, modes[0].pose
    # rows of contacts come first, and have a finger's own errors in their sigmas; those of `rows` may have slack, too
    sigma = np.hypot(felt.reported_rows.rows[: len(reported), SIGMA], slack)
    # draws take errors for each contact's own: one finger's are as wide as leaves them what they know of its place
    alone = np.ones(len(sigma)) if felt.shared is None else felt.shared.weights(sigma)
    sigma = sigma / np.sqrt(alone)
    contacts = Contacts(reported.points, reported.normals, sigma, reported.sigma_normal)
    rest = rows.take(np.arange(len(reported), len(rows)))
    own, size = np.array([mode.pose for mode in modes]), float(np.sqrt(np.mean(sigma**2)))
    drawn = posterior_about(model, contacts, own, size, np.random.default_rng([seed, DRAWING]), prior, rest)
    return drawn.within(model, first, tolerance, PosteriorSettings()), drawn.covariance_about(model, first)
