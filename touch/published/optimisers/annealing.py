"""Simulated annealing on the compiled cost of T1 eq. 4.1, as in T1 table 5.2: scipy's generalised annealing (Tsallis
visits, Xiang et al. 1997) without its local search, then one polish.
"""

from __future__ import annotations

import time

import numpy as np

from scenes.evidence.align import Prior
from scenes.evidence.table import Evidence
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Contacts
from touch.answers import Localization
from touch.multistart import refine_contacts
from touch.published.answers import conclude
from touch.published.optimisers.direct import BoxSettings, objective


def localize(
    model: ObjectModel, contacts: Contacts, seed: int, prior: Prior | None, extra: Evidence | None
) -> Localization:
    """The method behind `touch.localize(method="annealing")`."""
    from scipy.optimize import dual_annealing

    model.field  # noqa: B018  (built before anything is timed)
    begin = time.perf_counter()
    settings = BoxSettings()
    cost, bounds, pose = objective(model, contacts, prior, settings)
    found = dual_annealing(
        cost,
        bounds,
        maxfun=settings.evaluations,
        maxiter=settings.evaluations,
        no_local_search=True,
        rng=np.random.default_rng(seed),
    )
    polished = refine_contacts(model, contacts, pose(found.x)[None]).poses
    return conclude(model, contacts, polished, "annealing", begin, None, extra)
