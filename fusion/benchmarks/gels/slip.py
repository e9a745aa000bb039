"""Slip told by gels: presses that slide over an object or hold still under a changing force, and tracks of hands whose
object is carried or slips.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fusion.benchmarks.gels.presses import calibrated_digit, place
from fusion.benchmarks.printing.tables import BenchSettings, Claim, Column, Quantile, Rate, Report, Table, own_seed
from fusion.benchmarks.tracking.slips import SlipBench, add_slip_table
from fusion.benchmarks.tracking.tally import SLIP_DELAY
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.synthesis import library
from scenes.synthesis.gels import bridged, pressed_by, see
from touch.gels.patches import PatchSettings, patch_of
from touch.gels.skin.heights import from_depth, indentation_of
from touch.gels.slip import PatchSlipSettings, PatchWatch, in_palm, patch_motion

if TYPE_CHECKING:
    from scenes.recordings.frames import Frame
    from scenes.robot.gels import Gel

Array = NDArray[np.float64]

OBJECTS = ("box", "l_block", "drill", "hammer", "mug")
# Frames of a press, when it begins to slide, for how many frames, and how far (m) in each.
FRAMES, BEGINS, LASTS, EACH = 14, 6, 5, 0.0003
# A force that changes: this much (m) in and out around the first depth, once in FRAMES.
BREATH = 0.00005
# Where a finger is said to be jitters by this much from frame to frame (m, rad).
JITTER = 0.00005, float(np.deg2rad(0.05))
# A slide shows when the true indentation moves over the skin by this share of it: along a plane or a cylinder nothing
# does.
SHOWS = 0.5
# Tracks: as the benchmark of arrays has them.
TRACKED, TRACK_FRAMES = ("drill", "hammer"), 24


def add_slides(report: Report, settings: BenchSettings) -> None:
    """Single presses, and what is asked of them."""
    table = Table(
        f"Slip: one press that slides {1e3 * EACH:g} mm a frame for {LASTS} frames, or holds still",
        [
            Column("object"),
            Column("slides", 0),
            Column("that show", 0),
            Column("of these said in time"),
            Column("of the others"),
            Column("frames until said", 1),
            Column("false alarms", 0),
            Column("still frames", 0),
            Column("ms a patch", 1),
        ],
    )
    table.note = (
        f"The force changes by {1e3 * BREATH:g} mm in and out. A slide shows when its true indentation moves over the"
        f" skin by half of it; along planes and cylinders none does. In time: up to {SLIP_DELAY} frames after its end."
    )
    trials = settings.count(12, 2)
    shown: list[bool] = []
    still, alarms = 0, 0
    names = settings.some(OBJECTS, 2)
    cells = [(name, trial) for name in names for trial in range(trials)]
    by: dict[str, list[tuple[bool, int | None, int, int, float]]] = {name: [] for name in names}
    for name, trial in settings.progress(cells, len(cells), "slides"):
        rng = np.random.default_rng(own_seed(settings.seed, "slide", name, trial))
        one = _slid(library.make(name), rng)
        if one is not None:
            by[name].append(one)
    for name, found in by.items():
        if not found:
            continue
        seen = [said is not None for shows, said, *_ in found if shows]
        other = [said is not None for shows, said, *_ in found if not shows]
        delay = [said for shows, said, *_ in found if shows and said is not None]
        wrong, quiet = sum(one[2] for one in found), sum(one[3] for one in found)
        took = Quantile.of([one[4] for one in found], 1e3)
        table.add(name, len(found), len(seen), Rate.of(seen), Rate.of(other), Quantile.of(delay), wrong, quiet, took)
        shown, still, alarms = shown + seen, still + quiet, alarms + wrong
    report.tables.append(table)
    settings.show(table)
    if shown:
        report.claims.append(Claim("slides that show, said in time, %", 100 * float(np.mean(shown)), 90.0, True, 0))
        report.claims.append(Claim("false alarms in 1000 still frames", 1000 * alarms / max(still, 1), 1.0, False, 1))


def _slid(model: ObjectModel, rng: np.random.Generator) -> tuple[bool, int | None, int, int, float] | None:
    """Whether a slide shows, after how many frames it is said (None: not in time), false alarms, frames that were
    still, and seconds a patch; None when nothing is touched.
    """
    import time

    gel = calibrated_digit(rng)
    points, normals = model.sample_surface(1, seed=int(rng.integers(2**31)))
    start = place(points[0], normals[0], 0.001, float(np.deg2rad(8.0)), rng)
    heading = float(rng.uniform(0.0, 2 * np.pi))
    way = np.array([np.cos(heading), np.sin(heading), 0.0])

    def at(moved: float, deeper: float) -> Array:
        return start @ se3.make_pose(None, moved * way + np.array([0.0, 0.0, deeper]))

    if (pressed_by(model, at(0.0, 0.0), gel) > 1e-4).mean() < PatchSettings().smallest:
        return None
    said, alarms, still, took = None, 0, 0, 0.0
    for sliding in (False, True):
        watch = PatchWatch()
        for frame in range(FRAMES):
            moved = EACH * min(max(frame - BEGINS + 1, 0), LASTS) if sliding else 0.0
            pose = at(moved, BREATH * np.sin(2 * np.pi * frame / FRAMES))
            image = see(gel, pressed_by(model, pose, gel), rng)
            patch = patch_of("gel", indentation_of(image, gel))
            jitter = se3.make_pose(se3.exp_rotation(JITTER[1] * rng.normal(size=3)), JITTER[0] * rng.normal(size=3))
            begin = time.process_time()
            slipped = watch.step([patch.moved(jitter)]).slipped
            took += time.process_time() - begin
            late = frame - BEGINS
            if slipped and sliding and 0 <= late < LASTS + SLIP_DELAY:
                said = late if said is None else said
            elif not sliding or late < 0:
                alarms, still = alarms + slipped, still + 1
    return _shows(model, at, gel), said, alarms, still, took / (2 * FRAMES)


def _shows(model: ObjectModel, at: Callable[[float, float], Array], gel: Gel) -> bool:
    """Whether the slide moves the true indentation over the skin. at (moved m, deeper m): the gel's pose."""
    work, step = gel.working, gel.working_step
    true = [
        from_depth(bridged(pressed_by(model, at(moved, 0.0), gel), gel)[::step, ::step], work, PatchSettings().heights)
        for moved in (0.0, EACH * PatchSlipSettings().memory)
    ]
    motion = patch_motion(true[0], true[1])
    return motion is None or float(np.linalg.norm(motion.shift[:2])) >= SHOWS * EACH * PatchSlipSettings().memory


def add_tracks(report: Report, settings: BenchSettings) -> None:
    """Hands with a camera, and what is asked of their tracks."""
    bench = SlipBench(
        name="gels",
        folder="gel",
        title="Slips in the hand (gels on five fingertips, lab noise)",
        note=f"{TRACK_FRAMES} frames at 30 a second. Gels without a calibration. As"
        " for arrays (`palpate bench arrays`), slips about an axis of symmetry are not counted.",
        objects=tuple(settings.some(TRACKED, 1)),
        trials=settings.count(2, 1),
        frames=TRACK_FRAMES,
        touch=("point", "gel"),
        alone=_patches_alone,
        without=lambda frame: replace(frame, gels={}),
        words="patches",
    )
    add_slip_table(report, settings, bench)


def _patches_alone(frames: list[Frame]) -> list[bool]:
    from touch.gels.patches import patches_of

    watch = PatchWatch()
    return [watch.step(in_palm(frame, patches_of(frame))).slipped for frame in frames]
