"""The benchmark of vision: its intervals, its objects, its tables from made-up trials."""

import numpy as np
import pytest

from fusion.benchmarks.camera import frames as vision_frames
from fusion.benchmarks.camera import vision
from fusion.benchmarks.camera.vision import OURS, Trial, bootstrap
from fusion.benchmarks.printing.tables import Report
from scenes.errors import InputError


def test_the_interval_holds_the_mean():
    values = np.random.default_rng(0).normal(3.0, 1.0, 200)
    low, high = bootstrap(values)
    assert low < values.mean() < high
    assert high - low == pytest.approx(4 * 1.0 / np.sqrt(200), rel=0.3)
    assert np.isnan(bootstrap([np.nan])).all()


def test_objects_by_name():
    assert list(vision_frames.objects(("mug", "box"))) == ["mug", "box"]
    assert len(vision_frames.objects()) >= 8
    with pytest.raises(InputError, match="drill"):
        vision_frames.objects(("spoon",))


def test_tables_charts_and_demands_of_some_trials():
    preset = vision_frames.PRESETS[0]
    right = Trial("mug", 0.001, 6.0, 120.0, 200.0, 80.0, "ok")
    wrong = Trial("ycb:mug", 0.02, 60.0, 100.0, 150.0, 60.0, "ok")
    peer = Trial("mug", 0.004, float("nan"), 10.0, 10.0, 5.0)
    found = {(preset, False, 0.0, OURS): [right, wrong], (preset, False, 0.0, "fgr"): [peer]}
    texts = vision._table(found, preset, False).texts()
    assert [row[1] for row in texts] == [OURS, "fgr"]
    assert texts[0][3:7] == ["50 %", "9-91", "100 %", "0 %"]
    assert texts[0][-1] == "1"
    chart = vision._chart(found, preset, False)
    assert chart.series[OURS] == [(175.0, 50.0)]
    report = Report("vision", "", "", 0)
    vision._claims(report, found, preset, False)
    assert [claim.met for claim in report.claims] == [False, False]
