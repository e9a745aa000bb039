"""How time and memory grow with rows, contacts, poses, faces, image size and threads.

Each size is run a few times after one that compiles; the quickest counts, since whatever else a machine does only adds.
Images are seen from where the object fills them alike.
Memory is the peak of what Python and NumPy allocate during one more run. The exponent is that of time between a size
and the one before it: 1 is proportional.
"""

from __future__ import annotations

import math
import os
import time
import tracemalloc
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion.benchmarks.printing.charts import Chart
from fusion.benchmarks.printing.tables import BenchSettings, Claim, Column, Report, Table
from scenes.evidence.align import AlignSettings, align
from scenes.evidence.table import VISION, make
from scenes.geometry import poses as se3
from scenes.geometry.distance_field import FieldSettings, build
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Contacts, Frame
from scenes.synthesis import library
from scenes.threads import VARIABLE
from touch.localization import localize

Array = NDArray[np.float64]
Work = Callable[[], object]

MODEL = "drill"
# Steps of every alignment here: none ends early, so that sizes are compared at the same work.
STEPS = AlignSettings(iterations=10, tolerance_angle=0.0, tolerance_distance=0.0)
# A run that takes longer than this (s) is measured once.
LONG = 2.0
# Processor seconds that localize may take of so many contacts.
ASKED = {1e4: 1.0, 1e6: 10.0}
# Growth that is still called proportional.
PROPORTIONAL = 1.2


@dataclass(frozen=True)
class Measured:
    """Wall and processor time (ms) and peak of allocations (MB) at one size."""

    size: float
    wall: float
    cpu: float
    memory: float


def run(settings: BenchSettings) -> Report:
    """One table for each thing that grows, and the curves of time and of memory."""
    repeats = settings.count(5, quick=1)
    report = Report("scaling", "Time and memory against size", f"quickest of {repeats}", settings.seed)
    quick = settings.quick
    curves: dict[str, list[Measured]] = {}
    parts: list[tuple[str, str, Sequence[float], Callable[[float], Work], bool]] = [
        ("Rows of an alignment of 8 poses", "rows", _powers(1, 4 if quick else 6), _rows, True),
        ("Poses aligned to 10 rows", "poses", _powers(1, 3 if quick else 6), _poses, True),
        ("Contacts of localize", "contacts", _powers(1, 4 if quick else 6), _contacts, False),
        ("Faces of a new object's lattice", "faces", _spheres()[1:4] if quick else _spheres(), _faces, False),
        ("Pixels of an estimate by vision", "pixels", _images(quick), _image, False),
    ]
    for title, unit, sizes, make_work, claimed in parts:
        found = [measure(size, make_work(size), repeats) for size in settings.progress(sizes, len(sizes), unit)]
        curves[unit] = found
        _add(report, title, unit, found)
        if claimed:
            exponent = growth(found[-2], found[-1])
            report.claims.append(Claim(f"{title}: exponent at the largest", exponent, PROPORTIONAL, False))
        for one in found:
            if unit == "contacts" and one.size in ASKED:
                report.claims.append(
                    Claim(f"{one.size:.0e} contacts: processor s", 1e-3 * one.cpu, ASKED[one.size], False)
                )
        settings.show(report.tables[-1])
    _threads(report, repeats, settings)
    for quantity, value in (("processor ms", "cpu"), ("MB", "memory")):
        series = {unit: [(one.size, getattr(one, value)) for one in found] for unit, found in curves.items()}
        what = "Memory" if quantity == "MB" else "Time"
        report.charts.append(Chart(f"{what} against size", "how many", quantity, series, log_x=True, log_y=True))
    return report


def measure(size: float, work: Work, repeats: int) -> Measured:
    """The quickest of several runs after a first one (of one where they are long), then the memory of one more."""
    begin = time.perf_counter()
    work()
    wall, cpu = math.inf, math.inf
    for _ in range(repeats if time.perf_counter() - begin < LONG else 1):
        begin, used = time.perf_counter(), time.process_time()
        work()
        wall, cpu = min(wall, time.perf_counter() - begin), min(cpu, time.process_time() - used)
    tracemalloc.start()
    try:
        work()
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    return Measured(size, 1e3 * wall, 1e3 * cpu, peak / 1e6)


def growth(smaller: Measured, larger: Measured) -> float:
    """Exponent of the processor's time between two sizes."""
    return math.log(max(larger.cpu, 1e-6) / max(smaller.cpu, 1e-6)) / math.log(larger.size / smaller.size)


def _powers(low: int, high: int) -> list[float]:
    return [10.0**power for power in range(low, high + 1)]


def _spheres() -> list[float]:
    return [20.0 * 4**level for level in range(1, 9)]


def _images(quick: bool) -> list[float]:
    widths = (160, 320, 640) if quick else (160, 320, 640, 1280, 2560)
    return [width * width * 0.75 for width in widths]


def _starts(model: ObjectModel, count: int) -> Array:
    rng = np.random.default_rng(0)
    delta = rng.normal(size=(count, 6)) * ([0.2] * 3 + [0.01] * 3)
    return se3.perturb(np.eye(4), delta, model.centroid)


def _rows(size: float) -> Work:
    model = library.make(MODEL)
    rows = make(model.sample_surface(int(size), seed=0)[0], 1e-3, VISION)
    starts = _starts(model, 8)
    return lambda: align(model, rows, starts, settings=STEPS)


def _poses(size: float) -> Work:
    model = library.make(MODEL)
    rows = make(model.sample_surface(10, seed=0)[0], 1e-3, VISION)
    starts = _starts(model, int(size))
    return lambda: align(model, rows, starts, settings=STEPS)


def _contacts(size: float) -> Work:
    model = library.make(MODEL)
    contacts = Contacts(*model.sample_surface(int(size), seed=0), 1e-3, 0.1)
    return lambda: localize(model, contacts, seed=0)


def _faces(size: float) -> Work:
    import trimesh

    level = round(math.log(size / 20, 4))
    ball = trimesh.creation.icosphere(subdivisions=level, radius=0.05)
    vertices, faces = np.array(ball.vertices) * [1.0, 0.8, 0.6], np.array(ball.faces, dtype=np.int64)
    return lambda: build(vertices, faces, FieldSettings())


def _image(size: float, start: bool = True) -> Work:
    from fusion.estimation.estimate import estimate
    from scenes.geometry.appearance.rendering import Renderer
    from scenes.geometry.cameras import Camera

    model = library.make(MODEL)
    width = round(math.sqrt(size / 0.75))
    height = width * 3 // 4
    focal = 0.9 * width
    camera = Camera(focal, focal, 0.5 * (width - 1), 0.5 * (height - 1), width, height)
    pose = se3.make_pose(se3.exp_rotation(np.array([2.0, 0.4, 0.3])), np.array([0.0, 0.0, 0.6]))
    depth = Renderer({"object": (model.vertices, model.faces)}).render(camera, {"object": pose}).depth
    near = se3.displaced(pose, 0.15, 0.01, model.centroid, np.random.default_rng(0))
    frame = Frame(0, camera=camera, depth=depth, prior=near if start else None)
    return lambda: estimate(frame, model, use=("vision",))


def _add(report: Report, title: str, unit: str, found: Sequence[Measured]) -> None:
    table = Table(
        title, [Column(unit, 0), Column("ms", 2), Column("cpu ms", 2), Column("MB", 2), Column("exponent", 2)]
    )
    for i, one in enumerate(found):
        table.add(one.size, one.wall, one.cpu, one.memory, growth(found[i - 1], one) if i else None)
    report.tables.append(table)


def _threads(report: Report, repeats: int, settings: BenchSettings) -> None:
    """An alignment of 2000 poses, a frame with and without a start, and many contacts, on 1, 2, 4, … threads, as far as
    there are cores.
    """
    model = library.make(MODEL)
    rows = make(model.sample_surface(100, seed=0)[0], 1e-3, VISION)
    starts = _starts(model, 500 if settings.quick else 2000)
    many = 1e4 if settings.quick else 1e5
    works: dict[str, Work] = {
        f"alignment of {len(starts)} poses": lambda: align(model, rows, starts, settings=STEPS),
        "estimate, start": _image(640 * 480),
        "estimate, no start": _image(640 * 480, start=False),
        "localize, 30 contacts": _contacts(30),
        f"localize, {many:.0e} contacts": _contacts(many),
    }
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    columns = [Column("work"), Column("threads", 0), Column("ms", 1), Column("cpu ms", 1), Column("times faster", 2)]
    table = Table("Threads", columns)
    for name, work in works.items():
        first = math.nan
        for count in (c for c in (1, 2, 4, 8, 16, 32, 64) if c <= cores):
            with _allowed(count):
                one = measure(count, work, repeats)
            first = one.wall if count == 1 else first
            table.add(name, count, one.wall, one.cpu, first / one.wall)
    table.note = f"{cores} cores"
    report.tables.append(table)
    settings.show(table)


@contextmanager
def _allowed(threads: int) -> Iterator[None]:
    """That many threads inside the block, by the package's one setting."""
    before: Any = os.environ.get(VARIABLE)
    os.environ[VARIABLE] = str(threads)
    try:
        yield
    finally:
        if before is None:
            del os.environ[VARIABLE]
        else:
            os.environ[VARIABLE] = before
