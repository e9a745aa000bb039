"""Answers to frames whose truth is known, as the regression of the confidence reads them, in a file of JSON lines.

A frame is made by its family, or read where an earlier run kept it as a capture. Answers that the file has are not made
again, so that a run that was stopped goes on and one of more trials adds to it.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import MISSING, asdict, dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fusion.benchmarks.families.making import frames_of, judge_of, objects_of
from fusion.benchmarks.families.table import FAMILIES, TUNING, Family
from fusion.benchmarks.printing.provenance import source_version
from fusion.benchmarks.printing.tables import own_seed
from fusion.estimation.posterior.confidence import FEATURES
from fusion.estimation.posterior.spread import mean_square
from fusion.truth.errors import json_number
from scenes.errors import InputError

if TYPE_CHECKING:
    from scenes.recordings.frames import Frame

# Senses that answer, by name. "few": both, of a frame as most hands would record it (`told_little`).
FEW = "few"
SENSES = {"fused": ("vision", "touch"), FEW: ("vision", "touch"), "vision": ("vision",), "touch": ("touch",)}
# Of such a frame: most contacts, errors (m, 1 sigma) that each gets beside its own, and how often (shares) it is said
# how sharp they are, and what the hand looks like.
MOST_FELT, BLUNTER = 3, (0.0, 0.001, 0.003)
SHARPNESS_TOLD, HAND_TOLD = 0.5, 0.5
# A place of a frame: family, hidden share, object, trial, seed.
Place = tuple[str, float, str, int, int]


@dataclass(frozen=True)
class Told:
    """One answer. add_s: its error (m); rest_ok: every rule of the verdict but the confidence says `ok`; seen: there is
    a picture; mean, variance: of the mean square of how far the surface is off, as its covariance has it (m^2, m^4);
    features: by name, 0 where one does not apply; version: of the code that answered. sense "none": such a frame cannot
    be made, and nothing else is told.
    """

    family: str
    level: float
    object: str
    trial: int
    seed: int
    sense: str
    start: bool = True
    add_s: float = math.nan
    rest_ok: bool = False
    seen: bool = False
    mean: float = math.nan
    variance: float = math.nan
    features: dict[str, float] | None = None
    version: str = ""

    @property
    def place(self) -> Place:
        """Which frame it answers."""
        return self.family, self.level, self.object, self.trial, self.seed

    @property
    def method(self) -> str:
        """Its senses, and whether there was a start."""
        return f"{self.sense}, {'a' if self.start else 'no'} start"

    def values(self, names: Sequence[str]) -> list[float]:
        """Features in that order. Raises InputError for one that was not there when the answer was made."""
        told = self.features or {}
        for name in names:
            if name not in told:
                raise InputError(
                    f"{self.family} {self.object} {self.level:g}, {self.method}: expected the feature {name!r}, got an"
                    f" answer made without it ({self.version}): make the answers anew"
                )
        return [told[name] for name in names]


@dataclass(frozen=True)
class Work:
    """One frame to answer. asked: (sense, start) of each answer; captures: folder that keeps frames, None for none."""

    family: Family
    level: float
    name: str
    trial: int
    seed: int
    asked: tuple[tuple[str, bool], ...]
    captures: Path | None = None

    @property
    def place(self) -> Place:
        """Which frame it is."""
        return self.family.name, self.level, self.name, self.trial, self.seed


def tuned_on(families: Iterable[Family]) -> tuple[Family, ...]:
    """The families. Raises InputError for one that is only reported: nothing is fitted to it."""
    found = tuple(families)
    for family in found:
        if family.role != TUNING:
            allowed = ", ".join(one.name for one in FAMILIES.values() if one.role == TUNING)
            raise InputError(f"--family: expected tuning families ({allowed}), got {family.name!r}, only reported")
    return found


def answered(work: Work) -> list[Told]:
    """The frame's answers; one of sense "none" when it cannot be made."""
    from fusion.estimation.estimate import estimate
    from fusion.estimation.settings import EstimateSettings

    frame, version = frame_of(work), source_version()
    if frame is None:
        return [Told(*work.place, sense="none", version=version)]
    judge = judge_of(work.name, work.family.mesh_error)
    # how sure is sure enough is for whoever reads the answers
    usual = EstimateSettings()
    settings = replace(usual, confidence=replace(usual.confidence, sure=0.0))
    out = []
    for sense, start in work.asked:
        if sense in ("touch", FEW) and not len(frame.contacts):
            continue
        given = frame if start else replace(frame, prior=None)
        if sense == FEW:
            # the same contacts with a start and without
            given = told_little(given, np.random.default_rng(own_seed(work.seed, *work.place[:-1])))
        answer = estimate(given, judge.model, use=SENSES[sense], settings=settings)
        if not answer.observed:
            continue  # nothing was sensed
        assert frame.camera_from_object_truth is not None
        out.append(
            Told(
                *work.place,
                sense,
                start,
                judge.errors(answer.pose, frame.camera_from_object_truth).add_s,
                answer.verdict == "ok",
                "agree" in answer.observed,
                *mean_square(judge.model, answer.pose, answer.modes[0].covariance),
                {feature.name: answer.observed.get(feature.name, 0.0) for feature in FEATURES},
                version,
            )
        )
    return out


def told_little(frame: Frame, rng: np.random.Generator) -> Frame:
    """The frame with no more than a few of its contacts, which may be blunter and of unknown sharpness, and maybe
    without a model of the hand: families have hands that feel with every finger and say how well.
    """
    from scenes.recordings.frames import Contacts

    felt = frame.contacts
    some = rng.choice(len(felt), min(int(rng.integers(1, MOST_FELT + 1)), len(felt)), replace=False)
    blunter = float(rng.choice(BLUNTER))
    points = felt.points[some] + rng.normal(0.0, 1.0, (len(some), 3)) * blunter
    sigmas = np.hypot(felt.sigma_point[some], blunter) if rng.random() < SHARPNESS_TOLD else None
    hand = frame.hand if rng.random() < HAND_TOLD else None
    sensors = [felt.sensors[k] for k in some]
    return replace(frame, contacts=Contacts(points, None, sigmas, sensors=sensors), no_contact=None, hand=hand)


def frame_of(work: Work) -> Frame | None:
    """The frame, from its capture when it was kept before; None when it cannot be made."""
    from scenes.recordings.captures import read_capture
    from scenes.recordings.writing import write_capture

    home = None
    if work.captures is not None:
        name = re.sub(r"[^\w.]+", "-", f"{work.name}-{work.trial}-{work.seed}")
        home = work.captures / work.family.name / f"{work.level:g}" / name
        if (home / "capture.json").is_file():
            return read_capture(home)[0]
    made = list(frames_of(work.family, work.level, work.trial + 1, work.seed, (work.name,), work.trial))
    if not made:
        return None
    if home is None:
        return made[0].frame
    # answered as it is kept, or a second run would answer another frame
    frame = replace(made[0].frame, index=0)
    home.parent.mkdir(parents=True, exist_ok=True)
    world = "camera" if np.allclose(frame.camera_from_world, np.eye(4)) else "robot base"
    write_capture(home, [frame], made[0].model, frame.hand, world, with_mask=frame.mask is not None)
    return read_capture(home)[0]


def works_of(
    families: Sequence[Family],
    levels: Sequence[float] | None,
    objects: Sequence[str] | None,
    trials: int,
    seed: int,
    methods: Sequence[tuple[str, bool]],
    captures: Path | None = None,
    known: Iterable[Told] = (),
) -> list[Work]:
    """Every frame that is asked for and has not all the answers that are asked for.

    levels, objects: only these of the families' own, None for all; known: answers that there are. Answers to a frame
    are of one run: where one is missing the frame is answered by all that it lacks.
    """
    there: dict[Place, set[tuple[str, bool]]] = {}
    for told in known:
        there.setdefault(told.place, set()).add((told.sense, told.start))
    out = []
    for family in families:
        for level in family.levels:
            if levels is not None and not any(math.isclose(level, one, abs_tol=1e-6) for one in levels):
                continue
            for name in objects_of(family, None if objects is None else tuple(objects)):
                for trial in range(trials):
                    work = Work(family, level, name, trial, seed, tuple(methods), captures)
                    had = there.get(work.place, set())
                    lacks = tuple(m for m in methods if m not in had and (m[0] not in ("touch", FEW) or family.touch))
                    if lacks and ("none", True) not in had:
                        out.append(replace(work, asked=lacks))
    return out


def write_line(told: Told) -> str:
    """Its line of the file."""
    return json.dumps(json_number(asdict(told)), allow_nan=False) + "\n"


def read_answers(path: Path) -> list[Told]:
    """The file's answers; a last line that a stopped run left half written is none.

    Raises InputError naming file and line for what is no answer.
    """
    try:
        lines = path.read_text(encoding="utf-8").split("\n")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: expected a file of answers, got {error}") from error
    needed = {field.name for field in fields(Told) if field.default is MISSING}
    names = {field.name for field in fields(Told)}
    out = []
    for number, line in enumerate(lines[:-1], 1):
        try:
            content = json.loads(line)
        except json.JSONDecodeError:
            content = None
        there = set(content) if isinstance(content, dict) else set()
        if not needed <= there <= names or content["family"] not in FAMILIES:
            raise InputError(f"{path}, line {number}: expected an answer of fit-confidence, got {line[:60]!r}")
        numbers = {key: math.nan for key in ("add_s", "mean", "variance") if content.get(key) is None}
        out.append(Told(**{**content, **numbers}))
    return out


def mend(path: Path) -> None:
    """Cut off a last line that a stopped run left half written, so that new lines begin where lines do."""
    content = path.read_bytes()
    whole = content[: content.rfind(b"\n") + 1]
    if whole != content:
        path.write_bytes(whole)
