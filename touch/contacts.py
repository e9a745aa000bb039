"""What the fingers report as rows of evidence: contacts, wrenches, taxel arrays, empty regions, the hand itself."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from scenes.evidence import table as tables
from scenes.evidence.table import SIGMA, TOUCH, Evidence
from scenes.recordings.frames import Contacts, Frame
from touch.arrays.readings import Reading, readings_of
from touch.arrays.rows import ArrayRowSettings, array_contacts, taxel_rows
from touch.gels.patches import PatchSettings, patches_of
from touch.gels.rows import GelRowSettings, gel_contacts, patch_rows, unspoken
from touch.localization import contact_starts
from touch.wrenches.intrinsic import wrench_contacts

Array = NDArray[np.float64]

__all__ = ["Felt", "contact_starts", "feel"]


class Calibration(Protocol):
    """How far the robot may be from where it says it is: metres and radians per axis, at the camera."""

    @property
    def translation_sigma(self) -> float: ...
    @property
    def rotation_sigma(self) -> float: ...


class Ball(Protocol):
    """Where to look: centre (3,) camera frame and radius, metres."""

    @property
    def centre(self) -> Array: ...
    @property
    def radius(self) -> float: ...


@dataclass(frozen=True)
class TouchSettings:
    """What is believed of touch beyond the contacts' own sigmas."""

    # Points on the hand used as "the object is not in here", their sigma (m) and gate (sigmas).
    hand_points: int = 150
    hand_sigma: float = 0.003
    hand_gate: float = 4.0
    # What a contact is worth beside another sense when its recording does not say, metres: kinematics, calibration and
    # fingertip shape together (iCub's fingertips are some millimetres off its stereo cloud).
    unknown_sigma: float = 0.004
    # Error of the finger joints between palm and fingertip, metres (0.3 degrees at three joints).
    fingertip_sigma: float = 0.0008
    arrays: ArrayRowSettings = field(default_factory=ArrayRowSettings)
    # Gels: how images become patches, and what those are worth.
    patches: PatchSettings = field(default_factory=PatchSettings)
    gels: GelRowSettings = field(default_factory=GelRowSettings)


@dataclass(frozen=True)
class Felt:
    """contacts in the camera frame as the robot reports them; rows: all touch evidence in that frame."""

    contacts: Contacts
    rows: Evidence

    def slackened(self, calibration: Calibration, uncorrected: bool) -> Evidence:
        """The rows with the calibration's error added to their sigmas when nothing has corrected it."""
        if not uncorrected or not len(self.rows):
            return self.rows
        rows = self.rows.rows.copy()
        depth = float(np.linalg.norm(rows[:, :3].mean(axis=0)))
        slack = np.hypot(calibration.translation_sigma, calibration.rotation_sigma * depth)
        rows[:, SIGMA] = np.hypot(rows[:, SIGMA], slack)
        return Evidence(rows, self.rows.sense)


def feel(frame: Frame, gate: float, region: Ball | None = None, settings: TouchSettings | None = None) -> Felt:
    """All touch evidence of a frame, camera frame.

    gate: sigmas at which a contact is as likely a false one. region: ball around which the hand's own surface is
    listed as space the object cannot be in; None lists none.
    """
    settings = settings or TouchSettings()
    contacts = Contacts.concatenate([frame.contacts, wrench_contacts(frame)])
    contacts = contacts.moved(frame.camera_from_world)
    readings = readings_of(frame)
    contacts = Contacts.concatenate([contacts, array_contacts(_unspoken(frame, contacts, readings), settings.arrays)])
    patches = patches_of(frame, settings.patches)
    contacts = Contacts.concatenate([contacts, gel_contacts(unspoken(frame, contacts, patches), settings.gels)])
    with_hand = frame.hand is not None and frame.joints is not None and frame.world_from_hand is not None
    if len(contacts) and not contacts.sigma_known:
        contacts.sigma_point[:] = settings.unknown_sigma
    # a contact of unknown worth cannot be told from a false one: it is never gated out
    rows = tables.from_contacts(contacts, gate if contacts.sigma_known else tables.NO_GATE)
    if with_hand and len(contacts):
        rows.rows[:, SIGMA] = np.hypot(contacts.sigma_point, settings.fingertip_sigma)
    parts = [rows, taxel_rows(readings, settings.arrays), patch_rows(patches, settings.gels)]
    if frame.no_contact is not None and len(frame.no_contact):
        centres = frame.no_contact.points @ frame.camera_from_world[:3, :3].T + frame.camera_from_world[:3, 3]
        parts.append(
            tables.outside(centres, settings.hand_sigma, TOUCH, radius=frame.no_contact.radius, gate=settings.hand_gate)
        )
    if with_hand and len(contacts):
        parts.append(_hand_rows(frame, region, settings))
    return Felt(contacts, tables.stack(*parts))


def _unspoken(frame: Frame, contacts: Contacts, readings: list[Reading]) -> list[Reading]:
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
    points = frame.hand.points_on_surface(frame.joints)
    camera_from_hand = frame.camera_from_world @ frame.world_from_hand
    points = points @ camera_from_hand[:3, :3].T + camera_from_hand[:3, 3]
    if region is not None:
        points = points[np.linalg.norm(points - region.centre, axis=1) < region.radius]
    if not len(points):
        return tables.empty()
    step = max(1, len(points) // settings.hand_points)
    points = points[::step]
    rows = tables.outside(points, settings.hand_sigma, TOUCH, gate=settings.hand_gate)
    # neighbouring points of one link repeat one another: together they count like a few
    return rows.reweighted(min(1.0, 20.0 / len(points)))
