"""Slips in the hand, told by a track with a sensor of slip and by the same track without it: a table for any sensor."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from fusion.benchmarks.printing.tables import BenchSettings, Claim, Column, Rate, Report, Table, own_seed
from fusion.benchmarks.tracking.methods import Said
from fusion.benchmarks.tracking.sequences import recorded
from fusion.benchmarks.tracking.tally import Tally, count_slips

if TYPE_CHECKING:
    from scenes.geometry.objects import ObjectModel
    from scenes.recordings.frames import Frame

# An object is carried, or carried and slips.
MOTIONS = ("slip", "carry")
# The camera is a quarter as fine as the default: what is asked here is asked of touch.
SCALE = 0.25
OCCLUSION = 0.5


@dataclass(frozen=True)
class SlipBench:
    """A sensor whose slips are counted. name: of its draws and of the folder that keeps sequences; touch: what the hand
    feels with, and more of what `recorded` takes; frames: of a sequence, at 30 a second.

    alone (frames) -> whether each slips by the sensor's own word; without (frame) -> the frame without the sensor.
    """

    name: str
    folder: str
    title: str
    note: str
    objects: tuple[str, ...]
    trials: int
    frames: int
    touch: tuple[str, ...]
    alone: Callable[[list[Frame]], list[bool]]
    without: Callable[[Frame], Frame]
    words: str
    more: dict[str, Any] = field(default_factory=dict)

    @property
    def methods(self) -> tuple[str, str, str]:
        """The sensor's own word, a track that does not have the sensor, and one that has; the last is what is asked."""
        return f"{self.words} alone", f"track without {self.name}", f"track with {self.name}"

    def said(self, method: str, model: ObjectModel, frames: list[Frame]) -> list[Said]:
        """What a method says of each frame."""
        from fusion.tracking.tracker import Tracker

        own, bare, _ = self.methods
        if method == own:
            return [Said(np.eye(4), slip=word, moved=word) for word in self.alone(frames)]
        tracker = Tracker(model)
        answers = [tracker.step(self.without(frame) if method == bare else frame) for frame in frames]
        return [Said(a.pose, slip=a.slip, moved=a.moved_in_hand) for a in answers]


def add_slip_table(report: Report, settings: BenchSettings, bench: SlipBench) -> None:
    """The table: slips said in time and false alarms, by motion and method; and what is asked of the track."""
    from scenes.synthesis.recording import SynthesisSettings

    columns = [Column("motion"), Column("method"), Column("sequences", 0), Column("slips", 0), Column("said in time")]
    columns += [Column("false alarms", 0), Column("as moved_in_hand"), Column("its false alarms", 0)]
    columns += [Column("steady frames", 0)]
    table = Table(bench.title, columns)
    table.note = bench.note
    ours = Tally()
    folder = settings.folder / bench.folder if settings.folder is not None else None
    coarse = SynthesisSettings(camera=SynthesisSettings().camera.scaled(SCALE), rgb=False)
    for motion in MOTIONS:
        tallies, made = {method: Tally() for method in bench.methods}, 0
        cells = [(name, trial) for name in bench.objects for trial in range(bench.trials)]
        for name, trial in settings.progress(cells, len(cells), f"slips: {motion}"):
            seed = own_seed(settings.seed, bench.name, motion, name, trial)
            sequence = recorded(
                name, motion, bench.frames, seed, folder, OCCLUSION, coarse, touch=bench.touch, **bench.more
            )
            if sequence is None:
                continue
            made += 1
            model, frames, notes = sequence
            for method, tally in tallies.items():
                count_slips(tally, model, frames, bench.said(method, model, frames), notes)
        for method, tally in tallies.items():
            rates = [Rate(tally.hits, tally.slips), Rate(tally.moved_hits, tally.slips)]
            table.add(
                motion, method, made, tally.slips, rates[0], tally.alarms, rates[1], tally.moved_alarms, tally.steady
            )
        for word in ("slips", "hits", "alarms", "steady"):
            setattr(ours, word, getattr(ours, word) + getattr(tallies[bench.methods[-1]], word))
    report.tables.append(table)
    settings.show(table)
    if ours.slips:
        share, wrong = 100 * ours.hits / ours.slips, 1000 * ours.alarms / max(ours.steady, 1)
        report.claims.append(Claim(f"slips said in time by a {bench.methods[-1]}, %", share, 90.0, True, 0))
        report.claims.append(Claim("its false alarms in 1000 steady frames", wrong, 1.0, False, 1))
