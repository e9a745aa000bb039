"""How sure an answer by touch alone is, by draws of what its contacts allow.

The regression of the confidence knows answers by their modes and by how well contacts fit. A few contacts leave bent
valleys, which no Gaussian about a mode describes, and minima that no search for the best one keeps. So where nothing is
seen poses are drawn from the posterior itself (`touch.posterior`, as `localize` does): what share of them is as near as
is asked bounds the confidence, and where they are wider than the answer, so is it. Camera frame, metres.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenes.evidence import table as tables
from scenes.evidence.align import Prior
from scenes.evidence.modes import Mode
from scenes.evidence.table import SIGMA
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Contacts
from touch.answers import LocalizeSettings
from touch.contacts import Felt
from touch.multistart import find_candidates
from touch.posterior import posterior_of
from touch.thinning import cells_of, informative

Array = NDArray[np.float64]


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
    s, count, contacts = LocalizeSettings(), len(felt.contacts), felt.contacts
    rows, rng = felt.rows, np.random.default_rng([seed, 1])
    # a finger's own errors are in the sigmas of its rows
    sigma = np.hypot(rows.rows[:count, SIGMA], slack)
    contacts = Contacts(contacts.points, contacts.normals, sigma, contacts.sigma_normal)
    rest = rows.take(np.arange(count, len(rows)))
    if count > s.most_contacts:
        contacts = contacts.take(informative(contacts, cells_of(contacts, s.most_contacts), s.most_contacts))
    searched = find_candidates(model, contacts, tables.stack(tables.from_contacts(contacts), rest), rng, prior, s)
    candidates = np.concatenate([np.array([mode.pose for mode in modes]), searched.poses])
    drawn = posterior_of(model, contacts, candidates, float(np.sqrt(np.mean(sigma**2))), rng, prior, rest, s.posterior)
    first = modes[0].pose
    return drawn.within(model, first, tolerance, s.posterior), drawn.covariance_about(model, first)
