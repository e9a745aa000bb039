"""What the fingers report as rows of evidence: contacts, wrenches, taxel arrays, empty regions, the hand itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from scenes.evidence import table as tables
from scenes.evidence.table import SIGMA, TOUCH, WEIGHT, Evidence
from scenes.recordings.beliefs import Beliefs, CalibrationModel, TouchModel
from scenes.recordings.frames import DEFAULT_SIGMA_POINT, Contacts, Frame
from touch.arrays.readings import Reading, readings_of
from touch.arrays.rows import ArrayRowSettings, array_contacts, taxel_rows
from touch.gels.patches import Patch, PatchSettings, patches_of
from touch.gels.rows import GelRowSettings, gel_contacts, patch_rows, unspoken
from touch.thinning import cells_of, informative
from touch.wrenches.intrinsic import wrench_contacts

Array = NDArray[np.float64]


__all__ = ["Felt", "feel"]


class Ball(Protocol):
    """Where to look: centre (3,) camera frame and radius, metres."""

    @property
    def centre(self) -> Array: ...
    @property
    def radius(self) -> float: ...


@dataclass(frozen=True)
class TouchSettings:
    """How touch becomes rows of evidence. Values by judgement."""

    # A contact is as likely a false one at this many sigmas.
    contact_gate: float = 4.0
    # Beside a depth image so is one that says no sigma, at this many of what is believed of it: of unknown worth, one
    # that touched something else would outvote ten thousand pixels. Of 4, 5 and 8 tuned with false contacts and none.
    unknown_gate: float = 5.0
    # More contacts than this (no unit) are taken by so many of them, spread over what was touched: what all of them
    # share (calibration, the finger, the mesh) is larger than what the rest would add, and a search's time grows with
    # its rows. As `LocalizeSettings.most_contacts`, which settles with all.
    most_contacts: int = 400
    # Contacts of sensors that report no other are one finger's where they are nearer to each other than this (m): the
    # skins of two fingers alone keep them farther apart.
    same_finger: float = 0.005
    # And those of one sensor where steps no longer than this (m), as a fingertip, lead from one to the next: a whole
    # hand may be told as one. By judgement.
    fingertip: float = 0.025
    # Points on the hand used as "the object is not in here" (0: none; so many, and fewer than twice as many where there
    # are), their sigma (m) and gate (sigmas).
    hand_points: int = 150
    hand_sigma: float = 0.003
    hand_gate: float = 4.0
    arrays: ArrayRowSettings = field(default_factory=ArrayRowSettings)
    # Gels: how images become patches, and what those are worth.
    patches: PatchSettings = field(default_factory=PatchSettings)
    gels: GelRowSettings = field(default_factory=GelRowSettings)


@dataclass(frozen=True)
class Shared:
    """What contacts of one finger are off by together: of (n,), the finger that each is of; variance (n,) m^2 of that
    error along an axis; joints (n,) m, the part of it that their own sigmas do not have.
    """

    of: NDArray[np.intp]
    variance: Array
    joints: Array

    @staticmethod
    def by(contacts: Contacts, believed: TouchModel, with_hand: bool, near: tuple[float, float]) -> Shared:
        """What a finger's joints add, whoever tells of them: where no hand does, only contacts that have company on
        their finger are asked. What is believed of contacts that say no sigma is shared, but for what one that says
        none has alone.
        """
        of = fingers_of(contacts, near)
        company = np.bincount(of)[of] > 1 if len(of) else np.zeros(0, dtype=np.bool_)
        untold = np.maximum(contacts.sigma_point**2 - DEFAULT_SIGMA_POINT**2, 0.0)
        joints = np.where(company | with_hand, believed.fingertip_sigma, 0.0)
        return Shared(of, joints**2 + np.where(contacts.sigma_told, 0.0, untold), joints)

    def weights(self, sigma: Array) -> Array:
        """(n,) of contacts with errors sigma (n,) m, the shared one included: with own variances v and a shared s they
        know where their finger is as well as sum(1/v) / (1 + s sum(1/v)) says, however many they are.
        """
        if not len(sigma):
            return np.zeros(0)
        own = 1.0 / np.maximum(sigma**2 - self.variance, 1e-12)
        of_finger = np.bincount(self.of, own)[self.of]
        return np.asarray((1.0 + self.variance * own) / (1.0 + self.variance * of_finger))


@dataclass(frozen=True)
class Felt:
    """All that a frame's fingers say, camera frame.

    reported_contacts and reported_rows: as the robot reports them. correction (4, 4) camera_from_camera: moves that to
    where it is, as far as known by now; `contacts`, `rows` and `patches` are moved. slack (m): what nothing has
    corrected yet, in the sigmas of `rows`. reported_patches: of gels, those that touch something. left_out: in words,
    what of touch is not used and why. shared: what contacts of a finger are off by together; weighed: whether their
    rows are weighed down to what that leaves of the finger's place.
    """

    reported_contacts: Contacts
    reported_rows: Evidence
    correction: Array
    slack: float = 0.0
    reported_patches: tuple[Patch, ...] = ()
    left_out: tuple[str, ...] = ()
    shared: Shared | None = None
    weighed: bool = True

    @property
    def patches(self) -> tuple[Patch, ...]:
        """What gels felt, corrected."""
        return tuple(patch.moved(self.correction) for patch in self.reported_patches)

    @property
    def fingers(self) -> int:
        """How many fingers the contacts are of."""
        return 0 if self.shared is None or not len(self.shared.of) else int(self.shared.of.max()) + 1

    @property
    def of_finger(self) -> Array:
        """(n,) what part of its finger's contacts each contact is."""
        if self.shared is None:
            return np.ones(len(self.reported_contacts))
        return np.asarray(1.0 / np.bincount(self.shared.of)[self.shared.of]) if self.fingers else np.zeros(0)

    @property
    def untold(self) -> tuple[str, ...]:
        """In words, what is believed of contacts that say no sigma; none when all do."""
        felt = self.reported_contacts
        if felt.sigma_known:
            return ()
        silent = ~felt.sigma_told
        who = "contacts" if silent.all() else f"{int(silent.sum())} of {len(felt)} contacts"
        believed = 1e3 * float(felt.sigma_point[silent][0])
        gate = float(self.reported_rows.rows[: len(felt)][silent, tables.GATE_ABOVE].min())
        false = "none" if gate >= tables.NO_GATE else f"those beyond {gate * believed:.3g} mm"
        return (f"{who} say no sigma: {believed:g} mm believed of each, {false} taken for false",)

    @cached_property
    def contacts(self) -> Contacts:
        """The contacts, corrected."""
        return self.reported_contacts.moved(self.correction)

    @cached_property
    def rows(self) -> Evidence:
        """The rows of evidence, corrected."""
        rows = self.reported_rows
        if self.slack and len(rows):
            rows = rows.widened(self.slack)
        return rows.moved(self.correction)

    @property
    def each(self) -> Evidence:
        """The rows with every contact in full: how contacts of one finger lie to one another tells where to look."""
        contacts = np.arange(len(self.rows)) < len(self.reported_contacts)
        rows = self.rows.rows.copy()
        rows[contacts, WEIGHT] = 1.0
        return Evidence(rows, self.rows.sense)

    def corrected(self, correction: Array) -> Felt:
        """The same with another correction, as sure as its own sigmas say."""
        return replace(self, correction=correction, slack=0.0)


def feel(
    frame: Frame,
    correction: Array | None = None,
    beliefs: Beliefs | None = None,
    region: Ball | None = None,
    settings: TouchSettings | None = None,
    beside_vision: bool = True,
) -> Felt:
    """All touch evidence of a frame, camera frame.

    correction (4, 4) camera_from_camera: moves what the robot reports to where it is; None when nothing has told: a
    frame seen by a camera is then as uncertain as its calibration. region: ball around which the hand's own surface is
    listed as space the object cannot be in; None lists none. beside_vision: contacts of one finger are weighed down to
    what they know of its place, which is what is asked of them beside an image; where they are alone, how they lie to
    one another tells the turn. What either leaves out is told of an answer (`fusion.estimation.steps.fingers`).
    Sensors that nothing places are left out, and so is what a thousand contacts would add to some hundreds; the answer
    says so. Raises CaptureError for sensors that the hand does not have and readings that do not fit it.
    """
    settings, beliefs = settings or TouchSettings(), beliefs or Beliefs()
    frame, left_out = placed(frame)
    frame, spared = thinned(frame, settings.most_contacts)
    left_out = *left_out, *spared
    readings, patches = readings_of(frame), patches_of(frame, settings.patches)
    pushed = wrench_contacts(frame)
    left_out = *left_out, *_no_touch(frame, pushed)
    reported = _reported(frame, pushed, readings, patches, settings).of_unknown_worth(beliefs.touch.unknown_sigma)
    with_hand = _has_hand(frame)
    # where no image shows the object, a contact of unknown worth cannot be told from a false one
    unknown = settings.unknown_gate if beside_vision and frame.depth is not None else tables.NO_GATE
    rows = tables.from_contacts(reported, np.where(reported.sigma_told, settings.contact_gate, unknown))
    shared = Shared.by(reported, beliefs.touch, with_hand, (settings.same_finger, settings.fingertip))
    rows = rows.widened(shared.joints)
    if beside_vision:
        # a row's own sigma stays one finger's, from which what is false is told
        rows = rows.reweighted(shared.weights(rows.rows[:, SIGMA]))
    parts = [rows, taxel_rows(readings, settings.arrays), patch_rows(patches, settings.gels)]
    if frame.no_contact is not None and len(frame.no_contact):
        centres = frame.no_contact.points @ frame.camera_from_world[:3, :3].T + frame.camera_from_world[:3, 3]
        parts.append(
            tables.outside(centres, settings.hand_sigma, TOUCH, radius=frame.no_contact.radius, gate=settings.hand_gate)
        )
    if with_hand and len(reported) and settings.hand_points:
        parts.append(_hand_rows(frame, region, settings))
    table = tables.stack(*parts)
    pressed = tuple(patch for patch in patches if len(patch))
    known = correction is not None or frame.camera is None
    slack = 0.0 if known else _calibration_slack(table, beliefs.calibration)
    moved = np.eye(4) if correction is None else correction
    return Felt(reported, table, moved, slack, pressed, left_out, shared, beside_vision)


def places_touched(frame: Frame, settings: TouchSettings | None = None) -> Array:
    """(n, 3) where a frame's contacts, wrenches, arrays and gels touch the object, camera frame, m, as the robot
    reports it; one place a finger and kind of sensor at most. Sensors that nothing places touch nowhere.
    """
    settings = settings or TouchSettings()
    frame, _ = placed(frame)
    patches = patches_of(frame, settings.patches)
    return _reported(frame, wrench_contacts(frame), readings_of(frame), patches, settings).points


def placed(frame: Frame) -> tuple[Frame, tuple[str, ...]]:
    """The frame without the wrenches, arrays and gels of which nothing tells where they are (there is no hand, or its
    pose or joints are not known), without wrenches of sensors whose surface nobody tells, and with every row once; and
    notes of these.
    """
    frame, again = each_once(frame)
    frame, left_out = _with_places(frame)
    return frame, (*again, *left_out)


def each_once(frame: Frame) -> tuple[Frame, tuple[str, ...]]:
    """The frame without contacts and wrenches that are another one over again in every number, and notes of these: a
    row that was written twice is no second touch.
    """
    notes = []
    first = frame.contacts.first_of_each
    if len(first) < len(frame.contacts):
        notes.append(f"{len(first)} of {len(frame.contacts)} contacts are used, the others repeat them")
        frame = replace(frame, contacts=frame.contacts.take(first))
    if len(frame.wrenches) > 1:
        once = {(w.sensor, w.force.tobytes(), w.torque.tobytes()): w for w in reversed(frame.wrenches)}
        if len(once) < len(frame.wrenches):
            notes.append(f"{len(once)} of {len(frame.wrenches)} wrenches are used, the others repeat them")
            frame = replace(frame, wrenches=tuple(reversed(once.values())))
    return frame, tuple(notes)


def _with_places(frame: Frame) -> tuple[Frame, tuple[str, ...]]:
    if not (frame.wrenches or frame.tactile or frame.gels):
        return frame, ()
    hand = frame.hand
    if hand is None or frame.hand_lacks:
        kinds = {"wrenches": frame.wrenches, "arrays": frame.tactile, "gels": frame.gels}
        said = " and ".join(name for name, felt in kinds.items() if felt)
        note = f"{said} are left out: no {frame.hand_lacks or 'hand'} known"
        return replace(frame, wrenches=(), tactile={}, gels={}), (note,)
    sensors = hand.sensors
    bare = {one.sensor for one in frame.wrenches if one.sensor in sensors and sensors[one.sensor].surface is None}
    if not bare:
        return frame, ()
    # what is in a wrist, say, and not in a fingertip
    note = f"wrenches of {', '.join(sorted(bare))} are left out: no surface known to find contacts on"
    return replace(frame, wrenches=tuple(one for one in frame.wrenches if one.sensor not in bare)), (note,)


def thinned(frame: Frame, most: int) -> tuple[Frame, tuple[str, ...]]:
    """The frame with `most` contacts at most, spread over what was touched (`touch.thinning`), and a note of it."""
    contacts = frame.contacts
    if len(contacts) <= most:
        return frame, ()
    few = contacts.take(informative(contacts, cells_of(contacts, most), most))
    return replace(frame, contacts=few), (f"{most} of {len(contacts)} contacts are used, spread over what was touched",)


def unused_touch(frame: Frame, settings: TouchSettings) -> tuple[str, ...]:
    """In words, what of a frame's touch `feel` does not use and why, without feeling it."""
    frame, left_out = placed(frame)
    return *left_out, *thinned(frame, settings.most_contacts)[1], *_no_touch(frame, wrench_contacts(frame))


def _has_hand(frame: Frame) -> bool:
    """Whether a frame tells where every part of its hand is."""
    return frame.hand is not None and frame.joints is not None and frame.world_from_hand is not None


def _no_touch(frame: Frame, pushed: Contacts) -> tuple[str, ...]:
    """In words, how many wrenches make no contact."""
    lost = len(frame.wrenches) - len(pushed)
    why = "no force, or none that presses on the surface"
    return (f"{lost} of {len(frame.wrenches)} wrenches make no contact: {why}",) if lost else ()


def _reported(
    frame: Frame, pushed: Contacts, readings: Sequence[Reading], patches: Sequence[Patch], settings: TouchSettings
) -> Contacts:
    """Contacts of all sensors, camera frame; those of wrenches, arrays and gels on links that no sensor before them
    reports one of: one touch is one contact. pushed: contacts of the wrenches, world frame.
    """
    found = frame.contacts.moved(frame.camera_from_world)
    pushed = pushed.moved(frame.camera_from_world)
    if len(pushed) and frame.hand is not None:
        sensors = frame.hand.sensors
        spoken = {sensors[name].link for name in found.sensors if name in sensors}
        pushed = pushed.take([sensors[name].link not in spoken for name in pushed.sensors])
    found = Contacts.concatenate([found, pushed])
    found = Contacts.concatenate([found, array_contacts(_unspoken(frame, found, readings), settings.arrays)])
    return Contacts.concatenate([found, gel_contacts(unspoken(frame, found, patches), settings.gels)])


def fingers_of(contacts: Contacts, near: tuple[float, float]) -> NDArray[np.intp]:
    """(n,) number of the finger that each contact is of: its sensor's, as far as steps of one fingertip (m) lead from
    contact to contact, for a whole hand may have one name; sensors that report one contact each, as where nobody names
    them, are one finger's while next to another (m), for no two fingertips are as close.
    """
    same_finger, fingertip = near
    index = np.unique(np.array(contacts.sensors), return_inverse=True)[1]
    if len(index) < 2:
        return index
    lone = np.bincount(index)[index] == 1
    between = np.linalg.norm(contacts.points[:, None] - contacts.points[None], axis=-1)
    together = (index[:, None] == index[None]) & (between < fingertip)
    together |= lone[:, None] & lone[None] & (between < same_finger)
    # each takes the least number of what it is together with, until none is less
    first = np.arange(len(index))
    while True:
        least = np.where(together, first, len(index)).min(axis=1)
        if (least == first).all():
            return np.unique(first, return_inverse=True)[1]
        first = least


def _calibration_slack(rows: Evidence, calibration: CalibrationModel) -> float:
    """How far (m) what the robot reports may be from where it is, at the rows' distance from the camera."""
    if not len(rows):
        return 0.0
    depth = float(np.linalg.norm(rows.points.mean(axis=0)))
    return float(np.hypot(calibration.translation_sigma, calibration.rotation_sigma * depth))


def _unspoken(frame: Frame, contacts: Contacts, readings: Sequence[Reading]) -> list[Reading]:
    """Arrays on links that no other sensor reports a contact of: one touch is one contact, however many sensors."""
    if frame.hand is None:
        return []
    sensors = frame.hand.sensors
    spoken = {sensors[name].link for name in contacts.sensors if name in sensors}
    return [reading for reading in readings if sensors[reading.sensor].link not in spoken]


def _hand_rows(frame: Frame, region: Ball | None, settings: TouchSettings) -> Evidence:
    """OUTSIDE rows on the hand's surface near the region: a solid hand leaves no room for the object."""
    assert frame.hand is not None
    assert frame.joints is not None
    assert frame.world_from_hand is not None
    camera_from_hand = frame.camera_from_world @ frame.world_from_hand
    centre, radius = (np.zeros(3), np.inf) if region is None else (region.centre, region.radius)
    points = frame.hand.points_in_ball(frame.joints, camera_from_hand, centre, radius)
    if not len(points):
        return tables.empty()
    step = max(1, len(points) // settings.hand_points)
    points = points[::step]
    rows = tables.outside(points, settings.hand_sigma, TOUCH, gate=settings.hand_gate)
    # neighbouring points of one link repeat one another: together they count like a few
    return rows.reweighted(min(1.0, 20.0 / len(points)))
