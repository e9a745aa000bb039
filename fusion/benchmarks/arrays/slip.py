"""Slips in the hand, told by a track with taxel arrays and by the same track without: sequences of
scenes.synthesis.motion, an object carried and slipping, pads of 3 x 8 taxels on five fingertips beside a depth camera
and contacts.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fusion.benchmarks.printing.tables import BenchSettings, Claim, Column, Rate, Report, Table, own_seed
from fusion.benchmarks.tracking.methods import Said
from fusion.benchmarks.tracking.sequences import recorded
from fusion.benchmarks.tracking.tally import SLIP_DELAY, Tally, count_slips

if TYPE_CHECKING:
    from scenes.geometry.objects import ObjectModel
    from scenes.recordings.frames import Frame

Array = NDArray[np.float64]

# Asymmetric ones and bodies of revolution.
OBJECTS = ("drill", "mug", "bottle", "hammer")
MOTIONS = ("slip", "carry")
FRAMES = 45
# The camera is a quarter as fine as the default: what is asked here is asked of touch.
SCALE = 0.25
OCCLUSION = 0.5
TOUCH = ("point", "array")
# Method -> the frame it gets, and whether the poses of a track or the patterns alone answer.
METHODS = ("patterns alone", "track without arrays", "track with arrays")


def add_slips(report: Report, settings: BenchSettings) -> None:
    """The table: slips said in time and false alarms, by motion and method."""
    from scenes.synthesis.recording import SynthesisSettings

    columns = [Column("motion"), Column("method"), Column("sequences", 0), Column("slips", 0), Column("said in time")]
    columns += [Column("false alarms", 0), Column("as moved_in_hand"), Column("its false alarms", 0)]
    columns += [Column("steady frames", 0)]
    table = Table("Slips in the hand (fingertip pads of 24 taxels, lab noise)", columns)
    table.note = (
        f"{len(OBJECTS)} objects, {FRAMES} frames at 30 a second; a slip lasts 6 frames. In time: up to {SLIP_DELAY}"
        " frames after its end; slips about an axis of symmetry, and below 1.5° and 1 mm, are not counted. False"
        " alarms: beginnings of an alarm in a frame in which nothing slips. Limits were chosen on other seeds."
    )
    trials = settings.count(8, 1)
    objects = OBJECTS[:1] if settings.quick else OBJECTS
    totals = {method: Tally() for method in METHODS}
    folder = settings.folder / "arrays" if settings.folder is not None else None
    coarse = SynthesisSettings(camera=SynthesisSettings().camera.scaled(SCALE), rgb=False)
    for motion in MOTIONS:
        tallies, made = {method: Tally() for method in METHODS}, 0
        cells = [(name, trial) for name in objects for trial in range(trials)]
        for name, trial in settings.progress(cells, len(cells), f"slips: {motion}"):
            seed = own_seed(settings.seed, "arrays", motion, name, trial)
            sequence = recorded(name, motion, FRAMES, seed, folder, OCCLUSION, coarse, touch=TOUCH, taxels="pad")
            if sequence is None:
                continue
            made += 1
            model, frames, notes = sequence
            for method, tally in tallies.items():
                count_slips(tally, model, frames, _said(method, model, frames), notes)
        for method, tally in tallies.items():
            rates = [Rate(tally.hits, tally.slips), Rate(tally.moved_hits, tally.slips)]
            table.add(
                motion, method, made, tally.slips, rates[0], tally.alarms, rates[1], tally.moved_alarms, tally.steady
            )
            for word in ("slips", "hits", "alarms", "steady"):
                setattr(totals[method], word, getattr(totals[method], word) + getattr(tally, word))
    report.tables.append(table)
    settings.show(table)
    ours = totals["track with arrays"]
    if ours.slips:
        report.claims += [
            Claim("slips said in time by a track with arrays, %", 100 * ours.hits / ours.slips, 90.0, True, 0),
            Claim("its false alarms in 1000 steady frames", 1000 * ours.alarms / max(ours.steady, 1), 1.0, False, 1),
        ]


def _said(method: str, model: ObjectModel, frames: list[Frame]) -> list[Said]:
    """What a method says of each frame."""
    from fusion.tracking.tracker import Tracker
    from touch.arrays.readings import readings_of
    from touch.arrays.slip import PatternWatch

    if method == "patterns alone":
        watch = PatternWatch()
        words = [watch.step(readings_of(frame)).slipped for frame in frames]
        return [Said(np.eye(4), slip=word, moved=word) for word in words]
    tracker = Tracker(model)
    answers = [tracker.step(frame if method == "track with arrays" else replace(frame, tactile={})) for frame in frames]
    return [Said(a.pose, slip=a.slip, moved=a.moved_in_hand) for a in answers]
