"""Patches of gels as rows of evidence: what the skin lies on is ON the surface, with normals; the rest is OUTSIDE."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenes.evidence import table as tables
from scenes.evidence.table import TOUCH, Evidence
from scenes.recordings.frames import Contacts, Frame
from touch.gels.patches import Patch

Array = NDArray[np.float64]


@dataclass(frozen=True)
class GelRowSettings:
    """What rows of gels are worth. Values by judgement, but for what is measured below."""

    # Error of a gel's place (m, rad): the finger's joints, which all of its points share.
    place_sigma: float = 0.001
    turn_sigma: float = float(np.deg2rad(2.0))
    # All points of one patch count like this many independent ones: they share the finger's error and the gel's. Those
    # of the skin that felt nothing count like so many, too. With twice as many, 95 % regions of simulated presses held
    # 77 % of the truths instead of 97 %.
    shared: float = 1.5
    silent: float = 1.0
    # A point is as likely a false one at this many sigmas.
    gate: float = 5.0


def gel_contacts(patches: Sequence[Patch], settings: GelRowSettings | None = None) -> Contacts:
    """One contact for each gel that touches: the patch's middle and its mean normal, out of the object."""
    settings = settings or GelRowSettings()
    on = [patch for patch in patches if len(patch)]
    if not on:
        return Contacts.none()
    return Contacts(
        np.array([patch.middle for patch in on]),
        np.array([patch.normal for patch in on]),
        np.array([np.hypot(settings.place_sigma, np.median(patch.sigma)) for patch in on]),
        np.array([np.hypot(settings.turn_sigma, np.median(patch.sigma_normal)) for patch in on]),
        [patch.sensor for patch in on],
        sigma_told=True,
    )


def unspoken(frame: Frame, contacts: Contacts, patches: Sequence[Patch]) -> list[Patch]:
    """Patches on links that no other sensor reports a contact of: one touch is one contact, however many sensors."""
    if frame.hand is None:
        return []
    sensors = frame.hand.sensors
    spoken = {sensors[name].link for name in contacts.sensors if name in sensors}
    return [patch for patch in patches if sensors[patch.sensor].link not in spoken]


def patch_rows(patches: Sequence[Patch], settings: GelRowSettings | None = None) -> Evidence:
    """ON rows with normals where skins are touched, OUTSIDE rows where they are not; the patches' frame."""
    settings = settings or GelRowSettings()
    parts = [
        tables.make(
            patch.points,
            np.hypot(settings.place_sigma, patch.sigma),
            TOUCH,
            normals=patch.normals,
            sigma_normal=np.hypot(settings.turn_sigma, patch.sigma_normal),
            weight=min(1.0, settings.shared / len(patch)),
            gate_above=settings.gate,
            gate_below=settings.gate,
            from_outside=True,
        )
        for patch in patches
        if len(patch)
    ]
    return tables.stack(*parts, silent_rows(patches, settings))


def silent_rows(patches: Sequence[Patch], settings: GelRowSettings | None = None) -> Evidence:
    """OUTSIDE rows where skins felt nothing; the patches' frame."""
    settings = settings or GelRowSettings()
    parts = [tables.empty()]
    for patch in patches:
        if len(patch.silent):
            rows = tables.outside(patch.silent, settings.place_sigma, TOUCH, gate=settings.gate)
            parts.append(rows.reweighted(min(1.0, settings.silent / len(patch.silent))))
    return tables.stack(*parts)
