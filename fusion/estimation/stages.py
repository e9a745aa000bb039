"""The steps of an estimate that need more than a line, and their settings. Camera frame, metres, radians."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from fusion.estimation import verdict as posterior
from fusion.estimation.answer import Estimate
from fusion.estimation.moments import MomentSettings
from fusion.estimation.search import PlanSettings
from fusion.estimation.solve import joint
from fusion.estimation.trace import Trace
from scenes.errors import InputError
from scenes.evidence import align as alignment
from scenes.evidence import table as tables
from scenes.evidence.align import Alignment, Prior
from scenes.evidence.modes import Mode, ModeSettings, distinct_modes
from scenes.evidence.search import SearchStage, starts_around
from scenes.evidence.table import Evidence
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Contacts, Frame
from touch.arrays.ranking import RankingSettings, pattern_costs
from touch.arrays.readings import readings_of
from touch.arrays.rows import taxel_rows
from touch.contacts import contact_starts
from vision.look.hand import CalibrationModel
from vision.look.mask import object_mask
from vision.look.pixels import DepthModel
from vision.look.segments import (
    SegmentationSettings,
    Segments,
    find_region,
    free_space_rows,
    segment,
    surface_rows,
)
from vision.starts import StartSettings, seen_starts

Array = NDArray[np.float64]


@dataclass(frozen=True)
class EstimateSettings:
    """The whole estimate; each stage's own settings are nested."""

    # Width of a coarse start given without one, per axis: T1's 16 degrees and 33 mm in a random direction.
    prior_angle: float = float(np.deg2rad(10.0))
    prior_distance: float = 0.02
    # Starts drawn around a prior, and from contacts without one.
    starts_near: int = 320
    starts_global: int = 4000
    # Object pixels of the last stage.
    pixels: int = 500
    # First blur of the search as a share of the object's radius, and its limits in metres.
    blur_share: float = 0.14
    blur_limits: tuple[float, float] = (0.004, 0.015)
    # Fewer pixels than this are no object but what a mask left over.
    least_masked: int = 60
    # Nats of the pixels' joint cost that tell two minima apart as one should: hundreds of pixels share what a lattice
    # and a mesh leave out of a surface. Of 81 pairs of a right and a wrong minimum (384 frames without a start, not
    # those that are reported) the wrong one cost up to 8 nats less in 26.
    pixel_temperature: float = 4.0
    # A contact is as likely a false one at this many sigmas.
    contact_gate: float = 4.0
    segmentation: SegmentationSettings = field(default_factory=SegmentationSettings)
    depth: DepthModel = field(default_factory=DepthModel)
    calibration: CalibrationModel = field(default_factory=CalibrationModel)
    joint: joint.JointSettings = field(default_factory=joint.JointSettings)
    modes: ModeSettings = field(default_factory=ModeSettings)
    starts: StartSettings = field(default_factory=StartSettings)
    moments: MomentSettings = field(default_factory=MomentSettings)
    plan: PlanSettings = field(default_factory=PlanSettings)
    verdict: posterior.VerdictSettings = field(default_factory=posterior.VerdictSettings)
    # How the patterns of taxel arrays tell several modes apart; None leaves it to their rows.
    patterns: RankingSettings | None = field(default_factory=RankingSettings)


def check_senses(use: Iterable[str]) -> frozenset[str]:
    """The senses asked for; raises InputError for none or unknown ones."""
    senses = frozenset([use] if isinstance(use, str) else use)
    if not senses or senses - {"vision", "touch"}:
        raise InputError(f"use: expected vision, touch or both, got {', '.join(sorted(senses)) or 'nothing'}")
    return senses


def check_limits(tolerance: tuple[float, float] | None, budget_ms: float | None) -> None:
    """Raises InputError for a tolerance that is not two positive numbers (m, rad) or a budget below 0 ms."""
    if tolerance is not None and (len(tolerance) != 2 or not all(np.isfinite(t) and t > 0 for t in tolerance)):
        raise InputError(f"tolerance: expected metres and radians above 0, got {tolerance}")
    if budget_ms is not None and not budget_ms >= 0:
        raise InputError(f"budget: expected milliseconds from 0, got {budget_ms}")


def with_shared_errors(modes: tuple[Mode, ...], frame: Frame, settings: EstimateSettings) -> tuple[Mode, ...]:
    """Modes of the rows alone, as wide along the camera's ray as errors make them that all pixels of a frame share.

    The joint solution learns these from the frame; where it is skipped they are as large as they are believed to be.
    """
    if frame.depth is None:
        return modes
    out = []
    for mode in modes:
        away = mode.pose[:3, 3]
        ray = away / max(float(np.linalg.norm(away)), 1e-9)
        variance = settings.depth.bias_sigma**2 + (settings.depth.scale_sigma * float(np.linalg.norm(away))) ** 2
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


def as_prior(prior: Array | Prior | None, settings: EstimateSettings) -> Prior | None:
    """A Gaussian on the pose from what the caller gave."""
    if prior is None or isinstance(prior, Prior):
        return prior
    return Prior.isotropic(se3.check_pose(prior, "prior"), settings.prior_angle, settings.prior_distance)


def search_stages(blur: float, near: bool, sifted: bool = False) -> tuple[SearchStage, ...]:
    """Coarse to fine: wide starts need more survivors than those around a prior, or than those of vision.starts, which
    were sifted (a few hundred that differ).
    """
    if near:
        return (
            SearchStage(blur, 0.5, 80, 4, 120),
            SearchStage(blur, 0.5, 80, 5, 40),
            SearchStage(blur / 3, 0.25, 160, 10, 20),
        )
    if sifted:
        return (
            SearchStage(1.2 * blur, 0.5, 60, 5, 100),
            SearchStage(0.7 * blur, 0.4, 80, 8, 40),
            SearchStage(blur / 3, 0.2, 160, 10, 16),
        )
    return (
        SearchStage(3 * blur, 0.8, 40, 0, 500),
        SearchStage(2 * blur, 0.6, 40, 4, 160),
        SearchStage(blur, 0.4, 60, 8, 60),
        SearchStage(blur / 3, 0.2, 160, 10, 20),
    )


def hand_from_object(frame: Frame, pose: Array, correction: Array) -> Array | None:
    """(4, 4) pose of the object in the hand, with the calibration as corrected; None without a hand pose."""
    if frame.world_from_hand is None:
        return None
    return se3.inverse(correction @ frame.camera_from_world @ frame.world_from_hand) @ pose


def look(frame: Frame, model: ObjectModel, start: Array | None, settings: EstimateSettings) -> tuple[Segments, str]:
    """The frame's pixels sorted, and a word on how. Without a start they are more than a ball around one: what stands
    about and what the hand covers is taken away first, by `object_mask`, where a hand is seen that holds the object.
    """
    beliefs = settings.segmentation, settings.depth, settings.calibration
    looked = segment(frame, model, start, *beliefs)
    view = looked.hand_view
    if start is not None or frame.mask is not None or view is None or not len(view.points):
        return looked, ""
    mask = object_mask(frame, model, None, None, settings.depth, settings.calibration, view=view)
    if int(mask.sum()) < settings.least_masked:
        return looked, "; no piece of an object near the hand"
    masked = replace(frame, mask=mask)
    region = find_region(masked, model, None, settings.segmentation)
    if region is None:
        return looked, ""
    return segment(masked, model, None, *beliefs, again=(region, view)), "; table, hand and clutter taken away"


def vision_rows(looked: Segments, settings: EstimateSettings) -> Evidence:
    """Pixels of the object, with the space before what was seen; none without such a pixel."""
    seen = surface_rows(looked, settings.pixels, settings.segmentation, settings.depth)
    return tables.stack(seen, free_space_rows(looked, settings.segmentation)) if len(seen) else seen


def starts_of(
    model: ObjectModel,
    prior: Prior | None,
    pixels: Array,
    contacts: Contacts,
    rows: Evidence,
    rank: Callable[[Array, float], Array],
    settings: EstimateSettings,
    rng: np.random.Generator,
) -> Array:
    """Starts (n, 4, 4): draws from the prior, or from contacts and pixels when there is none. rows, with what
    rank(poses, blur) adds, tell which of the pixels' are promising.
    """
    if prior is not None:
        sigma = np.sqrt(1.0 / np.maximum(np.diag(prior.information), 1e-12))
        return starts_around(
            model,
            prior.pose,
            float(min(sigma[:3].max(), np.pi / 3)),
            float(min(sigma[3:].max(), model.diameter)),
            settings.starts_near,
            rng,
        )
    parts = []
    if len(contacts):
        parts.append(contact_starts(model, contacts, settings.starts_global // (2 if len(pixels) else 1), rng))
    if len(pixels):
        parts.append(seen_starts(model, pixels, rows, rank, rng, settings.starts))
    return np.concatenate(parts)


def comparable(solved: list[joint.JointResult], settings: EstimateSettings) -> Array:
    """Costs (k,) of joint solutions as far as they tell minima apart: pixels' count less (see pixel_temperature)."""
    shared = 1.0 - 1.0 / settings.pixel_temperature
    return np.array([s.cost - shared * s.pixel_cost for s in solved])


def rejudged(
    model: ObjectModel, solved: list[joint.JointResult], costs: Array, settings: EstimateSettings
) -> tuple[Mode, ...]:
    """The modes after the joint solution: its poses and covariances, and costs (k,); weights by Laplace's method."""
    hessians = np.array([np.linalg.inv(s.covariance) for s in solved])
    poses = np.array([s.pose for s in solved])
    return distinct_modes(
        model, Alignment(poses, costs, hessians, np.zeros(len(solved), dtype=np.int64)), settings.modes
    )


def beyond_rows(frame: Frame, model: ObjectModel, solved: list[joint.JointResult], settings: EstimateSettings) -> Array:
    """What to add to the costs (k,) of several solutions for what taxel arrays say beyond rows of evidence: the shape
    and the pressures of their patterns, in place of their taxels' rows.
    """
    readings = readings_of(frame) if settings.patterns is not None and len(solved) > 1 else []
    out = np.zeros(len(solved))
    for k, one in enumerate(solved if readings else ()):
        correction = one.correct()
        moved = [reading.moved(correction) for reading in readings]
        rows = alignment.costs(model, taxel_rows(moved), one.pose[None])
        out[k] = (pattern_costs(model, moved, one.pose[None], settings.patterns) - rows)[0]
    return out


def no_answer(
    frame: Frame, model: ObjectModel, prior: Prior | None, trace: Trace, settings: EstimateSettings
) -> Estimate:
    """No row of evidence at all: the prior (or the identity), as wide as it is, and the verdict lost."""
    pose = prior.pose if prior is not None else np.eye(4)
    information = prior.information if prior is not None else np.zeros((6, 6))
    nothing = Alignment(pose[None], np.zeros(1), information[None], np.zeros(1, dtype=np.int64))
    modes = distinct_modes(model, nothing, settings.modes)
    return Estimate(
        frame.index,
        pose,
        modes[0].covariance,
        modes,
        "lost",
        posterior.unobservable(model, pose, modes[0].covariance, settings.verdict),
        hand_from_object(frame, pose, np.eye(4)),
        0.0,
        trace.stages,
        notes=("no evidence: no pixel of the object and no contact",),
        start=prior.pose if prior is not None else None,
    )


def blind(frame: Frame) -> Frame:
    """The frame without what a camera gave."""
    return replace(frame, depth=None, rgb=None, mask=None, cloud=None, cloud_colours=None)


def numb(frame: Frame) -> Frame:
    """The frame without what touch gave."""
    return replace(frame, contacts=Contacts(np.zeros((0, 3))), no_contact=None, wrenches=(), tactile={}, gels={})
