"""Sequences of an object by several motions, each made once and followed by every method; one process a cell."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fusion.benchmarks.families.table import FAMILIES
from fusion.benchmarks.printing.one_thread import one_thread
from fusion.benchmarks.printing.tables import own_seed
from fusion.benchmarks.tracking.sequences import OCCLUSION, recorded
from fusion.benchmarks.tracking.tally import Tally, follow
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Frame
from scenes.synthesis.grasping.hiding import Placement


@dataclass(frozen=True)
class Cell:
    """One object held by one grasp in every motion, each with a camera's and a robot's errors of its own.

    family: its name; number: of the trial; seed: of the benchmark; folder: where captures are kept, None keeps none.
    """

    family: str
    name: str
    number: int
    motions: tuple[str, ...]
    frames: int
    methods: tuple[str, ...]
    seed: int
    folder: Path | None

    @property
    def key(self) -> tuple[str, str, int]:
        """Tells it from all others."""
        return self.family, self.name, self.number


@dataclass(frozen=True)
class Followed:
    """A sequence of a cell: what each method did; None where no grasp hides the object by as much as is asked."""

    key: tuple[str, str, int]
    motion: str
    tallies: dict[str, Tally] | None


def follow_cell(cell: Cell) -> list[Followed]:
    """Every sequence of a cell, followed by every method."""
    out = []
    for motion in cell.motions:
        made = sequence_of(cell, motion)
        tallies = None
        if made is not None:
            tallies = {method: Tally() for method in cell.methods}
            for method, tally in tallies.items():
                follow(tally, method, *made, cell.seed)
        out.append(Followed(cell.key, motion, tallies))
    return out


def follow_alone(cell: Cell) -> tuple[str, Tally]:
    """The cell's first motion, and its sequence followed by the track, with one thread and nothing beside it: what a
    frame takes. Other cells are followed side by side, and share cores, caches and memory. Empty where there is none.
    """
    motion, tally = cell.motions[0], Tally()
    made = sequence_of(cell, motion)
    if made is not None:
        with one_thread():
            follow(tally, "track", *made, cell.seed)
    return motion, tally


def sequence_of(cell: Cell, motion: str) -> tuple[ObjectModel, list[Frame], dict[str, Any]] | None:
    """A sequence of a cell; None where no grasp hides the object by as much as is asked."""
    family, seed = FAMILIES[cell.family], own_seed(cell.seed, *cell.key, motion)
    hidden, placement = min(OCCLUSION, max(family.levels)), Placement(own_seed(cell.seed, *cell.key))
    return recorded(cell.name, motion, cell.frames, seed, cell.folder, hidden, family=family, placement=placement)
