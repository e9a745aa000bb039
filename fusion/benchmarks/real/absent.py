"""Recorded frames asked for what they do not show: an answer that is `ok` there is wrong, whatever its pose.

Each frame's mask is of one object; it is asked for the others of the same recordings instead, within the mask, with a
start where the real object stands and without one. Nothing here is simulated, and nothing but the verdict is judged:
no pose is right. Objects are told apart by name, so one thing that was recorded twice is not asked of itself.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fusion.benchmarks.printing.tables import BenchSettings, Claim, Column, Quantile, Rate, Report, Table, own_seed
from fusion.benchmarks.real.frames import Recorded, even
from fusion.estimation.estimate import estimate
from scenes.geometry import poses
from scenes.geometry.objects import ObjectModel

Array = NDArray[np.float64]

# Other objects that a frame is asked for, at most, evenly picked; in a hurry. The recordings at hand have six.
OTHERS, QUICK_OTHERS = 6, 1
# Of answers to what is not there, how many may be `ok`: what `ok` allows is one in twenty at 95 %, and one in a hundred
# is asked of wrong answers elsewhere.
ASKED = 0.01


@dataclass(frozen=True)
class AbsentTrial:
    """One frame asked for one object that its mask does not show.

    frame, model: names; start: whether one was given; confidence (0 to 1) and verdict of the answer; time (ms) by the
    clock; similar: the diameter of what is asked for over that of what the mask shows.
    """

    frame: str
    model: str
    start: bool
    verdict: str
    confidence: float
    time_ms: float
    similar: float

    @property
    def sure(self) -> bool:
        """Said to be right."""
        return self.verdict == "ok"


def others_of(one: Recorded, ones: Sequence[Recorded], most: int) -> list[ObjectModel]:
    """Models of the recordings that go by another name than the frame's own, each once, at most `most`."""
    named = {other.model.name: other.model for other in ones if other.model.name != one.model.name}
    return even(list(named.values()), most) if named else []


def absent_trials(one: Recorded, ones: Sequence[Recorded], most: int, seed: int) -> Iterator[AbsentTrial]:
    """One frame, every other object, with a start (where there is a reference pose) and without."""
    for model in others_of(one, ones, most):
        for pose in (None, in_its_place(one, model)) if one.reference is not None else (None,):
            answer = estimate(
                replace(one.frame, prior=None),
                model,
                prior=pose,
                use=("vision",),
                seed=own_seed(seed, one.name, model.name, int(pose is not None)),
            )
            yield AbsentTrial(
                one.name,
                model.name,
                pose is not None,
                answer.verdict,
                float(answer.confidence),
                float(sum(stage.ms for stage in answer.trace)),
                float(model.diameter / one.model.diameter),
            )


def in_its_place(one: Recorded, model: ObjectModel) -> Array:
    """camera_from_object (4, 4) of `model`, its middle and axes where the reference pose has the real object's."""
    assert one.reference is not None
    pose = one.reference.copy()
    middle = poses.apply(one.reference, one.model.centroid[None])[0]
    pose[:3, 3] = middle - pose[:3, :3] @ model.centroid
    return pose


def look_for_others(report: Report, ones: list[Recorded], settings: BenchSettings) -> None:
    """The table, and the claim that what is not there is not found."""
    most = QUICK_OTHERS if settings.quick else OTHERS
    found: list[AbsentTrial] = []
    for one in settings.progress(ones, len(ones), "frames asked for what they do not show"):
        found += absent_trials(one, ones, most, settings.seed)
    if not found:
        return
    report.tables.append(_table(found))
    settings.show(report.tables[-1])
    share = float(np.mean([t.sure for t in found]))
    report.claims.append(Claim("what is not there: ok", share, ASKED, False))


def _table(found: list[AbsentTrial]) -> Table:
    columns = [Column("start"), Column("tries", 0), Column("ok / ambiguous / lost"), Column("ok")]
    columns += [Column("confidence"), Column("highest"), Column("of"), Column("ms", 0)]
    table = Table("Recorded frames asked for what they do not show", columns)
    for start in (False, True):
        here = [t for t in found if t.start == start]
        if not here:
            continue
        worst = max(here, key=lambda t: t.confidence)
        table.add(
            "in its place" if start else "none",
            len(here),
            " / ".join(str(sum(t.verdict == word for t in here)) for word in ("ok", "ambiguous", "lost")),
            Rate.of([t.sure for t in here]),
            Quantile.of([t.confidence for t in here]),
            worst.confidence,
            f"{worst.model} in {worst.frame}, {worst.similar:.2f} as large",
            Quantile.of([t.time_ms for t in here]),
        )
    table.note = (
        "Each frame, with the mask of its own object, asked for the other recorded objects, by vision; in its place:"
        " the start has the other's middle and axes where the real one's are. Every `ok` is wrong. Highest: the most"
        " that is stated, and of what."
    )
    return table
