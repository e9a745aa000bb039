"""The benchmark of taxel arrays: what its tables are made of, on a few trials."""

import numpy as np
import pytest

from fusion.benchmarks.arrays import bench as arrays
from fusion.benchmarks.arrays import modes as arrays_modes
from fusion.benchmarks.arrays import settings as arrays_settings
from fusion.benchmarks.arrays import slip as arrays_slip
from fusion.benchmarks.arrays.grasps import GRASPS, GraspNoise, hold, recordings
from fusion.benchmarks.printing.tables import BenchSettings, Report
from scenes.geometry import poses as se3
from touch.arrays.cloud import surface_cloud
from touch.arrays.costs import ArrayProblem

SETTINGS = BenchSettings(trials=1, seed=5, quick=True)


def report():
    return Report("arrays", "arrays", "few trials", 5)


def test_distance_to_a_cloud_is_that_to_its_nearest_point():
    truth, readings = recordings("a", 1, [5])[0]
    problem = ArrayProblem(hold("a").model, readings)
    places = np.stack([truth, se3.perturb(truth, [0.1, 0.0, 0.0, 0.0, 0.004, 0.0], problem.model.centroid)])
    cloud = surface_cloud(problem.model, arrays_settings.COARSE).points
    for place, found in zip(places, arrays_settings._to_cloud(problem, places)):
        total = 0.0
        for one in problem.touching:
            felt = se3.apply(se3.inverse(place), one.taxels[one.active, :3])
            total += np.mean(np.min(np.sum((felt[:, None] - cloud[None]) ** 2, axis=2), axis=1))
        assert found == pytest.approx(total)
    assert arrays_settings._to_cloud(problem, places)[0] < arrays_settings._to_cloud(problem, places)[1]


def test_recordings_without_errors_are_where_they_say():
    truth, readings = recordings("a", 1, [5], GraspNoise(turn=0.0, move=0.0))[0]
    problem = ArrayProblem(hold("a").model, readings)
    # squared metres, four contacts: half a millimetre each, from the layer's blur and the noise of the pressure
    assert problem.distance(truth[None])[0] < 4 * 0.0007**2


def test_orders_of_modes_are_counted_on_the_same_grasps(monkeypatch):
    monkeypatch.setattr(arrays_modes, "OBJECTS", {"box": 2, "l_block": 1})
    made = report()
    arrays_modes.add_modes(made, SETTINGS)
    rows = made.to_json()["tables"][0]["rows"]
    assert [row["object"] for row in rows] == ["box", "l_block", "all"]
    for row in rows:
        for key in (*arrays_modes.ORDERS, arrays_modes.FINISHED):
            assert row[key]["n"] == row["several"]
    assert rows[2]["several"] == rows[0]["several"] + rows[1]["several"]


def test_what_decides_compares_the_two_costs_on_the_same_poses(monkeypatch):
    monkeypatch.setattr(arrays_settings, "POSES", 40)
    half = np.repeat([arrays.ANGLE, arrays.DISTANCE], 3)
    usual, rough = (
        arrays_settings._over_poses(variant, 1, half, SETTINGS, arrays._rhos)
        for variant in (arrays_settings.VARIANTS[0], arrays_settings.VARIANTS[-1])
    )
    assert usual.shape == (2, len(GRASPS), 2)
    assert (np.abs(usual) <= 1.0).all()
    assert usual.mean() > rough.mean() > 0.3
    assert arrays_settings._above(np.stack([usual[0], usual[0] - 0.1])) == (len(GRASPS), len(GRASPS))


def test_a_method_of_slips_says_something_of_every_frame():
    from scenes.synthesis import library
    from scenes.synthesis.hands import five_finger_hand
    from scenes.synthesis.recording import SynthesisSettings, synthesize_frames

    small = SynthesisSettings(camera=SynthesisSettings().camera.scaled(0.25), rgb=False)
    model = library.make("mug")
    frames = synthesize_frames(
        model, five_finger_hand(), 4, 0.4, ("point", "array"), "lab", 3, settings=small, taxels="pad", motion="carry"
    )
    bench = arrays_slip.slip_bench(SETTINGS)
    for method in bench.methods:
        said = bench.said(method, model, frames)
        assert len(said) == len(frames)
        assert not any(word.slip for word in said)
