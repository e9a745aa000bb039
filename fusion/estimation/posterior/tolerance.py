"""Whether an answer is good enough to stop at, as wide as errors make it that all pixels of a frame share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fusion.estimation.answer import Estimate
from fusion.estimation.settings import EstimateSettings
from scenes.evidence.modes import Mode
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.beliefs import DepthModel
from scenes.recordings.frames import Frame


def with_shared_errors(
    model: ObjectModel, modes: tuple[Mode, ...], frame: Frame, depth: DepthModel
) -> tuple[Mode, ...]:
    """Modes of the rows alone, as wide along the camera's ray as errors make them that all pixels of a frame share.

    The joint solution learns these from the frame; where it is skipped they are as large as they are believed to be.
    """
    if frame.depth is None:
        return modes
    out = []
    for mode in modes:
        away = se3.apply(mode.pose, model.centroid[None])[0]
        ray = away / max(float(np.linalg.norm(away)), 1e-9)
        variance = depth.bias_sigma**2 + (depth.scale_sigma * float(np.linalg.norm(away))) ** 2
        wide = mode.covariance.copy()
        wide[3:, 3:] += variance * np.outer(ray, ray)
        out.append(replace(mode, covariance=wide))
    return tuple(out)


def with_shift(model: ObjectModel, mode: Mode, frame: Frame, depth: DepthModel) -> Mode:
    """The mode as wide across the camera's rays as the whole depth image may lie beside where the camera's model has
    it: no pixel tells, and no other sense is known well enough beside the camera to do so.
    """
    if frame.depth is None or frame.camera is None:
        return mode
    away = max(float(se3.apply(mode.pose, model.centroid[None])[0, 2]), 0.0)
    across = depth.shift_sigma * away / np.array([frame.camera.fx, frame.camera.fy])
    wide = mode.covariance.copy()
    wide[[3, 4], [3, 4]] += across**2
    return replace(mode, covariance=wide)


def is_within(
    model: ObjectModel, modes: tuple[Mode, ...], tolerance: tuple[float, float] | None, settings: EstimateSettings
) -> bool:
    """Whether one mode holds nearly everything and its largest standard deviations are within tolerance (m, rad).

    Turns about the object's own axes are no deviation.
    """
    if tolerance is None or not modes or modes[0].weight < settings.verdict.sure_share:
        return False
    own = model.symmetries.quotient(modes[0].pose[:3, :3], model.centroid)
    doubtful = own @ modes[0].covariance @ own.T
    turn, move = (float(np.linalg.eigvalsh(doubtful[k : k + 3, k : k + 3]).max()) for k in (0, 3))
    # of huge numbers a product is infinite where a power is an error
    return move <= tolerance[0] * tolerance[0] and turn <= tolerance[1] * tolerance[1]


def good_enough(
    model: ObjectModel, answer: Estimate, tolerance: tuple[float, float], settings: EstimateSettings
) -> bool:
    """Whether an answer is sure and its largest standard deviations are within tolerance (m, rad)."""
    return answer.verdict == "ok" and is_within(model, answer.modes, tolerance, settings)
