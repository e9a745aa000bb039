"""Slips in the hand, told by a track with taxel arrays and by the same track without: sequences of
scenes.synthesis.motion, an object carried and slipping, pads of 3 x 8 taxels on five fingertips beside a depth camera
and contacts.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from fusion.benchmarks.printing.tables import BenchSettings, Report
from fusion.benchmarks.tracking.slips import SlipBench, add_slip_table
from fusion.benchmarks.tracking.tally import SLIP_DELAY

if TYPE_CHECKING:
    from scenes.recordings.frames import Frame

# Asymmetric ones and bodies of revolution.
OBJECTS = ("drill", "mug", "bottle", "hammer")
FRAMES = 45


def add_slips(report: Report, settings: BenchSettings) -> None:
    """The table: slips said in time and false alarms, by motion and method."""
    add_slip_table(report, settings, slip_bench(settings))


def slip_bench(settings: BenchSettings) -> SlipBench:
    """What is counted: pads with patterns of pressure."""
    return SlipBench(
        name="arrays",
        folder="arrays",
        title="Slips in the hand (fingertip pads of 24 taxels, lab noise)",
        note=f"{len(OBJECTS)} objects, {FRAMES} frames at 30 a second; a slip lasts 6 frames. In time: up to"
        f" {SLIP_DELAY} frames after its end; slips about an axis of symmetry, and below 1.5° and 1 mm, are not"
        " counted. False alarms: beginnings of an alarm in a frame in which nothing slips. Limits were chosen on"
        " other seeds.",
        objects=OBJECTS[:1] if settings.quick else OBJECTS,
        trials=settings.count(8, 1),
        frames=FRAMES,
        touch=("point", "array"),
        alone=_patterns_alone,
        without=lambda frame: replace(frame, tactile={}),
        words="patterns",
        more={"taxels": "pad"},
    )


def _patterns_alone(frames: list[Frame]) -> list[bool]:
    from touch.arrays.readings import readings_of
    from touch.arrays.slip import PatternWatch

    watch = PatternWatch()
    return [watch.step(readings_of(frame)).slipped for frame in frames]
