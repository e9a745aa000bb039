"""Why an answer of ours is wrong: was the right pose not found, does the objective prefer the wrong one, or did the
joint solution leave what the pixels said?
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fusion.benchmarks.real.frames import Recorded
from fusion.benchmarks.real.trials import Trial
from fusion.estimation.estimate import estimate
from scenes.recordings.beliefs import usual_beliefs
from scenes.recordings.frames import Frame
from vision.filling import as_measured
from vision.noise import believed_of
from vision.picture.predictor import Predictor


@dataclass(frozen=True)
class Diagnosis:
    """excess: nats by which the answer costs more than the reference, see `excess`; skipped_right: whether the answer
    is right when the joint solution of calibration, depth scale and bias is skipped.
    """

    excess: float
    skipped_right: bool


def diagnose(one: Recorded, trial: Trial, seed: int) -> Diagnosis:
    """One wrong answer of ours, looked at again; `seed` as in that trial."""
    frame = replace(one.frame, prior=trial.prior, mask=one.frame.mask if trial.mask else None)
    pose = estimate(frame, one.model, use=("vision",), budget_ms=0.0, seed=seed).pose
    add_s = one.judge.errors(pose, one.truth).add_s if one.truth is not None else float("nan")
    right = not one.wrong(add_s, one.residual(pose), one.overlap(pose))
    return Diagnosis(excess(one, frame, trial), right)


def excess(one: Recorded, frame: Frame, trial: Trial) -> float:
    """Nats by which the answer costs more than the reference pose under what must be seen of the object, as
    poses are ranked; NaN without a reference. Below 0 the objective prefers the wrong pose.
    """
    if one.reference is None:
        return float("nan")
    frame, _ = as_measured(frame)
    beliefs = believed_of(frame, frame.beliefs or usual_beliefs())
    costs = Predictor(frame, one.model, beliefs.depth).costs(np.array([trial.pose, one.reference]))
    return float(costs[0] - costs[1])
