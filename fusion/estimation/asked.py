"""What the caller asked for, checked: senses, a prior, a tolerance, a budget."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from numbers import Real

import numpy as np
from numpy.typing import NDArray

from fusion.estimation.settings import EstimateSettings
from scenes.errors import InputError
from scenes.evidence.align import Prior, check_prior
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.beliefs import Beliefs, usual_beliefs
from scenes.recordings.checking.validation import MILLIMETRES, check_below_object, check_is_model, check_seed
from scenes.recordings.frames import Frame
from vision.filling import as_measured
from vision.noise import believed_of

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Asked:
    """One question: senses allowed, prior, tolerance (m, rad), seed; and how it is answered.

    viewed: the frame with what vision may use of it, without what a recorder filled in, and without what is felt where
    touch is not asked for: it would say where to look; filled: a note of that.
    or_none: only when the rows alone are within the tolerance.
    """

    senses: frozenset[str]
    prior: Prior | None
    tolerance: tuple[float, float] | None
    seed: int
    beliefs: Beliefs
    settings: EstimateSettings
    viewed: Frame
    filled: tuple[str, ...] = ()
    or_none: bool = False

    @staticmethod
    def of(
        frame: Frame,
        prior: Array | Prior | None = None,
        use: Iterable[str] = ("vision", "touch"),
        tolerance: tuple[float, float] | None = None,
        seed: int = 0,
        settings: EstimateSettings | None = None,
        beliefs: Beliefs | None = None,
    ) -> Asked:
        """As `estimate` takes it, checked; what is not said is the frame's own, and as noisy as it shows."""
        settings, senses = settings or EstimateSettings(), check_senses(use)
        believed = as_prior(prior if prior is not None else frame.prior, settings)
        sees = "vision" in senses
        viewed, filled = as_measured(frame, settings.look.filling) if sees else (frame.without_vision(), ())
        viewed = viewed if "touch" in senses else viewed.without_touch()
        known = believed_of(viewed, beliefs or frame.beliefs or usual_beliefs(), settings.look.noise)
        return Asked(senses, believed, tolerance, seed, known, settings, viewed, filled)


def check_senses(use: Iterable[str]) -> frozenset[str]:
    """The senses asked for; raises InputError for none or unknown ones."""
    asked = [use] if isinstance(use, str) or not isinstance(use, Iterable) else use
    senses = frozenset(str(sense) for sense in asked)
    if not senses or senses - {"vision", "touch"}:
        raise InputError(f"use: expected vision, touch or both, got {', '.join(sorted(senses)) or 'nothing'}")
    return senses


def check_kinds(
    model: object,
    seed: object,
    settings: object,
    beliefs: object,
    kind: type = EstimateSettings,
    live: object = False,
) -> None:
    """Raises InputError for what is no model, a seed that is no whole number from 0, settings (kind) and beliefs of
    other types, and a word or number for `live`; None is what is not said.
    """
    if not isinstance(live, bool | np.bool_):
        raise InputError(f"live: expected True or False, got {live!r}")
    check_is_model(model)
    check_seed(seed)
    how = ', like Beliefs(depth=depth_camera("d435"))'
    for name, given, expected, hint in (("settings", settings, kind, ""), ("beliefs", beliefs, Beliefs, how)):
        if given is not None and not isinstance(given, expected):
            raise InputError(f"{name}: expected {expected.__name__}{hint}, got {type(given).__name__}")


def each_frame(frames: Iterable[Frame]) -> Iterator[Frame]:
    """The frames, one by one; raises InputError for what has none: one frame, or nothing."""
    if not isinstance(frames, Iterable):
        hint = "[frame], or Tracker(model).step(frame)" if isinstance(frames, Frame) else "read_capture(folder)"
        raise InputError(f"frames: expected several ({hint}), got {type(frames).__name__}")
    return iter(frames)


def check_limits(tolerance: tuple[float, float] | None, budget_ms: float | None, model: ObjectModel) -> None:
    """Raises InputError for a tolerance that is not two positive numbers (m, rad), one that every pose is within (of
    the object's diameter, half a turn and more), and a budget below 0 ms.
    """
    if tolerance is not None:
        two = tuple(tolerance) if isinstance(tolerance, Iterable) else ()
        if len(two) != 2 or not all(_is_number(t) and np.isfinite(t) and t > 0 for t in two):
            raise InputError(f"tolerance: expected metres and radians above 0, got {tolerance!r}")
        length, angle = map(float, two)
        check_below_object("tolerance", length, model)
        if angle > np.pi:
            raise InputError(f"tolerance: expected radians up to half a turn, got {angle:g}: degrees read as rad?")
    if budget_ms is not None and not (_is_number(budget_ms) and budget_ms >= 0):
        raise InputError(f"budget: expected milliseconds from 0, got {budget_ms!r}")


def check_start(frame: Frame, prior: Array | Prior | None) -> None:
    """Raises InputError for a start, given as a pose (4, 4), that is where no camera sees what a hand holds. What is
    a Gaussian was computed, and says itself how far off it may be.
    """
    if prior is None or isinstance(prior, Prior) or frame.camera is None:
        return
    away = float(np.linalg.norm(se3.check_pose(prior, "prior")[..., :3, 3].ravel()[:3]))
    if away > MILLIMETRES[0]:
        raise InputError(f"prior: expected an object that the camera can see, got one {away:.4g} m away: mm read as m?")


def sure_to_be_within(
    settings: EstimateSettings, sure_within: float | None, model: ObjectModel | None = None
) -> EstimateSettings:
    """The settings with another tolerance (ADD-S, m) of the confidence; None leaves theirs. Raises InputError for none
    above 0, and for one beyond the diameter of the model, where that is known.
    """
    if sure_within is not None and not (_is_number(sure_within) and np.isfinite(sure_within) and sure_within > 0):
        raise InputError(f"sure_within: expected metres above 0, got {sure_within!r}")
    if model is not None:
        within = settings.confidence.tolerance if sure_within is None else sure_within
        check_below_object("sure_within", float(within), model)
    if sure_within is None:
        return settings
    return replace(settings, confidence=replace(settings.confidence, tolerance=float(sure_within)))


def believing(settings: EstimateSettings) -> EstimateSettings:
    """The settings of one who knows the start: it is not doubted."""
    return replace(settings, doubt=replace(settings.doubt, start=np.inf))


def _is_number(value: object) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool)


def as_prior(prior: Array | Prior | None, settings: EstimateSettings) -> Prior | None:
    """A Gaussian on the pose from what the caller gave. Raises InputError for what is none."""
    if prior is None or isinstance(prior, Prior):
        return prior if prior is None else check_prior(prior)
    pose = se3.check_pose(prior, "prior")
    if pose.ndim != 2:
        raise InputError(f"prior: expected one 4x4 transform, got {len(pose)}")
    return Prior.isotropic(pose, settings.prior_angle, settings.prior_distance)
