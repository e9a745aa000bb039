"""What may be said of a tracked frame, by the rules of an estimate: the picture of the pose must be seen."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from fusion.estimation.answer import ContactResidual, Estimate, Mode, Stage
from fusion.estimation.posterior import verdict as posterior
from fusion.estimation.posterior.confidence import within
from fusion.estimation.posterior.whole import told_covariance, whole_covariance
from fusion.estimation.solve.joint import JointResult
from fusion.tracking.answer import TrackedEstimate, TrackSettings
from fusion.tracking.filter import Belief
from fusion.tracking.memory.hypotheses import Hypotheses, weights
from fusion.tracking.memory.sizes import Sizes
from fusion.tracking.memory.state import TrackState
from fusion.tracking.slip import Watched
from fusion.tracking.steps.refining import Refined
from fusion.tracking.steps.sensing import Sensed
from scenes.evidence.symmetry.alike import alike
from scenes.geometry.objects import ObjectModel
from scenes.recordings.beliefs import Beliefs
from scenes.recordings.frames import Frame
from vision.picture.prediction import Prediction
from vision.visibility import Visibility, visibility

Array = NDArray[np.float64]

_DOUBTED = "no frame searched by itself has found the object there"
_LARGE = "what frames of this recording share is larger than one frame believes"


@dataclass(frozen=True)
class Judged:
    """verdict, its reason; covariance (6, 6) of all that may be the case; right: chance that the first mode is right;
    confidence; modes: the hypotheses with their weights; how contacts (residuals) and pixels (share explained, rms m)
    agree; visible: share of the object that is seen; unobservable: directions, in words; sizes: with what this look
    left unexplained, of a glance nothing.
    """

    verdict: str
    why: str
    covariance: Array
    right: float
    confidence: float
    modes: tuple[Mode, ...]
    residuals: tuple[ContactResidual, ...]
    share: float
    rms: float
    visible: float
    unobservable: tuple[str, ...]
    sizes: Sizes = field(default_factory=Sizes)


def judge(
    model: ObjectModel,
    found: Refined,
    solved: JointResult,
    belief: Belief,
    sensed: Sensed,
    state: TrackState,
    leap: Array,
    beliefs: Beliefs,
    settings: TrackSettings,
) -> Judged:
    """Judge the belief of the leading hypothesis, told as wide as looks until this one have shown. solved: the frame's
    own solution; state: what was remembered before; leap (6,): of the frame's own answer from the prediction, 0 where
    there is none.
    """
    first, pose, hypotheses, sizes = settings.first, belief.pose, found.hypotheses, state.sizes
    contacts = sensed.felt.contacts
    residuals = posterior.contact_residuals(model, contacts, pose, first.verdict, sensed.felt.of_finger)
    if sensed.told_apart:
        sizes = sizes.learned(solved, residuals, settings.sizes, found.switched)
    belief = state.told(belief, settings.sizes, sizes)
    part = weights(hypotheses, settings.hypotheses)
    best = hypotheses[0].score
    modes = (
        Mode(pose, float(part[0]), 0.0, belief.covariance),
        *(Mode(h.pose, float(w), best - h.score, h.covariance) for h, w in zip(hypotheses[1:], part[1:])),
    )
    share, rms = posterior.pixel_agreement(model, sensed.seen, pose)
    picture = None if sensed.pool is None else sensed.pool.predictor.predict(pose[None], settings.side)
    seeing = visibility(sensed.viewed, model, pose, beliefs.depth) if picture is None else as_seen(picture)
    nats = posterior.nats_of_contacts(model, sensed.felt.rows, len(contacts), pose)
    agreed, same = (residuals, nats, share, seeing, picture), alike(model, modes, first.confidence.tolerance)
    # contacts are where this frame's solution has the hand, the belief is where all frames have the object: it is
    # contradicted where the frame's own answer is, too
    every = pose, solved.pose
    against = min(posterior.contradiction(model, sensed.felt.rows, len(contacts), one, first.verdict) for one in every)
    rules = first.verdict, settings.confident if sensed.told_apart else first.confidence
    right, sure, word, why = posterior.judged(model, modes, *agreed, *rules, same=same, contradicted=against)
    if word != "lost" and strays(share, state.usual, len(sensed.looked.pixels), settings):
        word, why = "lost", f"{share:.0%} of the pixels explained, {state.usual:.0%} before"
    if word != "lost" and settings.leaps(leap):
        turn, move = np.rad2deg(np.linalg.norm(leap[:3])), 1e3 * np.linalg.norm(leap[3:])
        word, why = "lost", f"{turn:.0f} degrees and {move:.0f} mm from the prediction"
    covariance = as_open(model, modes, word, right, settings)
    unknown = posterior.unobservable(model, pose, belief.covariance, first.verdict)
    # what is lost is not to be trusted at all
    sure = 0.0 if word == "lost" else sure
    return Judged(word, why, covariance, right, sure, modes, residuals, share, rms, seeing.visible, unknown, sizes)


def as_open(model: ObjectModel, modes: tuple[Mode, ...], word: str, right: float, settings: TrackSettings) -> Array:
    """(6, 6) covariance of an answer with that verdict. As long as another hypothesis is followed nothing is decided:
    that of an `ok` one holds all of them by their weights.
    """
    how = settings.first.confidence
    return whole_covariance(model, modes, 0.0 if word == "ok" else how.none_of(right), None, how)


def as_believed(
    model: ObjectModel, answer: TrackedEstimate, hypotheses: Hypotheses, settings: TrackSettings
) -> TrackedEstimate:
    """The answer, which is not ok while no frame searched by itself speaks for it; as wide as if it were right no more
    often than `unvoted`, for how far off it is when it is not nothing tells.
    """
    how = settings.hypotheses
    if answer.verdict == "lost" or hypotheses[0].votes >= how.believed:
        return answer
    less = min(answer.confidence, how.unvoted)
    wide = told_covariance(model, answer.modes, "ambiguous", less, None, settings.first.confidence)
    notes = (_DOUBTED, *(note for note in answer.notes if note != _DOUBTED))  # it is asked again after a search
    sure = min(answer.confidence, how.unvoted_told)
    return replace(answer, verdict="ambiguous", covariance=wide, confidence=sure, notes=notes)


def as_learned(model: ObjectModel, answer: Estimate, sizes: Sizes, smear: Array, settings: TrackSettings) -> Estimate:
    """A frame's own answer amid a track that had lost the object: less sure where looks before it have shown that what
    frames of this recording share is larger than one frame believes, or it moves (smear: (6,) by what the exposure may
    be off by); and as wide as all that may be the case, where it is not sure, for it was looked for about the
    prediction, of which nothing is known but that the object was not there.
    """
    how, lasting, first = settings.first.confidence, settings.first_lasting, answer.modes[0]
    if answer.verdict != "ok":
        open_to = told_covariance(model, answer.modes, answer.verdict, answer.confidence, None, how)
        return replace(answer, covariance=open_to)
    wider, moved = max(1.0, 1.0 + lasting * (sizes.factor(settings.sizes) - 1.0)), np.outer(smear, smear)
    if wider == 1.0 and not smear.any():
        return answer
    told = how.tolerance, how.seen.nearest
    near, less = (
        within(model, first.pose, covariance, *told)
        for covariance in (first.covariance, wider * first.covariance + moved)
    )
    sure = answer.confidence * less / max(near, less)
    wide = replace(answer, covariance=wider * answer.covariance + moved, confidence=sure)
    if sure >= how.sure:
        return wide
    return replace(wide, verdict="ambiguous", notes=(_LARGE, *answer.notes))


def as_seen(picture: Prediction) -> Visibility:
    """The shares of one predicted picture in the words of `vision.visibility`."""
    if not picture.count[0]:
        return Visibility(np.nan, np.nan, np.nan, np.nan)
    hidden = float(picture.hidden[0] + picture.behind_hand[0])
    agree, past = float(picture.agree[0]), float(picture.past[0])
    return Visibility(agree, hidden, past, max(0.0, 1.0 - agree - past - hidden))


def slips_unseen(watched: Watched, pixels: int, state: TrackState, settings: TrackSettings) -> bool:
    """Whether fingers alone would have it that an object which images have shown slips: next to nothing of it is seen,
    pixels, and no skin says so. They do not prove it: contacts are off as a calibration is, and so is a hold that fits
    them. Of 43 frames of tuning families in which that was believed, and after which until the object was seen, 9 were
    right and 7 `ok`; of 454 others that show as little 95 % were right.
    """
    alone = watched.slip and not watched.by_skin and pixels < settings.fewest_pixels
    return alone and state.hand is not None and state.seen_at is not None


def by_touch_alone(said: Judged, watched: Watched, pixels: int, state: TrackState, settings: TrackSettings) -> bool:
    """Whether it is by touch alone that the hand has lost what it holds, or that this slips; it goes with the hand."""
    lost = said.verdict == "lost" and state.hand is not None and not pixels
    return lost or slips_unseen(watched, pixels, state, settings)


def strays(share: float, usual: float | None, pixels: int, settings: TrackSettings) -> bool:
    """Whether far fewer of the pixels are explained than before."""
    if usual is None or pixels < settings.fewest_pixels or not np.isfinite(share):
        return False
    return bool(share < settings.least_of_usual * usual)


def as_followed(
    frame: Frame,
    belief: Belief,
    predicted: Belief,
    said: Judged,
    watched: Watched,
    sensed: Sensed,
    trace: tuple[Stage, ...],
    settings: TrackSettings,
) -> TrackedEstimate:
    """The answer of a frame that was followed; predicted: the belief before it."""
    slips = f"slips in the hand ({watched.by}); " if watched.slip else ""
    return TrackedEstimate(
        frame=frame.index,
        pose=belief.pose,
        covariance=said.covariance,
        modes=said.modes,
        verdict=said.verdict,
        unobservable=said.unobservable,
        hand_from_object=frame.hand_from_object(belief.pose, sensed.felt.correction),
        visible_fraction=said.visible,
        trace=trace,
        contacts=said.residuals,
        pixel_rms_mm=1e3 * said.rms,
        notes=(slips + said.why,),
        dropped=sensed.looked.dropped,
        start=predicted.pose,
        confidence=said.confidence,
        sure_within=settings.first.confidence.tolerance,
        how="lost" if said.verdict == "lost" else "tracked",
        slip=watched.slip,
        slip_statistic=watched.statistic,
        moved_in_hand=watched.moved,
    )
