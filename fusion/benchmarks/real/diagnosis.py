"""Why an answer of ours is wrong: was the right pose not found, or does the objective like the wrong one better?"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fusion.benchmarks.real.frames import Recorded
from fusion.benchmarks.real.trials import Trial
from fusion.estimation.stages import EstimateSettings, look, vision_rows
from scenes.evidence import align
from vision.sight import Sight


def excess(one: Recorded, trial: Trial) -> float:
    """Nats by which the answer costs more than the reference pose under the rows of vision and the sight lines, as the
    search ranks them; NaN without a reference or without rows.

    Above 0 the search missed a better pose; below 0 the objective prefers the wrong one. The joint solution, which
    comes after, has terms of its own that are not in it.
    """
    if one.reference is None:
        return float("nan")
    settings = EstimateSettings()
    frame = replace(one.frame, prior=trial.prior, mask=one.frame.mask if trial.mask else None)
    rows = vision_rows(look(frame, one.model, trial.prior, settings)[0], settings)
    if not len(rows):
        return float("nan")
    both = np.array([trial.pose, one.reference])
    costs = align.costs(one.model, rows, both) + Sight(frame, one.model, settings.depth).costs(both)
    return float(costs[0] - costs[1])
