"""Poses that a rough look confuses: what is nearly a symmetry, and what is one or is none."""

import numpy as np
import pytest
import trimesh

from scenes.evidence.symmetry.near_symmetries import (
    AROUND,
    NearSettings,
    find_near_symmetries,
    near_symmetries,
    quarter_turns,
    round_axes,
    turns_about,
)
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.synthesis import library


def _angles(model):
    return np.degrees(se3.rotation_angle(find_near_symmetries(model)[:, :3, :3]))


def test_a_mug_turns_about_its_axis_but_for_the_handle():
    found = find_near_symmetries(library.make("mug"))
    turns = se3.log_rotation(found[:, :3, :3])
    upright = np.abs(turns[:, 2]) > 0.9 * np.linalg.norm(turns, axis=1)
    angles = np.degrees(np.abs(turns[upright, 2]))
    assert upright.sum() >= 8
    assert angles.min() < 40
    assert angles.max() > 120


@pytest.mark.parametrize("name", ["sphere", "cylinder", "box"])
def test_what_is_a_symmetry_is_not_listed(name):
    assert len(find_near_symmetries(library.make(name))) == 0


def test_of_turns_that_leave_as_much_in_place_the_one_that_settled_is_taken():
    box = library.make("box")
    found = find_near_symmetries(box.with_symmetries(type(box.symmetries).none()))
    exact = box.symmetries.discrete[1:]
    off = se3.rotation_angle(np.swapaxes(exact[:, None, :3, :3], -1, -2) @ found[None, :, :3, :3])
    assert len(found) == len(exact)
    assert np.degrees(off.min(axis=0)).max() < 0.1


def test_most_of_the_surface_stays_where_it_was():
    model, settings = library.make("hammer"), NearSettings()
    points, _ = model.sample_surface(4000, seed=9)
    for pose in find_near_symmetries(model):
        se3.check_pose(pose, "near symmetry")
        off = np.abs(model.field.distance(se3.apply(pose, points)))
        assert np.mean(off < settings.near_share * model.radius) > settings.least - 0.08


def test_same_bits_again_and_kept_with_the_object():
    model = library.make("drill")
    assert (find_near_symmetries(model) == find_near_symmetries(library.make("drill"))).all()
    assert near_symmetries(model) is near_symmetries(model)
    assert (_angles(model) > 8).all()


def test_quarter_turns_are_a_cube_s_about_the_centroid():
    model = library.make("drill")
    turns = quarter_turns(model)
    assert turns.shape == (23, 4, 4)
    np.testing.assert_allclose(se3.apply(turns[5], model.centroid[None])[0], model.centroid, atol=1e-12)
    angles = np.sort(np.degrees(se3.rotation_angle(turns[:, :3, :3])).round(6))
    np.testing.assert_array_equal(np.unique(angles, return_counts=True)[1], [6, 8, 9])  # 90, 120 and 180 degrees
    # one after the other they are another one of them, or none
    every = np.concatenate([turns, np.eye(4)[None]])
    for product in turns[3] @ every:
        assert np.abs(every - product).max(axis=(1, 2)).min() < 1e-9


@pytest.mark.parametrize(("name", "round_about"), [("cylinder", 1), ("mug", 0), ("box", 0), ("drill", 0)])
def test_round_is_what_stays_in_place_however_it_is_turned(name, round_about):
    made = library.make(name)
    axes = round_axes(type(made)(f"{name}, plain", made.vertices, made.faces))
    assert axes.shape == (round_about, 3)
    np.testing.assert_allclose(np.linalg.norm(axes, axis=1), 1.0, atol=1e-12)
    if round_about:
        assert abs(axes[0, 2]) > 0.999


def test_most_of_a_mug_is_round_about_its_axis():
    mug = library.make("mug")
    turns = turns_about(mug)
    assert turns.shape == (1, AROUND - 1, 4, 4)
    logs = np.array([se3.log_rotation(turn[:3, :3]) for turn in turns[0]])
    assert np.abs(logs[:, :2]).max() < 0.01  # about z
    assert np.diff(np.unwrap(logs[:, 2] * np.sign(logs[0, 2]))) == pytest.approx(2.0 * np.pi / AROUND, abs=1e-4)
    points, _ = mug.sample_surface(400)
    for turn in turns[0]:
        off = np.abs(mug.field.distance(se3.apply(turn, points)))
        assert np.quantile(off, 0.7) < 0.001
        assert off.max() > 0.005  # and a handle is not


@pytest.mark.parametrize("name", ["hammer", "drill", "box", "bottle", "cylinder"])
def test_no_axis_of_roundness_where_there_is_none_or_it_is_declared(name):
    assert len(turns_about(library.make(name))) == 0


@pytest.mark.parametrize("name", ["ball", "can"])
def test_what_is_round_all_over_has_no_part_that_is_not(name):
    mesh = trimesh.creation.icosphere(3, 0.03) if name == "ball" else trimesh.creation.cylinder(0.03, 0.1)
    assert len(turns_about(ObjectModel.from_mesh(np.array(mesh.vertices), np.array(mesh.faces)))) == 0
