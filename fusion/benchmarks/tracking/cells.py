"""Sequences of an object by several motions, each made once and followed by every method; one process a cell."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from fusion.benchmarks.families.table import FAMILIES
from fusion.benchmarks.printing.tables import own_seed
from fusion.benchmarks.tracking.sequences import OCCLUSION, recorded
from fusion.benchmarks.tracking.tally import Tally, follow
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
    family = FAMILIES[cell.family]
    hidden, placement = min(OCCLUSION, max(family.levels)), Placement(own_seed(cell.seed, *cell.key))
    out = []
    for motion in cell.motions:
        seed = own_seed(cell.seed, *cell.key, motion)
        made = recorded(cell.name, motion, cell.frames, seed, cell.folder, hidden, family=family, placement=placement)
        tallies = None
        if made is not None:
            tallies = {method: Tally() for method in cell.methods}
            for method, tally in tallies.items():
                follow(tally, method, *made, cell.seed)
        out.append(Followed(cell.key, motion, tallies))
    return out
