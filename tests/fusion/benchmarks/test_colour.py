"""The benchmark of the outline's colours: what it measures, and that it runs."""

import numpy as np
import pytest

from fusion.benchmarks.camera import colour, parting
from fusion.benchmarks.families.table import FAMILIES
from fusion.benchmarks.printing.tables import BenchSettings
from scenes.geometry import poses
from scenes.synthesis import library


def test_the_lateral_error_leaves_the_ray_out():
    model = library.make("box")
    truth = poses.make_pose(None, [0.0, 0.0, 0.5] - model.centroid)
    assert colour.lateral(poses.make_pose(None, [0.0, 0.0, 0.02]) @ truth, truth, model) < 1e-9
    across = poses.make_pose(None, [0.003, 0.004, 0.02]) @ truth
    assert colour.lateral(across, truth, model) == pytest.approx(0.005, rel=1e-6)


def test_frames_are_answered_without_and_with_colours(tmp_path):
    report = colour.run(BenchSettings(trials=1, quick=True, family="lab", objects=("box",), data=tmp_path))
    table, printed = report.tables
    assert [row[:3] for row in table.rows] == [["lab", "fused", 1], ["lab", "vision", 1]]
    assert all(np.isfinite(row[6]) and np.isfinite(row[7]) for row in table.rows)
    assert len(report.claims) == 2 * 2 + 1 + 2
    # whatever the start, the print tells the face that the shape does not
    starts = ["right face", "wrong face", "none", "wrong face, uneven light"]
    assert [row[1] for row in printed.rows] == starts
    assert all(row[4].share == 1.0 for row in printed.rows)
    assert printed.rows[1][3].share == 0.0
    pairs = list(colour.pairs_of(FAMILIES["lab"], [0.0], ["box"], 1, 0))
    assert {pair.sense for pair in pairs} == {"fused", "vision"}
    assert all(pair.used for pair in pairs)


def test_what_parting_by_colour_is_worth(tmp_path):
    settings = BenchSettings(trials=1, quick=True, family="loose", objects=("box",), data=tmp_path)
    table, claims = parting.run(settings, [FAMILIES["loose"], FAMILIES["lab"]], 1, 0.6)
    # a hand whose model is known is told apart by that
    assert [row[:4] for row in table.rows] == [
        ["loose", sense, start, 1] for sense in ("fused", "vision") for start in ("none", "33 mm, 16°")
    ]
    assert all(row[4].share == 1.0 for row in table.rows)
    assert len(claims) == 2
    assert "hand's model" in parting.parts(FAMILIES["lab"])
    assert parting.run(settings, [FAMILIES["lab"]], 1, 0.6) == (None, [])
