"""What may be said of an answer: its verdict, what it cannot know in words, and how each row agrees."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fusion.estimation.answer import ContactResidual, Contribution, Estimate, Mode, Stage
from fusion.estimation.posterior.confidence import ConfidenceSettings, chances
from scenes.evidence import align as alignment
from scenes.evidence.align import Prior
from scenes.evidence.modes import ModeSettings, covariance_of, distinct_modes
from scenes.evidence.symmetry.alike import Alike, alike, hardly_moves
from scenes.evidence.table import POINT, SIGMA, TOUCH, VISION, WEIGHT, Evidence, empty
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Contacts, Frame
from vision.picture.prediction import Prediction
from vision.visibility import Visibility

Array = NDArray[np.float64]


@dataclass(frozen=True)
class VerdictSettings:
    """When an answer is sure, and when it is none. By judgement."""

    # Share of the posterior that the first mode must hold, with those that look like it, to be called the answer.
    sure_share: float = 0.95
    # Share of the posterior that an answer must hold whose confidence, which knows what the modes' weights are worth,
    # is high enough, with those where most of the surface is where it has it: likelier than all other places. A mug
    # whose handle may be anywhere is within the tolerance, which is of ADD-S, too; its answer notes that which way
    # round it is is not known. Without a start 81 and 59 % of what is right of 183 and 228 frames of the tuning
    # families is so `ok`, fused and by vision (69 and 51 where the way round must be known).
    likelier_share: float = 0.5
    # Whether an answer is `ok` only where it is known which way round the object lies: what surfaces look like
    # everywhere counts then, and no turn may be open that moves a part of them beyond the tolerance.
    way_round: bool = False
    # Standard deviations of a direction beyond which it counts as unknown: radians, metres.
    unknown_angle: float = float(np.deg2rad(20.0))
    unknown_distance: float = 0.015
    # A contact this many sigmas off (and at least this far, metres) does not belong to the answer.
    outlier_sigmas: float = 4.0
    outlier_distance: float = 0.004
    # Share of contacts (no unit; each finger's count as one) of which an answer must explain more, or it is not `ok`,
    # and not less, or it may be lost: of two fused answers that explained two of four, on a tuning family and another
    # generator's frames, none was right. Least share of the pixels taken for the object.
    least_contacts: float = 0.5
    # The contacts of so few fingers may all be false: what an image shows is not lost for them, nor is it doubted for
    # one of two. Of 39 answers that explained one of two where the image shows the object, to 8 frames of two other
    # generators, 37 were right, the others 0.5 and 0.8 mm beyond the tolerance.
    few_fingers: int = 2
    # Nats a contact, on average, from which what is felt contradicts the answer: a false contact costs about eight, by
    # a gate of so many sigmas, and one beside an edge of the mesh, where normals are either face's, up to six. One of
    # unknown worth pulls without a gate, but counts no more here: one normal the wrong way round among five contacts is
    # no reason to disbelieve a camera that sees the object.
    most_contradicted: float = 6.5
    false_gate: float = 4.0
    least_pixels: float = 0.3
    # Share of the object's own pixels through which the camera may see, noise at the outline included.
    most_violated: float = 0.25
    # Share of a mask's inner pixels that may lie beside the object: as much as it may be seen past. Either the mask or
    # the pose is wrong then.
    most_bare: float = 0.25
    # Without touch, an answer from less than this share of the object is a guess; and from less than this where the
    # confidence is high enough: of 20 answers to tuning families from 4 to 12 % of an object that were so sure, all of
    # them with a start, all are right; of 105 that were not 59 are.
    least_visible: float = 0.12
    least_visible_sure: float = 0.05
    # So is one from fewer pixels that agree than this: some part of another thing looks as that few do. Of 117 such
    # answers to frames of the tuning families none was `ok` anyhow; one of a small thing elsewhere was, wrongly.
    least_agreeing: float = 120.0
    # No answer that one of these rules doubts is surer than this (no unit): 14 of 18 that would have been as sure as an
    # `ok` one, on tuning families and another generator's frames, are right.
    most_doubted: float = 0.8


def contact_residuals(
    model: ObjectModel,
    contacts: Contacts,
    pose: Array,
    settings: VerdictSettings | None = None,
    of_finger: Array | None = None,
) -> tuple[ContactResidual, ...]:
    """How each of n contacts (camera frame, corrected) agrees with the object at pose (4, 4). of_finger (n,): what part
    of its finger's contacts each is, None where each is a finger's only one.
    """
    settings = settings or VerdictSettings()
    if not len(contacts):
        return ()
    local = se3.apply(se3.inverse(pose), contacts.points)
    inward = np.where(contacts.has_normal[:, None], -np.nan_to_num(contacts.normals), 0.0) @ pose[:3, :3]
    # a thin wall has two sides: the one that was touched is the one that the contact's normal leaves
    distance, gradient = model.field.seen_distance_and_gradient(local, inward, contacts.has_normal)
    normals = model.field.normals(local - distance[:, None] * gradient) @ pose[:3, :3].T
    sensed = np.nan_to_num(contacts.normals)
    across = np.linalg.norm(se3.cross(sensed, normals), axis=1)
    turned = np.degrees(np.arctan2(across, np.einsum("ij,ij->i", sensed, normals)))
    turned = np.where(contacts.has_normal, turned, np.nan)
    limit = np.maximum(settings.outlier_sigmas * contacts.sigma_point, settings.outlier_distance)
    outlier = np.abs(distance) > limit
    return tuple(
        ContactResidual(sensor, 1e3 * off, angle, bool(false), 1e3 * sigma, part)
        for sensor, off, angle, false, sigma, part in zip(
            *(contacts.sensors, distance.tolist(), turned.tolist(), outlier, contacts.sigma_point.tolist()),
            [1.0] * len(contacts) if of_finger is None else of_finger.tolist(),
        )
    )


def nats_of_contacts(model: ObjectModel, felt: Evidence, count: int, pose: Array) -> float:
    """What `count` contacts cost at pose (4, 4), together: each as the mean of all does, by their weights. Rows of
    touch beyond them, of gels and of taxels, count in that; many of one finger weigh little, and are off as much.
    """
    if not count:
        return 0.0
    on = felt.on
    places = float(felt.rows[on, WEIGHT].sum())
    if places >= count:
        return float(alignment.costs(model, felt, pose[None])[0]) * count / places
    # empty points are not weighed down with the contacts, and cost what they cost
    touched, empty_points = (float(alignment.costs(model, felt.take(own), pose[None])[0]) for own in (on, ~on))
    return touched * count / max(places, 1e-9) + empty_points


def contradiction(
    model: ObjectModel, felt: Evidence, count: int, pose: Array, settings: VerdictSettings | None = None
) -> float:
    """Nats by which `count` contacts speak against pose (4, 4), none by more than a false one costs."""
    return nats_of_contacts(model, felt.gated((settings or VerdictSettings()).false_gate), count, pose)


def pixel_agreement(model: ObjectModel, seen: Evidence, pose: Array) -> tuple[float, float]:
    """Share of the ON pixels within three sigmas of the surface at pose, and the RMS distance (m) of those."""
    on = seen.rows[seen.on]
    if not len(on):
        return float("nan"), float("nan")
    distance = model.field.distance(se3.apply(se3.inverse(pose), on[:, POINT]))
    near = np.abs(distance) < 3 * on[:, SIGMA]
    rms = float(np.sqrt(np.mean(distance[near] ** 2))) if near.any() else float("nan")
    return float(near.mean()), rms


def contributions(
    model: ObjectModel, rows: Evidence, pose: Array, covariance: Array, prior: Prior | None = None
) -> tuple[Contribution, ...]:
    """What vision, touch and a prior each add to the answer at pose (4, 4): how sure it is with them and without.

    With all of them it is as sure as its covariance (6, 6) says, shared errors and all. Without one it is less sure by
    as much as the rows are: that part of the covariance grows, the errors that rows share stay.
    """
    parts = {}
    for name, sense in (("vision", VISION), ("touch", TOUCH)):
        own = rows.of(sense)
        parts[name] = len(own), alignment.terms(model, own, pose)[2] if len(own) else np.zeros((6, 6))
    if prior is not None:
        parts["prior"] = (0, alignment.terms(model, empty(), pose, prior)[2])
    whole = np.sum([information for _, information in parts.values()], axis=0)
    # without each of those that say something, beside all of them
    said = [name for name, (count, _) in parts.items() if count or name == "prior"]
    by_rows = covariance_of(model, np.array([whole, *(whole - parts[name][1] for name in said)]))
    wide = np.concatenate([covariance[None], covariance + by_rows[1:] - by_rows[0]])
    # the widest turn and the widest move of each
    blocks = np.stack([wide[:, :3, :3], wide[:, 3:, 3:]], axis=1)
    widest = np.sqrt(np.maximum(np.linalg.eigvalsh(blocks)[..., -1], 0.0)).tolist()
    rotation, position = widest[0]
    return tuple(
        Contribution(name, parts[name][0], position, move, rotation, turn)
        for name, (turn, move) in zip(said, widest[1:])
    )


def open_directions(
    model: ObjectModel,
    pose: Array,
    covariance: Array,
    settings: VerdictSettings | None = None,
    tolerance: float = 0.0,
    on_average: bool = False,
) -> tuple[str, ...]:
    """Directions the data leave open, in the object's own axes; those of its symmetry are none, nor are turns that move
    no part of the surface (on average: the mean of it) by more than tolerance (m), however far they go.

    The symmetry is taken out of the covariance, not out of the list: an eigenvector is never exactly the axis.
    """
    settings = settings or VerdictSettings()
    rotation = pose[:3, :3]
    own = model.symmetries.quotient(rotation, model.centroid)
    doubtful = own @ covariance @ own.T
    found = []
    spreads, axes = np.linalg.eigh(
        np.array([rotation.T @ doubtful[block, block] @ rotation for block in (slice(0, 3), slice(3, 6))])
    )
    limits = (settings.unknown_angle, "rotation about"), (settings.unknown_distance, "translation along")
    for values, vectors, (limit, word) in zip(spreads, axes, limits):
        for value, vector in zip(values, vectors.T):
            if np.sqrt(max(value, 0.0)) > limit:
                turns = word == "rotation about" and tolerance > 0.0
                if turns and hardly_moves(model, pose, vector, np.pi, tolerance, on_average):
                    continue
                found.append(f"{word} {_axis_name(vector)}")
    return tuple(found)


def unobservable(
    model: ObjectModel, pose: Array, covariance: Array, settings: VerdictSettings | None = None
) -> tuple[str, ...]:
    """Directions the data leave open, then turns about the object's own axes, which nothing ever tells."""
    # a ball turns about every axis, whichever two were declared
    turns = np.eye(3) if model.symmetries.is_spherical else [a.direction for a in model.symmetries.axes[:1]]
    own = [f"rotation about {_axis_name(direction)}" for direction in turns]
    return *open_directions(model, pose, covariance, settings), *own


def _axis_name(direction: Array) -> str:
    largest = int(np.argmax(np.abs(direction)))
    if abs(direction[largest]) > 0.94:  # within 20 degrees
        return "xyz"[largest]
    sign = np.sign(direction[largest])
    return "({:.2f}, {:.2f}, {:.2f})".format(*(sign * direction + 0.0))


def verdict(
    model: ObjectModel,
    modes: tuple[Mode, ...],
    residuals: tuple[ContactResidual, ...],
    pixel_share: float,
    seeing: Visibility,
    settings: VerdictSettings | None = None,
    tolerance: float = ConfidenceSettings.tolerance,
    same: Alike | None = None,
    sure: bool = False,
) -> tuple[str, str]:
    """The verdict and its reason: lost when the evidence is not explained, ambiguous when it fits several places of the
    surface; poses between which no part of it moves by more than tolerance (m) are one: `same`, None to find them.

    sure: the confidence is high enough, see `VerdictSettings.likelier_share`, `least_visible_sure` and `way_round`.
    """
    settings = settings or VerdictSettings()
    if not modes:
        return "lost", "no evidence"
    against = _contradicted(residuals, pixel_share, seeing, settings, sure)
    if against is not None:
        return against
    same = same or alike(model, modes, tolerance)
    any_way = sure and not settings.way_round
    least = min(settings.likelier_share, settings.sure_share) if sure else settings.sure_share
    if (same.near_weight if any_way else same.weight) < least:
        of = "first" if len(same.modes) == 1 else f"first {len(same.modes)}"
        return "ambiguous", f"{of} of {len(modes)} modes {'holds' if of == 'first' else 'hold'} {same.weight:.0%}"
    hidden = open_directions(model, modes[0].pose, modes[0].covariance, settings, tolerance, sure)
    if hidden:
        return "ambiguous", f"{', '.join(hidden)} unknown"
    if len(same.modes) > 1 and modes[0].weight < settings.sure_share <= same.weight:
        return "ok", f"{len(same.modes)} modes that look alike hold {same.weight:.0%}"
    if len(same.near) > len(same.modes) and same.weight < settings.sure_share:
        return "ok", f"{len(same.near)} modes in which most of the surface is alike hold {same.near_weight:.0%}"
    return "ok", f"first mode holds {modes[0].weight:.0%}"


def _contradicted(
    residuals: tuple[ContactResidual, ...],
    pixel_share: float,
    seeing: Visibility,
    settings: VerdictSettings,
    sure: bool = False,
) -> tuple[str, str] | None:
    """Verdict and reason of an answer that what is sensed contradicts, or hardly shows, whatever its modes; or None."""
    seen = np.isfinite(seeing.visible)
    if residuals:
        fingers = [r.of_finger for r in residuals]
        good = float(np.average([not r.outlier for r in residuals], weights=fingers))
        why = f"{good:.0%} of the contacts explained: they, or their normals, contradict the pose"
        excused = _excused(residuals, pixel_share, seeing, settings)
        if good < settings.least_contacts:
            return "ambiguous" if excused else "lost", why
    if np.isfinite(pixel_share) and pixel_share < settings.least_pixels and not residuals:
        return "lost", f"{pixel_share:.0%} of the pixels explained"
    if np.isfinite(seeing.violated) and seeing.violated > settings.most_violated:
        return "lost", f"the camera sees past {seeing.violated:.0%} of the object"
    if residuals and good <= settings.least_contacts and not excused:
        return "ambiguous", why
    if seeing.bare > settings.most_bare:
        return "ambiguous", f"{seeing.bare:.0%} of the mask's inside is not the object at this pose"
    least = min(settings.least_visible, settings.least_visible_sure) if sure else settings.least_visible
    if not residuals and seen and seeing.visible < least:
        return "ambiguous", f"only {seeing.visible:.0%} of the object is seen and nothing touches it"
    return None


def _excused(
    residuals: tuple[ContactResidual, ...], pixel_share: float, seeing: Visibility, settings: VerdictSettings
) -> bool:
    """Whether contacts are of a finger or two, which may have touched something else, or be badly placed, where the
    image shows the object all the same.
    """
    shown = np.isfinite(seeing.visible) and seeing.visible >= settings.least_visible
    agrees = shown and pixel_share >= settings.least_pixels and not seeing.violated > settings.most_violated
    return bool(agrees and round(sum(r.of_finger for r in residuals)) <= settings.few_fingers)


def way_round(same: Alike, word: str, tolerance: float, settings: VerdictSettings | None = None) -> tuple[str, ...]:
    """A note on an answer with the verdict `word` that is `ok` whichever way round it is; none where that is known.

    same: the modes that are one answer within tolerance (m), or nearly.
    """
    settings = settings or VerdictSettings()
    ways = len(same.near)
    if word != "ok" or ways == 1 or same.near[0].weight >= settings.sure_share * same.near_weight:
        return ()
    if ways > len(same.modes):
        far = f"to {1e3 * tolerance:.3g} mm on average, not everywhere"
        return (f"which way round is not known: in {ways} poses the surface is where it is {far}",)
    return (f"which way round is not known: in {ways} poses the surface is where it is to {1e3 * tolerance:.3g} mm",)


def judged(
    model: ObjectModel,
    modes: tuple[Mode, ...],
    residuals: tuple[ContactResidual, ...],
    contact_nats: float,
    pixel_share: float,
    seeing: Visibility,
    picture: Prediction | None,
    settings: VerdictSettings,
    confident: ConfidenceSettings,
    anywhere: bool = False,
    same: Alike | None = None,
    contradicted: float | None = None,
    read: dict[str, float] | None = None,
) -> tuple[float, float, str, str]:
    """Of the first of the modes, found in one frame or followed through many: the chance that it is the right one, and
    that it is near enough, too (the confidence); verdict and its reason.

    residuals and contact_nats: how each contact agrees there, and what all cost; pixel_share: of the object's pixels
    that it explains; picture: the predicted one, None without a depth image; anywhere: there was no start; same: the
    modes that are one answer within the tolerance of `confident`, None to find them; contradicted: see `contradiction`,
    None for contact_nats; read: the `observations` of all that, None to make them. What contradicts the pose, and a
    picture that does not show it, speak against it however narrow its covariance is, and bound the confidence.
    """
    same = same or alike(model, modes, confident.tolerance)
    right, near = chances(model, modes, picture, residuals, contact_nats, confident, anywhere, same, read)
    sure = right * near
    enough = sure >= confident.sure
    word, why = verdict(model, modes, residuals, pixel_share, seeing, settings, confident.tolerance, same, enough)
    against = contact_nats if contradicted is None else contradicted
    doubted = _contradicted(residuals, pixel_share, seeing, settings, enough) is not None
    if word == "ok" and against > settings.most_contradicted * max(len(residuals), 1):
        word = "ambiguous" if _excused(residuals, pixel_share, seeing, settings) else "lost"
        why, doubted = "the contacts, or their normals, contradict every pose", True
    agreeing = float(picture.agree[0] * picture.area[0]) if picture is not None else np.inf
    if word == "ok" and not residuals and agreeing < settings.least_agreeing:
        word, why, doubted = "ambiguous", f"only {agreeing:.0f} pixels agree and nothing touches it", True
    if doubted:
        sure = min(sure, settings.most_doubted)
    if word == "ok" and not enough:
        word, why = "ambiguous", _unsure(model, modes[0], right, sure, confident)
    return right, sure, word, why


def _unsure(model: ObjectModel, mode: Mode, right: float, sure: float, settings: ConfidenceSettings) -> str:
    """Why an answer is not sure enough: another may be the right one, or this one is not known well enough; and then
    whether it is its distance from the camera, of which a calibrated camera would tell more.
    """
    said = f"only {sure:.0%} sure to be within {1e3 * settings.tolerance:.3g} mm"
    if right < settings.sure:
        return f"{said}: what is sensed would show another pose nearly as well"
    values, vectors = np.linalg.eigh(mode.covariance[3:, 3:])
    centre = se3.apply(mode.pose, model.centroid[None])[0]
    along = abs(float(vectors[:, -1] @ centre)) / max(float(np.linalg.norm(centre)), 1e-9)
    worst = 1e3 * float(np.sqrt(max(values[-1], 0.0)))
    where = "its distance" if along > np.cos(np.deg2rad(25.0)) else "its position"
    return f"{said}: {where} is known to {worst:.1f} mm (1 sigma)"


def no_answer(
    frame: Frame,
    model: ObjectModel,
    prior: Prior | None,
    trace: tuple[Stage, ...],
    mode_settings: ModeSettings,
    settings: VerdictSettings,
) -> Estimate:
    """No row of evidence at all: the prior (or the identity), as wide as it is, and the verdict lost."""
    pose = prior.pose if prior is not None else np.eye(4)
    information = prior.information if prior is not None else np.zeros((6, 6))
    nothing = alignment.Alignment(pose[None], np.zeros(1), information[None], np.zeros(1, dtype=np.int64))
    modes = distinct_modes(model, nothing, mode_settings)
    return Estimate(
        frame.index,
        pose,
        modes[0].covariance,
        modes,
        "lost",
        unobservable(model, pose, modes[0].covariance, settings),
        frame.hand_from_object(pose, np.eye(4)),
        0.0,
        trace,
        notes=(_nothing(frame, model, prior),),
        start=prior.pose if prior is not None else None,
    )


def _nothing(frame: Frame, model: ObjectModel, prior: Prior | None) -> str:
    """Why there is no row, in words: an image that could not be read is as good as none was taken."""
    felt = len(frame.contacts) or frame.no_contact is not None or frame.wrenches or frame.tactile or frame.gels
    if frame.depth is None and frame.cloud is None and not felt:
        return "no evidence: the frame has no depth image, no cloud and no touch"
    return f"no evidence: no pixel of the object{_near(frame, model, prior)} and no contact"


def _near(frame: Frame, model: ObjectModel, prior: Prior | None) -> str:
    """Where nothing is, in words: a start may lie where no camera looks."""
    if prior is None:
        return ""
    behind = frame.camera is not None and se3.apply(prior.pose, model.centroid[None])[0, 2] <= 0.0
    return " near the start, which is behind the camera," if behind else " near the start"
