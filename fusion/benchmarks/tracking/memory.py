"""How much memory does a track take that goes on and on? Megabytes that the process holds, after so many frames.

A recording of an object that is carried to and fro, a quarter of VGA a side, is tracked as `palpate track` does it:
read frame by frame from its folder, answers, pictures and checkpoints written as they come, and a report at the end.
Few of its frames differ, all are read. Another process makes it: what drawing a hand takes is no tracker's.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from fusion.benchmarks.families.making import hand_of, true_model
from fusion.benchmarks.families.table import FAMILIES
from fusion.benchmarks.printing.tables import BenchSettings, Claim, Column, Rate, Report, Table
from fusion.benchmarks.tracking.sequences import USUAL
from scenes.recordings.captures import read_capture, write_capture
from scenes.recordings.frames import Frame

OBJECT = "drill"
# Frames that are made, and of a recording; in a hurry.
MADE, FRAMES, QUICK = 8, 5000, 200
# A camera a quarter of VGA a side, and the share that is hidden.
SCALE, OCCLUSION = 0.25, 0.4
# Frames after which the memory is told, as shares of all, beside the first few.
FIRST, SHARES = 10, (0.02, 0.1, 0.25, 0.5, 0.75, 1.0)
# Megabytes at most over an hour, and seconds at most that a report of REPORTED frames takes.
MOST, SLOWEST, REPORTED = 400.0, 5.0, 600


def run(settings: BenchSettings) -> Report:
    """Memory through time, processor time of a frame, and of the report."""
    from fusion.results.track.report import write_track_report
    from fusion.results.track.running import TrackRun
    from fusion.results.track.summary import read_columns, summary
    from fusion.tracking.tracker import Tracker

    count = settings.frames or (QUICK if settings.quick else FRAMES)
    table = Table(
        f"{count} frames of a {OBJECT}, carried to and fro",
        [Column("frames", 0), Column("MB", 0), Column("most so far", 0), Column("processor ms a frame", 1)],
        note="What the whole process holds; processor time of all since the frame before, reading, searching, pictures"
        " and checkpoints included.",
    )
    report = Report("memory", "A track that goes on and on", f"{count} frames", settings.seed, tables=[table])
    told = {min(FIRST, count), *(max(1, round(share * count)) for share in SHARES)}
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "recording"
        with ProcessPoolExecutor(1, get_context("spawn")) as other:
            other.submit(_record, folder, count, settings.seed).result()
        capture = read_capture(folder)
        out, model = Path(scratch) / "out", capture.model
        most, before, since = 0.0, time.process_time(), 0
        with TrackRun(capture, model, out, lambda: Tracker(model, seed=settings.seed), lambda f, _: f, {}) as track:
            for step in settings.progress(track.steps(), count, "memory"):
                most = max(most, held := _megabytes())
                if step.done in told:
                    now = time.process_time()
                    table.add(step.done, held, most, 1e3 * (now - before) / (step.done - since))
                    before, since = now, step.done
            track.save()
        begun = time.process_time()
        columns = read_columns(out, model)
        recorded = tuple(capture.frame_ids)
        write_track_report(out, "recording", model, columns, summary(columns, len(recorded), None, True), recorded)
        written = time.process_time() - begun
        most = max(most, _megabytes())
    settings.show(table)
    ok = columns.verdict.count("ok")
    page = Table("The report at the end", [Column("frames", 0), Column("ok"), Column("processor s", 1)])
    page.add(len(columns), Rate(ok, len(columns)), written)
    report.tables.append(page)
    settings.show(page)
    report.claims.append(Claim(f"memory over {count} frames, most, MB", most, MOST, False, 0))
    if count <= REPORTED:
        report.claims.append(Claim(f"report of {count} frames, processor s", written, SLOWEST, False, 1))
    return report


def _record(folder: Path, count: int, seed: int) -> None:
    """Writes a recording of `count` frames, of which MADE differ."""
    from scenes.synthesis.recording import SynthesisSettings, synthesize_frames

    family, model = FAMILIES[USUAL], true_model(OBJECT)
    how = SynthesisSettings(camera=SynthesisSettings().camera.scaled(SCALE), rgb=False)
    hand = hand_of(family)
    made = synthesize_frames(
        model, hand, MADE, OCCLUSION, noise=family.preset(), seed=seed, settings=how, motion="carry"
    )
    around = [*made, *made[-2:0:-1]]

    def frames() -> Iterator[Frame]:
        for index in range(count):
            yield replace(around[index % len(around)], index=index, prior=made[0].prior if index == 0 else None)

    write_capture(folder, frames(), model, hand)


def _megabytes() -> float:
    """What the process holds now, where the system tells it; elsewhere the most that it ever held, or NaN."""
    status = Path("/proc/self/status")
    if status.is_file():
        line = next(one for one in status.read_text(encoding="ascii").splitlines() if one.startswith("VmRSS"))
        return int(line.split()[1]) / 1024
    try:
        import resource
        import sys
    except ImportError:
        return float(np.nan)
    per = 2.0**20 if sys.platform == "darwin" else 2.0**10
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / per
