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
from scenes.evidence.table import GATE_ABOVE
from scenes.geometry import poses as se3
from scenes.recordings.frames import Contacts
from scenes.synthesis import library
from scenes.synthesis.hands import five_finger_hand
from scenes.synthesis.recording import SynthesisSettings, synthesize_frames
from touch.arrays.descriptor import calibrate_alpha
from touch.arrays.readings import alpha_of, readings_of
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
