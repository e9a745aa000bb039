"""Gels: height from colours, calibration by a ball, patches, rows, and where the object is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from pressed_gels import ball_depth, flat_gel

from fusion.estimation.estimate import estimate
from scenes.errors import CaptureError, InputError
from scenes.evidence.table import GATE_ABOVE
from scenes.geometry import poses as se3
from scenes.recordings.frames import Contacts, Frame
from scenes.robot.digit import digit_gel
from scenes.robot.hands import Hand
from scenes.robot.sensors import Sensor
from scenes.synthesis import library
from scenes.synthesis.gels import bridged, lit_digit, photograph_gel, pressed_by, with_gels
from touch.contacts import feel
from touch.gels.localize import localize_gels, off_middle
from touch.gels.patches import Patch, patch_of, patches_of
from touch.gels.proposals import bend_of, propose
from touch.gels.rows import gel_contacts, patch_rows
from touch.gels.skin.heights import harmonic, indentation_of, membrane
from touch.gels.skin.surfaces import integrate, slopes

# ---- integration


def test_integration_recovers_a_surface():
    y, x = np.mgrid[0:60, 0:80] / 20.0
    surface = np.sin(x) * np.cos(1.3 * y) + 0.2 * x * y
    found = integrate(np.gradient(surface, axis=1), np.gradient(surface, axis=0))
    inner = (slice(2, -2), slice(2, -2))
    away = (found - found[inner].mean()) - (surface - surface[inner].mean())
    assert np.abs(away[inner]).max() < 0.01


def test_integration_solves_the_normal_equations():
    rng = np.random.default_rng(1)
    p, q = rng.normal(size=(7, 9)), rng.normal(size=(7, 9))
    found = integrate(p, q)
    # the plain twin: least squares over differences of neighbours
    rows, right = [], []
    for r in range(7):
        for c in range(9):
            for slope, (dr, dc) in ((p, (0, 1)), (q, (1, 0))):
                if r + dr < 7 and c + dc < 9:
                    row = np.zeros((7, 9))
                    row[r, c], row[r + dr, c + dc] = -1.0, 1.0
                    rows.append(row.ravel())
                    right.append(0.5 * (slope[r, c] + slope[r + dr, c + dc]))
    twin = np.linalg.lstsq(np.array(rows), np.array(right), rcond=None)[0].reshape(7, 9)
    np.testing.assert_allclose(found - found.mean(), twin - twin.mean(), atol=1e-9)


@pytest.mark.parametrize("gel", [digit_gel((60, 80)), flat_gel(60, 2e-4)], ids=["curved, pinhole", "flat, parallel"])
def test_slopes_of_normals_integrate_to_the_depth(gel):
    v, u = np.mgrid[0 : gel.height, 0 : gel.width]
    square = ((u - gel.width / 2) / 12.0) ** 2 + ((v - gel.height / 2) / 15.0) ** 2
    depth = 0.001 * np.exp(-square)
    pressed, rest = slopes(gel.normals(depth), gel), slopes(gel.untouched_normals, gel)
    change = integrate(pressed[0] - rest[0], pressed[1] - rest[1])
    change -= np.median(change[square > 6.0])
    found = -change if gel.distance is None else -(gel.distance + gel.surface) * np.expm1(change)
    assert np.abs(found - depth).max() < 5e-5


def test_membrane_of_an_ellipse_is_its_cap():
    v, u = np.mgrid[0:120, 0:120]
    square = ((u - 60) / 45.0) ** 2 + ((v - 60) / 25.0) ** 2
    cap = np.clip(1.0 - square, 0.0, None)
    assert np.abs(membrane(square < 1.0, 60) - cap).max() < 0.1
    assert np.isfinite(membrane(np.ones((20, 20), dtype=bool))).all()
    assert not membrane(np.zeros((20, 20), dtype=bool)).any()


# ---- height from colours


@pytest.mark.parametrize(("radius", "depth"), [(0.003, 0.0006), (0.010, 0.0008), (0.02, 0.0004)])
def test_height_from_colour_is_within_a_tenth_of_a_millimetre(digit, radius, depth):
    rng = np.random.default_rng(11)
    true = ball_depth(digit, radius, depth, 120, 170)
    pressed = indentation_of(photograph_gel(digit, bridged(true, digit), rng), digit)
    step = digit.working_step
    on = true[::step, ::step] > 1e-4
    assert pressed.measured
    assert np.sqrt(np.mean((pressed.depth - true[::step, ::step])[on] ** 2)) < 1e-4
    assert pressed.touched[on].mean() > 0.6


def test_without_a_calibration_the_outline_tells_place_extent_and_axes():
    rng = np.random.default_rng(5)
    gel = lit_digit(rng)
    model = library.make("cylinder")
    axis = np.array([0.0, 0.0, 1.0])
    side = max(float(np.abs(model.vertices[:, 0]).max()), 0.01)
    # the cylinder's side on the gel, its axis along the image's rows
    rotation = np.stack([np.cross(axis, [-1.0, 0.0, 0.0]), axis, [-1.0, 0.0, 0.0]], axis=1)
    object_from_sensor = se3.make_pose(rotation, (side - 0.0009, 0.0, 0.0))
    true = pressed_by(model, object_from_sensor, gel)
    assert true.max() > 5e-4
    pressed = indentation_of(photograph_gel(gel, bridged(true, gel), rng), gel)
    assert not pressed.measured
    found = patch_of("g", pressed)
    on = gel.points(true)[true > 2e-4]
    assert np.linalg.norm(found.points[:, :2].mean(axis=0) - on[:, :2].mean(axis=0)) < 0.001
    spread = np.linalg.eigh(np.cov(found.points[:, :2].T))[1][:, 1]
    expected = np.linalg.eigh(np.cov(on[:, :2].T))[1][:, 1]
    assert abs(spread @ expected) > np.cos(np.deg2rad(15.0))


def test_a_known_contact_scales_the_outline():
    rng = np.random.default_rng(6)
    gel = lit_digit(rng)
    true = ball_depth(gel, 0.008, 0.0012, 120, 160)
    image = photograph_gel(gel, bridged(true, gel), rng)
    known = indentation_of(image, gel, known=(120, 160, float(true[160, 120])))
    assert abs(known.depth[160 // gel.working_step, 120 // gel.working_step] - true[160, 120]) < 1e-4
    assert indentation_of(image, gel).sigma.max() > known.sigma.max()


def test_an_untouched_gel_feels_nothing(digit):
    rng = np.random.default_rng(9)
    pressed = indentation_of(photograph_gel(digit, np.zeros((320, 240)), rng), digit)
    assert not pressed.touched.any()
    patch = patch_of("g", pressed)
    assert len(patch) == 0
    assert len(patch.silent) > 10
    assert (patch_rows([patch]).rows[:, GATE_ABOVE] == 0.0).all()
    assert len(gel_contacts([patch])) == 0


def test_micrometres_are_taken_as_they_are():
    gel = flat_gel()
    counts = np.zeros((160, 160), dtype=np.uint16)
    counts[60:100, 50:110] = 800
    pressed = indentation_of(counts, gel)
    assert pressed.measured
    patch = patch_of("g", pressed)
    np.testing.assert_allclose(patch.points[:, 2], -0.0008, atol=1e-9)
    flat = np.abs(patch.normals[:, 2]) > 0.99
    assert flat.mean() > 0.5
    assert (patch.normals[flat, 2] < 0).all()  # out of the object, into the finger


# ---- bad input: one line each


def test_bad_images_are_refused(digit):
    image = photograph_gel(digit, np.zeros((320, 240)), np.random.default_rng(1))
    with pytest.raises(InputError, match="g: expected the untouched background"):
        indentation_of(image, replace(digit, background=None), "g")
    with pytest.raises(InputError, match=r"g: expected an image of 240x320 pixels as the gel's, got 240x100"):
        indentation_of(image[:100], digit, "g")
    bright = image.copy()
    bright[:, :, 1] = 255
    with pytest.raises(InputError, match="got green saturated in 100 %"):
        indentation_of(bright, digit, "g")
    with pytest.raises(InputError, match="one colour all over"):
        indentation_of(np.zeros_like(image), digit, "g")
    with pytest.raises(InputError, match=r"expected indentations up to the gel's 5 mm, got 9 mm"):
        indentation_of(np.full((320, 240), 9000, dtype=np.uint16), digit, "g")


# ---- patches, proposals, the object


def test_bending_of_known_shapes():
    rng = np.random.default_rng(2)
    x, y = rng.uniform(-0.004, 0.004, size=(2, 400))
    for radius_x, radius_y in ((0.02, 0.02), (0.02, 1e9), (1e9, 1e9)):
        z = -(x**2) / (2 * radius_x) - y**2 / (2 * radius_y)
        normals = np.stack([x / radius_x, y / radius_y, np.ones_like(x)], axis=1)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        _, frame, bends = bend_of(np.stack([x, y, z], axis=1), normals)
        np.testing.assert_allclose(bends, sorted([1 / radius_x, 1 / radius_y])[::-1], atol=3.0)
        assert frame[2, 2] > 0.999
        assert np.linalg.det(frame) == pytest.approx(1.0)
        if radius_y > 1:
            assert radius_x > 1 or abs(frame[0, 0]) > 0.99


def press_poses(model, count, seed):
    """object_from_sensor of presses on places far from one another, by name."""
    points, normals = model.sample_surface(60, seed=seed)
    chosen = [0]
    while len(chosen) < count:
        chosen.append(int(np.argmax(np.min([np.linalg.norm(points - points[i], axis=1) for i in chosen], axis=0))))
    out = {}
    for i in chosen:
        z = -normals[i]
        x = np.cross(z, np.eye(3)[int(np.argmin(np.abs(z)))])
        x /= np.linalg.norm(x)
        out[f"g{i}"] = se3.make_pose(np.stack([x, np.cross(z, x), z], axis=1), points[i] - 0.0009 * normals[i])
    return out


def three_presses(model, truth, gel, seed):
    """Patches of three far places, noise only in the images."""
    rng = np.random.default_rng(seed)
    out = []
    for name, pose in press_poses(model, 3, seed).items():
        image = photograph_gel(gel, bridged(pressed_by(model, pose, gel), gel), rng)
        out.append(patch_of(name, indentation_of(image, gel)).moved(truth @ pose))
    return [patch for patch in out if len(patch)]


def test_three_presses_find_the_object(digit):
    model = library.make("drill")
    truth = se3.exp(np.array([0.4, -1.0, 0.7, 0.1, 0.2, 0.3]))
    patches = three_presses(model, truth, digit, 4)
    assert len(patches) == 3
    residual, _, _ = model.surface.closest(se3.apply(se3.inverse(truth), np.concatenate([p.points for p in patches])))
    assert np.median(np.abs(residual)) < 2.5e-4
    found = localize_gels(model, patches, seed=1)
    errors = [se3.difference(mode.pose[None], truth, model.centroid)[0] for mode in found.modes]
    assert min(np.linalg.norm(e[:3]) for e in errors) < np.deg2rad(10.0)
    assert min(np.linalg.norm(e[3:]) for e in errors) < 0.010
    again = localize_gels(model, patches, seed=1)
    np.testing.assert_array_equal(found.pose, again.pose)


def test_one_press_proposes_the_truth(digit):
    model = library.make("l_block")
    truth = np.eye(4)
    patch = three_presses(model, truth, digit, 2)[0]
    proposals = propose(model, patch)
    assert 100 < len(proposals) <= 2500
    assert np.isfinite(proposals).all()
    assert len(propose(model, replace(patch, points=patch.points[:3], normals=patch.normals[:3]))) == 0


def test_no_touch_is_refused():
    nothing = Patch("g", *np.zeros((2, 0, 3)), *np.zeros((2, 0)), np.zeros((4, 3)), np.eye(4))
    with pytest.raises(InputError, match="expected at least one gel that touches something"):
        localize_gels(library.make("box"), [nothing])


# ---- frames


def test_a_frame_feels_its_gels(hand):
    held = with_gels(hand, 3)
    name = "index_tip_gel"
    gel = held.sensors[name].gel
    joints = dict.fromkeys(held.joint_names, 0.1)
    true = ball_depth(gel, 0.02, 0.0006, gel.width // 2, gel.height // 2)
    image = photograph_gel(gel, bridged(true, gel), np.random.default_rng(0))
    frame = Frame(0, "f", hand=held, joints=joints, world_from_hand=np.eye(4), gels={name: image})
    felt = feel(frame)
    assert felt.contacts.sensors == [name]
    at = (held.hand_from_sensor(joints)[name])[:3, 3]
    assert np.linalg.norm(felt.contacts.points[0] - at) < 0.003
    # a contact of the same sensor speaks for the gel: one touch is one contact
    spoken = replace(frame, contacts=Contacts(at[None], sensors=[name]))
    assert len(feel(spoken).contacts) == 1
    with pytest.raises(CaptureError, match="need a hand, its joints and its pose"):
        patches_of(replace(frame, hand=None))
    with pytest.raises(CaptureError, match="expected a gel of the hand"):
        patches_of(replace(frame, gels={"index_tip": image}))


def test_an_estimate_without_a_start_begins_where_the_gels_say(digit, hand):
    model = library.make("drill")
    truth = se3.exp(np.array([0.4, -1.0, 0.7, 0.1, 0.2, 0.3]))
    rng = np.random.default_rng(4)
    sensors, images = {}, {}
    for name, pose in press_poses(model, 3, 4).items():
        image = photograph_gel(digit, bridged(pressed_by(model, pose, digit), digit), rng)
        sensors[name] = Sensor(name, hand.link_names[0], "gel", truth @ pose, gel=digit)
        images[name] = image
    held = Hand(hand.robot, sensors)
    joints = dict.fromkeys(held.joint_names, 0.0)
    frame = Frame(0, "f", hand=held, joints=joints, world_from_hand=np.eye(4), gels=images)
    answer = estimate(frame, model, use=("touch",))
    search = next(stage for stage in answer.trace if stage.name == "search")
    assert "starts, by 3 gels too" in search.why
    errors = [se3.difference(mode.pose[None], truth, model.centroid)[0] for mode in answer.modes]
    assert min(np.linalg.norm(e[:3]) / 0.17 + np.linalg.norm(e[3:]) / 0.01 for e in errors) < 1.5
    # with a start they are not needed
    started = estimate(replace(frame, prior=truth), model, use=("touch",))
    assert all("gels" not in stage.why for stage in started.trace)


def test_of_poses_that_explain_alike_the_fingers_are_nearest_to_the_middle():
    model = library.make("cylinder")
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, 2, 3] = (0.0, 0.02, -0.04)
    nats = off_middle(model, np.array([[0.03, 0.0, 0.0], [-0.03, 0.0, 0.0]]) + model.centroid, poses, 0.5)
    assert nats[0] == pytest.approx(0.0, abs=1e-9)
    assert nats[2] == pytest.approx(4.0 * nats[1]) == pytest.approx(0.5 * (0.04 / (0.5 * model.radius)) ** 2)


def test_what_is_smooth_between_held_values_is_found():
    y, x = np.mgrid[0:120, 0:160] / 100.0
    plane = 0.3 + 0.2 * x - 0.1 * y  # its own harmonic continuation
    inside = (x - 0.8) ** 2 + (y - 0.6) ** 2 < 0.1
    found = harmonic(np.where(inside, 7.0, plane), inside)
    assert np.abs(found - plane)[inside].max() < 0.004
    nothing, everything = np.zeros_like(inside), np.ones_like(inside)
    assert (harmonic(plane, nothing) == 0.0).all()
    assert (harmonic(plane, everything) == 0.0).all()
