"""Arrays in captures: frames with pressures become rows, and estimates use them; calibration of alpha; table 5.1."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from fusion import estimate
from fusion.benchmarks.arrays import angles
from fusion.benchmarks.arrays.grasps import pad
from fusion.benchmarks.contacts.trials import errors
from scenes.errors import CaptureError, InputError
from scenes.evidence.table import GATE_ABOVE, WEIGHT
from scenes.geometry import poses as se3
from scenes.recordings.frames import Contacts
from scenes.synthesis import library
from scenes.synthesis.hands import five_finger_hand
from scenes.synthesis.recording import SynthesisSettings, synthesize_frames
from touch.arrays.costs import ArrayProblem
from touch.arrays.descriptor import calibrate_alpha
from touch.arrays.readings import alpha_of, flickers, readings_of
from touch.arrays.rows import array_contacts, taxel_rows
from touch.contacts import feel

SMALL = SynthesisSettings(camera=SynthesisSettings().camera.scaled(0.25), rgb=False)
NONE = Contacts(np.zeros((0, 3)))


@cache
def frames(count=1, noise="clean", seed=5):
    touch = ("point", "array")
    return synthesize_frames(
        library.make("drill"), five_finger_hand(), count, 0.6, touch, noise, seed, settings=SMALL, taxels="pad"
    )


def test_pressures_of_a_frame_lie_on_the_object():
    frame, model = frames()[0], library.make("drill")
    readings = readings_of(frame)
    assert [r.sensor for r in readings] == list(frame.tactile)
    object_from_camera = se3.inverse(frame.camera_from_object_truth)
    touching = [r for r in readings if r.active.any()]
    assert len(touching) >= 3
    for one in touching:
        strong = one.pressure > 0.5 * one.pressure.max()
        distance = model.field.distance(se3.apply(object_from_camera, one.surface_points[strong]))
        # a stiff layer that saturates at 0.44 mm and blurs over a millimetre
        assert np.abs(distance).max() < 1.0e-3


def test_feel_takes_arrays_as_rows_and_as_contacts():
    frame = frames()[0]
    alone, without = feel(replace(frame, contacts=NONE)), feel(replace(frame, tactile={}))
    both = feel(frame)
    touching = sum(r.active.any() for r in readings_of(frame))
    assert len(alone.contacts) == touching
    assert alone.contacts.has_normal.all()
    # a fingertip that another sensor reports a contact of gives its taxels, not a second contact
    assert both.contacts.sensors == without.contacts.sensors
    taxels = sum(len(r.taxels) for r in readings_of(frame))
    assert len(both.rows) - len(without.rows) == taxels
    assert (both.rows.rows[:, GATE_ABOVE] == 0.0).sum() > (without.rows.rows[:, GATE_ABOVE] == 0.0).sum()


def test_arrays_without_a_hand_or_of_another_layout_are_named():
    frame = frames()[0]
    with pytest.raises(CaptureError, match="need a hand"):
        readings_of(replace(frame, hand=None))
    with pytest.raises(CaptureError, match="expected 24 pressures, got 3"):
        readings_of(replace(frame, tactile={"index_tip_array": np.zeros(3)}))
    with pytest.raises(CaptureError, match="expected an array of the hand"):
        readings_of(replace(frame, tactile={"elbow": np.zeros(3)}))
    assert readings_of(replace(frame, tactile={})) == []


def test_an_estimate_from_arrays_alone_is_near():
    frame, model = frames()[0], library.make("drill")
    found = estimate(replace(frame, contacts=NONE), model, use=("touch",))
    blind = estimate(replace(frame, contacts=NONE, tactile={}), model, use=("touch",))
    truth = frame.camera_from_object_truth
    assert errors(model, found.pose, truth)[1] < 0.5 * errors(model, blind.pose, truth)[1]
    assert any("contacts" in stage.why for stage in found.trace)


@pytest.mark.slow
def test_arrays_better_an_estimate_by_vision():
    model, off = library.make("drill"), {"with": [], "without": []}
    for frame in frames(8, "lab", 700):
        for key, one in (("with", frame), ("without", replace(frame, tactile={}))):
            found = estimate(replace(one, contacts=NONE), model)
            off[key].append(errors(model, found.pose, frame.camera_from_object_truth))
    assert (np.mean(off["with"], axis=0) < np.mean(off["without"], axis=0)).all()


def test_alpha_is_found_on_known_presses():
    taxels, model = pad(8, 3, 0.0032, None), angles.shapes_pressed()["wide flat"]
    tilts = (1.0, 3.0)
    readings = [angles.pressed(model, taxels, tilt, 0.0015) for tilt in tilts]
    normals = np.array([angles.normal_of(tilt) for tilt in tilts])
    alpha = calibrate_alpha(readings, normals, power=2.0)
    # a flat surface over the whole pad: nothing but its border is blurred
    assert alpha / alpha_of(readings[0].layer) == pytest.approx(1.0, abs=0.15)
    assert angles.tilt_error(angles.pressed(model, taxels, 2.0, 0.0011), 2.0, alpha, 2.0) < 0.3
    with pytest.raises(InputError, match="a normal for each"):
        calibrate_alpha(readings, normals[:1])


def test_a_taxel_that_says_nothing_is_neither_touched_nor_empty():
    frame = frames()[0]
    name, pressure = next((n, p) for n, p in frame.tactile.items() if (p > 0.0).sum() > 3)
    told = replace(frame, tactile={**frame.tactile, name: np.where(pressure > 0.0, pressure, np.nan)})
    before, after = (next(r for r in readings_of(f) if r.sensor == name) for f in (frame, told))
    np.testing.assert_array_equal(after.active, before.active)
    assert before.silent.any()
    assert not after.silent.any()
    assert len(feel(frame).rows) - len(feel(told).rows) == before.silent.sum()
    model = library.make("drill")
    # nor do its pressures: pushed 1 mm farther into the finger, the object would be felt by more of them
    inside = se3.perturb(
        frame.camera_from_object_truth,
        [0.0] * 3 + list(-0.001 * after.taxels[after.active, 3:].mean(axis=0)),
        model.centroid,
    )
    costs = [ArrayProblem(model, [one]).forward(inside[None])[0] for one in (before, after)]
    assert costs[1] < costs[0]


def test_taxels_that_flicker_in_their_noise_say_nothing():
    frame = frames()[0]
    name = next(iter(frame.tactile))
    pressure = np.zeros(len(frame.tactile[name]))
    touched = len(feel(replace(frame, contacts=NONE, tactile={**frame.tactile, name: pressure})).contacts)
    for strength, beside, felt in ((2e3, 0.0, 0), (2e3, 2e3, 1), (2e4, 0.0, 1)):
        told = pressure.copy()
        told[4], told[5] = strength, beside  # neighbours of one row of the pad
        flicker = replace(frame, contacts=NONE, tactile={**frame.tactile, name: told})
        assert len(feel(flicker).contacts) == touched + felt
        one = next(r for r in readings_of(flicker) if r.sensor == name)
        assert one.unknown.sum() == 1 - felt


def test_a_skin_of_a_low_threshold_has_little_noise():
    taxels = next(r for r in readings_of(frames()[0])).taxels
    lone = np.where(np.arange(len(taxels)) == 4, 2e3, 0.0)
    assert [flickers(taxels, lone, threshold).sum() for threshold in (1.5e3, 200.0, 0.0)] == [1, 0, 1]


def test_one_taxel_is_one_contact_and_no_row_beside_it():
    frame = frames()[0]
    first = next(r for r in readings_of(frame) if r.active.sum() > 3)
    most = np.argsort(first.pressure)[::-1]
    for count, weight in ((1, 0.0), (2, 1.0), (4, 2.0)):
        pressure = np.where(np.isin(np.arange(len(most)), most[:count]), first.pressure, 0.0)
        rows = taxel_rows([replace(first, pressure=pressure)])
        assert rows.rows[rows.on, WEIGHT].sum() == pytest.approx(weight)


def test_the_normal_of_one_taxel_may_be_an_edge():
    first = next(r for r in readings_of(frames()[0]) if r.active.sum() > 3)
    alone = np.where(np.arange(len(first.pressure)) == np.argmax(first.pressure), first.pressure, 0.0)
    whole, one = array_contacts([first, replace(first, pressure=alone)]).sigma_normal
    assert whole < np.deg2rad(5.0) < one
