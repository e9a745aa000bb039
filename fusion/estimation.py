"""One frame, one answer: look, feel, search, solve together, say how sure.

Readable as the method: each step is one named stage of the trace, run or skipped with its reason.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from fusion import joint, posterior
from fusion.answer import Estimate
from fusion.trace import Trace
from scenes import evidence as tables
from scenes import poses as se3
from scenes.alignment import Alignment, AlignSettings, Prior, align
from scenes.alignment.modes import Mode, ModeSettings, distinct_modes
from scenes.alignment.search import SearchStage, search, starts_around
from scenes.errors import InputError
from scenes.frames import Contacts, Frame
from scenes.objects import ObjectModel
from scenes.threads import one_blas_thread
from touch.contacts import contact_starts, feel
from vision.clouds import DepthModel
from vision.hand_view import CalibrationModel
from vision.segmentation import SegmentationSettings, free_space_rows, segment, surface_rows
from vision.sight import Sight
from vision.starts import pixel_starts
from vision.visibility import visibility

Array = NDArray[np.float64]


@dataclass(frozen=True)
class EstimateSettings:
    """The whole estimate; each stage's own settings are nested."""

    # Width of a coarse start given without one, per axis: T1's 16 degrees and 33 mm in a random direction.
    prior_angle: float = float(np.deg2rad(10.0))
    prior_distance: float = 0.02
    # Starts drawn around a prior, and without one.
    starts_near: int = 320
    starts_global: int = 4000
    # Object pixels of the last stage.
    pixels: int = 500
    # First blur of the search as a share of the object's radius, and its limits in metres.
    blur_share: float = 0.14
    blur_limits: tuple[float, float] = (0.004, 0.015)
    # A contact is as likely a false one at this many sigmas.
    contact_gate: float = 4.0
    segmentation: SegmentationSettings = field(default_factory=SegmentationSettings)
    depth: DepthModel = field(default_factory=DepthModel)
    calibration: CalibrationModel = field(default_factory=CalibrationModel)
    joint: joint.JointSettings = field(default_factory=joint.JointSettings)
    modes: ModeSettings = field(default_factory=ModeSettings)
    verdict: posterior.VerdictSettings = field(default_factory=posterior.VerdictSettings)


def estimate(
    frame: Frame,
    model: ObjectModel,
    prior: Array | Prior | None = None,
    use: Iterable[str] = ("vision", "touch"),
    tolerance: tuple[float, float] | None = None,
    budget_ms: float | None = None,
    seed: int = 0,
    settings: EstimateSettings | None = None,
) -> Estimate:
    """Where is the object in this frame?

    prior: a coarse camera_from_object (4, 4), or a Gaussian on it; default the frame's own prior. use: the senses
    allowed. tolerance (m, rad): how good is good enough; budget_ms: time after which optional stages are skipped.
    Returns an Estimate; data that tell nothing give the verdict "lost" and a covariance that says so, not an error.
    """
    with one_blas_thread():
        return _estimate(
            frame, model, prior, check_senses(use), tolerance, budget_ms, seed, settings or EstimateSettings()
        )


def _estimate(
    frame: Frame,
    model: ObjectModel,
    prior: Array | Prior | None,
    senses: frozenset[str],
    tolerance: tuple[float, float] | None,
    budget_ms: float | None,
    seed: int,
    settings: EstimateSettings,
) -> Estimate:
    rng = np.random.default_rng(seed)
    believed = as_prior(prior if prior is not None else frame.prior, settings)
    start = believed.pose if believed is not None else None
    model.field  # noqa: B018  (built or read once per object, not part of a frame's time)
    trace = Trace(budget_ms)

    with trace.stage("look", "vision" in senses, "vision not asked for") as stage:
        looked = segment(
            frame if "vision" in senses else _blind(frame),
            model,
            start,
            settings.segmentation,
            settings.depth,
            settings.calibration,
        )
        seen = surface_rows(looked, settings.pixels, settings.segmentation, settings.depth)
        free = free_space_rows(looked, settings.segmentation)
        stage.note(len(seen) + len(free), f"{len(looked.pixels)} object pixels, {len(looked.hand)} of the hand")
    with trace.stage("feel", "touch" in senses, "touch not asked for") as stage:
        felt = feel(frame if "touch" in senses else _numb(frame), settings.contact_gate, looked.region)
        stage.note(len(felt.rows), f"{len(felt.contacts)} contacts, {len(felt.rows) - len(felt.contacts)} empty points")

    seen = tables.stack(seen, free) if len(seen) else seen
    hand = looked.hand_view if len(felt.rows) else None
    correction = hand.correct() if hand is not None else np.eye(4)
    rows = tables.stack(
        seen, felt.slackened(settings.calibration, hand is None and frame.camera is not None).moved(correction)
    )
    if len(rows) == 0:
        return _nothing(frame, model, believed, trace, settings)

    sight = Sight(frame if "vision" in senses else _blind(frame), model, settings.depth)
    with trace.stage("search", True, "") as stage:
        starts = _starts(model, believed, looked.pixels.points, felt.contacts.moved(correction), settings, rng)
        blur = float(np.clip(settings.blur_share * model.radius, *settings.blur_limits))
        found = search(model, rows, starts, search_stages(blur, believed is not None), believed, rank=sight.costs)
        stage.note(len(rows), f"{len(starts)} starts, blur {1e3 * blur:.1f} mm")
    with trace.stage("refine", True, "") as stage:
        refined = align(model, rows, found.poses, believed, AlignSettings(iterations=30))
        past = sight.costs(refined.poses)
        modes = distinct_modes(model, replace(refined, costs=refined.costs + past), settings.modes)
        stage.note(len(rows), f"minima: {len(modes)}; what the camera saw past the best costs {past.min():.1f}")
    with trace.stage("solve together", True, "") as stage:
        problem = joint.JointProblem(
            model,
            seen,
            felt.rows,
            believed,
            hand,
            settings.depth,
            settings.calibration,
            frame.camera if frame.depth is not None else None,
            has_robot=frame.depth is not None,
            told_apart=looked.told_apart,
            settings=settings.joint,
        )
        solved = joint.solve_modes(problem, [m.pose for m in modes])
        past = sight.costs(np.array([s.pose for s in solved]))
        modes = _rejudged(model, solved, past, settings)
        best = solved[int(np.argmin([s.cost + c for s, c in zip(solved, past)]))]
        stage.note(
            len(rows), f"calibration moved {1e3 * np.linalg.norm(best.xi[3:]):.1f} mm, scale {100 * best.scale:+.2f} %"
        )
    with trace.stage("judge", True, "") as stage:
        corrected = felt.contacts.moved(best.correct())
        residuals = posterior.contact_residuals(model, corrected, modes[0].pose, settings.verdict)
        share, rms = posterior.pixel_agreement(model, seen, modes[0].pose)
        seeing = visibility(frame if "vision" in senses else _blind(frame), model, modes[0].pose, settings.depth)
        word, why = posterior.verdict(model, modes, residuals, share, seeing, settings.verdict)
        stage.note(len(rows), why)

    pose = modes[0].pose
    return Estimate(
        frame=frame.index,
        pose=pose,
        covariance=modes[0].covariance,
        modes=modes,
        verdict=word,
        unobservable=posterior.unobservable(model, pose, modes[0].covariance, settings.verdict),
        hand_from_object=hand_from_object(frame, pose, best.correct()),
        visible_fraction=seeing.visible,
        trace=trace.stages,
        contacts=residuals,
        pixel_rms_mm=1e3 * rms,
        notes=(why,),
        dropped=looked.dropped,
        start=start,
    )


def check_senses(use: Iterable[str]) -> frozenset[str]:
    """The senses asked for; raises InputError for none or unknown ones."""
    senses = frozenset([use] if isinstance(use, str) else use)
    if not senses or senses - {"vision", "touch"}:
        raise InputError(f"use: expected vision, touch or both, got {', '.join(sorted(senses)) or 'nothing'}")
    return senses


def as_prior(prior: Array | Prior | None, settings: EstimateSettings) -> Prior | None:
    """A Gaussian on the pose from what the caller gave."""
    if prior is None or isinstance(prior, Prior):
        return prior
    return Prior.isotropic(se3.check_pose(prior, "prior"), settings.prior_angle, settings.prior_distance)


def search_stages(blur: float, near: bool) -> tuple[SearchStage, ...]:
    """Coarse to fine: wide starts need more survivors than those around a prior."""
    if near:
        return (
            SearchStage(blur, 0.5, 80, 8, 80),
            SearchStage(blur / 3, 0.25, 160, 10, 40),
        )
    return (
        SearchStage(3 * blur, 0.8, 40, 0, 1200),
        SearchStage(2 * blur, 0.6, 40, 5, 400),
        SearchStage(blur, 0.4, 60, 8, 120),
        SearchStage(blur / 3, 0.2, 160, 10, 40),
    )


def hand_from_object(frame: Frame, pose: Array, correction: Array) -> Array | None:
    """(4, 4) pose of the object in the hand, with the calibration as corrected; None without a hand pose."""
    if frame.world_from_hand is None:
        return None
    return se3.inverse(correction @ frame.camera_from_world @ frame.world_from_hand) @ pose


def _starts(
    model: ObjectModel,
    prior: Prior | None,
    pixels: Array,
    contacts: Contacts,
    settings: EstimateSettings,
    rng: np.random.Generator,
) -> Array:
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
        parts.append(pixel_starts(model, pixels, settings.starts_global // (2 if parts else 1), rng))
    return np.concatenate(parts)


def _rejudged(
    model: ObjectModel, solved: list[joint.JointResult], past: Array, settings: EstimateSettings
) -> tuple[Mode, ...]:
    """The modes after the joint solution: its poses, costs and covariances; weights by Laplace's method."""
    hessians = np.array([np.linalg.inv(s.covariance) for s in solved])
    poses, costs = np.array([s.pose for s in solved]), np.array([s.cost + c for s, c in zip(solved, past)])
    return distinct_modes(
        model, Alignment(poses, costs, hessians, np.zeros(len(solved), dtype=np.int64)), settings.modes
    )


def _nothing(
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


def _blind(frame: Frame) -> Frame:
    return replace(frame, depth=None, rgb=None, mask=None, cloud=None, cloud_colours=None)


def _numb(frame: Frame) -> Frame:
    return replace(frame, contacts=Contacts(np.zeros((0, 3))), no_contact=None, wrenches=(), tactile={})
