"""Recorded grasps of the iCub: a stereo cloud and three fingertip contacts of one grasp, without ground truth.

Vezzani et al., A novel pipeline for bi-manual handover task, Advanced Robotics 2017. No pose is known, so all that can
be said of an answer is how far the cloud's points and the contacts are from the surface there.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from fusion.benchmarks.printing.tables import BenchSettings, Column, Quantile, Table, own_seed
from fusion.truth.compare import Row, compare_frame
from fusion.truth.errors import Judge
from scenes.formats import handover

METHODS = ("icp", "icp_touch", "vision", "touch", "fused")


def table(folders: Sequence[Path], settings: BenchSettings, tries: int) -> Table:
    """A row a grasp and method: medians over tries that differ in the estimator's seed only."""
    columns = [
        Column("grasp"),
        Column("method"),
        Column("tries", 0),
        Column("cloud's inliers mm"),
        Column("inliers %", 0),
    ]
    columns += [Column("contacts mm"), Column("ok / ambiguous / lost"), Column("ms", 0)]
    out = Table("Recorded vision and touch", columns)
    out.note = (
        "Mean distances to the surface at the answer, medians over tries; ICP starts at the cloud's middle, unturned."
        " The authors' filter took 53 to 58 s a grasp for a mean distance of 2.7 to 6.9 mm. No truth is known."
    )
    warm = False
    for path in settings.progress(folders, len(folders), "grasps"):
        frame, model = handover.read_grasp(path)
        judge = Judge(model)
        model.field  # noqa: B018  (built before anything is timed)
        if not warm:
            compare_frame(frame, judge, METHODS)
            warm = True
        rows: list[Row] = []
        for number in range(tries):
            rows += compare_frame(frame, judge, METHODS, own_seed(settings.seed, path.name, number))
        for method in METHODS:
            _add(out, path.name, method, [row for row in rows if row.method == method])
    return out


def _add(out: Table, name: str, method: str, rows: list[Row]) -> None:
    verdicts = Counter(row.verdict for row in rows)
    judged = method not in ("icp", "icp_touch")
    out.add(
        name,
        method,
        len(rows),
        Quantile.of([row.agreement.cloud for row in rows], 1e3),
        Quantile.of([row.agreement.inliers for row in rows], 1e2),
        Quantile.of([row.agreement.contacts for row in rows], 1e3),
        " / ".join(str(verdicts[word]) for word in ("ok", "ambiguous", "lost")) if judged else None,
        Quantile.of([row.time_ms for row in rows]),
    )
