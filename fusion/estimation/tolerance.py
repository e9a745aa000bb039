"""Whether an answer is good enough to stop at, as wide as errors make it that all pixels of a frame share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fusion.estimation.answer import Estimate
from fusion.estimation.settings import EstimateSettings
from scenes.evidence.modes import Mode
from scenes.recordings.beliefs import DepthModel
from scenes.recordings.frames import Frame


def with_shared_errors(modes: tuple[Mode, ...], frame: Frame, depth: DepthModel) -> tuple[Mode, ...]:
    """Modes of the rows alone, as wide along the camera's ray as errors make them that all pixels of a frame share.

    The joint solution learns these from the frame; where it is skipped they are as large as they are believed to be.
    """
    if frame.depth is None:
        return modes
    out = []
    for mode in modes:
        away = mode.pose[:3, 3]
        ray = away / max(float(np.linalg.norm(away)), 1e-9)
        variance = depth.bias_sigma**2 + (depth.scale_sigma * float(np.linalg.norm(away))) ** 2
        wide = mode.covariance.copy()
        wide[3:, 3:] += variance * np.outer(ray, ray)
        out.append(replace(mode, covariance=wide))
    return tuple(out)


def is_within(modes: tuple[Mode, ...], tolerance: tuple[float, float] | None, settings: EstimateSettings) -> bool:
    """Whether one mode holds nearly everything and its largest standard deviations are within tolerance (m, rad)."""
    if tolerance is None or not modes or modes[0].weight < settings.verdict.sure_share:
        return False
    turn, move = (float(np.linalg.eigvalsh(modes[0].covariance[k : k + 3, k : k + 3]).max()) for k in (0, 3))
    return move <= tolerance[0] ** 2 and turn <= tolerance[1] ** 2


def good_enough(answer: Estimate, tolerance: tuple[float, float], settings: EstimateSettings) -> bool:
    """Whether an answer is sure and its largest standard deviations are within tolerance (m, rad)."""
    return answer.verdict == "ok" and not answer.unobservable and is_within(answer.modes, tolerance, settings)
