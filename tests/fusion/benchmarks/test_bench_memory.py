"""What a track holds: told as it goes, with the report at its end."""

import numpy as np

from fusion.benchmarks.printing.tables import BenchSettings
from fusion.benchmarks.tracking import memory


def test_memory_is_told_through_a_short_track():
    shown = []
    report = memory.run(BenchSettings(frames=24, show=shown.append))
    through, page = report.tables
    assert shown == report.tables
    assert [row[0] for row in through.rows] == [1, 2, 6, 10, 12, 18, 24]
    held, most = (np.array([row[k] for row in through.rows]) for k in (1, 2))
    assert (held > 50.0).all()
    assert (np.diff(most) >= 0).all()
    assert (most >= held).all()
    assert page.rows[0][0] == 24
    assert {claim.target for claim in report.claims} == {memory.MOST, memory.SLOWEST}
