"""Taxel arrays: layouts on the skin, elastic foundation against closed forms, readings in synthetic grasps."""

import numpy as np
import pytest

from scenes.errors import InputError
from scenes.geometry import poses
from scenes.robot import tactile
from scenes.robot.fingers import find_fingers
from scenes.robot.hands import Hand
from scenes.robot.sensors import Sensor
from scenes.robot.tactile import SoftLayer
from scenes.synthesis import library
from scenes.synthesis.hands import five_finger_hand
from scenes.synthesis.recording import SynthesisSettings, synthesize, synthesize_frames

RADIUS = 0.008


@pytest.mark.parametrize(("layout", "count"), [("fingertip", 12), ("pad", 24)])
def test_layouts_lie_on_the_skin_of_the_touching_side(layout, count):
    hand = tactile.with_arrays(five_finger_hand(), layout)
    for finger in find_fingers(hand):
        sensor = hand.sensors[f"{finger.sensor}_array"]
        assert sensor.kind == "array"
        assert sensor.taxels.shape == (count, 6)
        places, normals = sensor.taxels[:, :3], sensor.taxels[:, 3:]
        np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0)
        across = np.where(places[:, 0] > 0, np.linalg.norm(places, axis=1), np.linalg.norm(places[:, 1:], axis=1))
        np.testing.assert_allclose(across, finger.radius, rtol=1e-9)
        gaps = np.linalg.norm(places[:, None] - places[None], axis=2) + np.eye(count)
        assert gaps.min() > 0.002
        assert (normals @ tactile.palmar_side(hand, finger)).mean() > 0.4


def test_palmar_is_where_fingers_bend_to():
    hand = five_finger_hand()
    sides = {f.sensor: tactile.palmar_side(hand, f) for f in find_fingers(hand)}
    np.testing.assert_allclose(sides["index_tip"], [0, 0, 1], atol=1e-6)
    np.testing.assert_allclose(sides["thumb_tip"], [0, 1, 0], atol=1e-6)


def ball_sensor(**layer):
    taxels = tactile.fingertip_taxels(RADIUS, np.array([0.0, 0.0, 1.0]))
    surface = {"sphere": {"radius": RADIUS}}
    return Sensor("tip", "link", "array", np.eye(4), surface, taxels, SoftLayer(**layer).to_json())


def on_top_of_the_box(tilt=0.0):
    """object_from_sensor: the ball touches the top face of the carton in its middle, its axis pointing down."""
    model = library.make("box")
    top = model.vertices[:, 2].max()
    down = poses.exp_rotation([0.0, np.pi / 2 + tilt, 0.0])  # x to -z
    return model, poses.make_pose(down, [0.003, 0.002, top + RADIUS])


def test_a_ball_on_a_plane_presses_as_an_elastic_foundation_does():
    """Johnson eq. 4.56: a ball of radius R pressed into a foundation by d carries pi K R d^2."""
    model, pose = on_top_of_the_box()
    layer = SoftLayer()
    normal = np.array([0.0, 0.0, 1.0])
    for force in (0.3, 1.0, 3.0):
        _, depth = tactile.press(model, pose, ball_sensor(), normal, force)
        expected = np.sqrt(force / (np.pi * layer.stiffness * RADIUS))
        assert depth == pytest.approx(expected, rel=0.12)  # the paraboloid is a ball to first order
    # squeezed to a tenth, no further
    _, deepest = tactile.press(model, pose, ball_sensor(), normal, 1e5)
    assert deepest == pytest.approx(0.9 * layer.thickness)


def test_pressure_is_highest_where_the_contact_is_and_spreads_with_thickness():
    model, pose = on_top_of_the_box()
    sensor = ball_sensor()
    pressure, _ = tactile.press(model, pose, sensor, np.array([0.0, 0.0, 1.0]), 3.0)
    facing = sensor.taxels[:, 3:] @ [1.0, 0.0, 0.0]
    assert np.argmax(pressure) == np.argmax(facing)
    assert pressure[facing < 0.3].max() == pytest.approx(0.0, abs=1.0)
    narrow, _ = tactile.press(model, pose, ball_sensor(spread=0.1), np.array([0.0, 0.0, 1.0]), 0.5)
    wide, _ = tactile.press(model, pose, ball_sensor(spread=1.5), np.array([0.0, 0.0, 1.0]), 0.5)
    assert (wide > 1e3).sum() > (narrow > 1e3).sum()


def test_the_skin_has_the_area_of_ball_and_cylinder():
    sensor = ball_sensor()
    points, normals, areas = tactile.skin(sensor)
    back = -min(0.0, sensor.taxels[:, 0].min()) + 0.003
    assert areas.sum() == pytest.approx(2 * np.pi * RADIUS**2 + 2 * np.pi * RADIUS * back, rel=1e-9)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-9)
    flat = Sensor("p", "l", "array", np.eye(4), None, sensor.taxels[:3], None)
    assert len(tactile.skin(flat)[0]) == 3 * 60
    assert points.shape == normals.shape


def test_electronics_have_noise_threshold_saturation_and_dead_taxels():
    layer = SoftLayer()
    rng = np.random.default_rng(0)
    read = tactile.read_out(np.full(20000, 5e4), layer, 1e3, None, rng)
    assert read.mean() == pytest.approx(5e4, rel=0.001)
    assert read.std() == pytest.approx(1e3, rel=0.03)
    assert (tactile.read_out(np.full(10, 1e3), layer, 0.0, None, rng) == 0).all()
    assert (tactile.read_out(np.full(10, 1e9), layer, 0.0, None, rng) == layer.saturation).all()
    dead = np.array([True, False])
    np.testing.assert_array_equal(tactile.read_out(np.full(2, 5e4), layer, 0.0, dead, rng), [0.0, 5e4])


@pytest.mark.parametrize("layout", ["fingertip", "pad"])
def test_arrays_are_recorded_and_read_back(tmp_path, layout):
    settings = SynthesisSettings(rgb=False)
    capture = synthesize(
        tmp_path / "c", library.make("cylinder"), five_finger_hand(), 1, 0.4, ("array", "point", "empty"), "clean", 7,
        settings=settings, taxels=layout,
    )  # fmt: skip
    frame = capture[0]
    arrays = {name: s for name, s in capture.hand.sensors.items() if s.kind == "array"}
    assert set(frame.tactile) == set(arrays)
    touching = {f"{name}_array" for name in frame.contacts.sensors}
    for name, pressure in frame.tactile.items():
        assert len(pressure) == tactile.LAYOUTS[layout]
        if name not in touching:
            assert pressure.max() == 0
    assert max(frame.tactile[name].max() for name in touching) > 5e3
    assert SoftLayer.from_json(next(iter(arrays.values())).soft_layer) == SoftLayer()
    # where fingers feel nothing the object is not
    if frame.no_contact is not None:
        inside = poses.apply(poses.inverse(frame.camera_from_object_truth), frame.no_contact.points)
        distance = capture.model.field.distance(inside)
        assert (distance > frame.no_contact.radius - 2e-3).all()
        assert not set(frame.no_contact.sensors) & set(frame.contacts.sensors)


def test_a_layout_of_one_s_own_and_bad_ones():
    hand = five_finger_hand()
    own = np.array([[0.008, 0, 0, 1.0, 0, 0]])
    assert len(tactile.with_arrays(hand, own).sensors["index_tip_array"].taxels) == 1
    with pytest.raises(InputError, match="fingertip, pad"):
        tactile.with_arrays(hand, "carpet")
    with pytest.raises(InputError, match="rows of x"):
        tactile.with_arrays(hand, np.zeros((2, 3)))
    with pytest.raises(InputError, match="poisson: expected a number from"):
        SoftLayer.from_json({"poisson": 0.5})
    with pytest.raises(InputError, match="tip sensor"):
        tactile.with_arrays(Hand(hand.robot, {}))


def test_the_same_seed_gives_the_same_pressures():
    args = (library.make("cylinder"), five_finger_hand())
    small = SynthesisSettings(camera=SynthesisSettings().camera.scaled(0.25), rgb=False)
    kwargs = {"occlusion": 0.4, "touch": ("array",), "noise": "harsh", "seed": 7, "settings": small}
    a, b = (synthesize_frames(*args, **kwargs)[0].tactile for _ in range(2))
    for name in a:
        np.testing.assert_array_equal(a[name], b[name])
