"""Arrays as rows of evidence: active taxels lie on the surface, inactive ones outside, and the pattern has a normal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenes.evidence import table as tables
from scenes.evidence.table import TOUCH, Evidence
from scenes.recordings.frames import Contacts
from touch.arrays.readings import Reading

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ArrayRowSettings:
    """What rows of arrays are worth. Values by judgement."""

    # Error of a taxel's place (m): the finger's joints, which all taxels of an array share.
    place_sigma: float = 0.001
    # Error of the indentation's scale, as a share of it.
    gain: float = 0.15
    # Sigmas of the normal (rad): the finger's joints, and half a pitch of the pattern's middle over a fingertip's bend.
    normal_sigma: float = float(np.deg2rad(4.0))
    # The same (rad) where a single taxel feels something: an edge of the object may press it as well as a face. By
    # judgement, as two frames of another generator have it.
    lone_sigma: float = float(np.deg2rad(20.0))
    # All taxels of one array that feel something count like this many independent contacts: they share the finger's
    # error, but each lies elsewhere on the surface. Those that feel nothing count like so many, too.
    shared: float = 2.0
    silent: float = 2.0
    # A taxel is as likely a broken one at this many sigmas.
    gate: float = 5.0


def array_contacts(readings: Sequence[Reading], settings: ArrayRowSettings | None = None) -> Contacts:
    """One contact for each array that feels something: the pressure-weighted middle of the pressed surface and its
    pressure-weighted normal, out of the object. Readings' frame.
    """
    settings = settings or ArrayRowSettings()
    points, normals, names, forces, turns = [], [], [], [], []
    for reading in readings:
        if not reading.active.any():
            continue
        weight = np.where(reading.active, reading.pressure, 0.0)
        middle = weight @ reading.surface_points / weight.sum()
        # the finger's outward normal looks into the object: the object's looks back
        normal = -(weight @ reading.taxels[:, 3:])
        length = float(np.linalg.norm(normal))
        points.append(middle)
        normals.append(normal / length if length > 1e-9 * weight.sum() else np.full(3, np.nan))
        forces.append(normal * reading.pitch**2)
        names.append(reading.sensor)
        turns.append(settings.normal_sigma if reading.active.sum() > 1 else settings.lone_sigma)
    if not points:
        return Contacts.none()
    places = np.full(len(points), settings.place_sigma)
    return Contacts(points, np.array(normals), places, np.array(turns), names, np.array(forces))


def array_rows(readings: Sequence[Reading], settings: ArrayRowSettings | None = None) -> Evidence:
    """The rows of `array_contacts` first, then those of `taxel_rows`."""
    settings = settings or ArrayRowSettings()
    first = tables.from_contacts(array_contacts(readings, settings), settings.gate)
    return tables.stack(first, taxel_rows(readings, settings))


def taxel_rows(readings: Sequence[Reading], settings: ArrayRowSettings | None = None) -> Evidence:
    """ON rows where active taxels were pressed in, OUTSIDE rows at those that felt nothing; readings' frame."""
    settings = settings or ArrayRowSettings()
    parts = [tables.empty()]
    for reading in readings:
        active = reading.active
        # a single one is the array's contact, and says nothing beside it
        if active.sum() > 1:
            parts.append(
                tables.make(
                    reading.surface_points[active],
                    np.hypot(settings.place_sigma, settings.gain * reading.indentation[active]),
                    TOUCH,
                    weight=min(settings.shared, active.sum() - 1.0) / active.sum(),
                    gate_above=settings.gate,
                    gate_below=settings.gate,
                )
            )
        silent = reading.silent
        if silent.any():
            rows = tables.outside(reading.taxels[silent, :3], settings.place_sigma, TOUCH, gate=settings.gate)
            parts.append(rows.reweighted(min(1.0, settings.silent / int(silent.sum()))))
    return tables.stack(*parts)
