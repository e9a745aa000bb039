"""Symmetries found in meshes are those that the library declares, wherever and however the mesh lies."""

import numpy as np
import pytest
import trimesh

from scenes.evidence.symmetry.symmetry_detection import detect_symmetries
from scenes.geometry import poses
from scenes.geometry.objects import ObjectModel
from scenes.synthesis import library


def same_group(found, declared, centre):
    """Every declared motion is among the found ones and the other way round, to 2 degrees and 1 mm of the centre."""

    def covers(group, pose):
        nearest = group.nearest(np.eye(4), pose)
        delta = poses.difference(nearest, pose, centre)
        return np.linalg.norm(delta[:3]) < np.deg2rad(2.0) and np.linalg.norm(delta[3:]) < 1e-3

    return all(covers(found, p) for p in declared.poses(7)) and all(covers(declared, p) for p in found.poses(7))


@pytest.mark.parametrize("name", ["box", "cylinder", "sphere", "pencil", "bottle", "mug", "l_block"])
def test_the_library_s_symmetries_are_found(name):
    model = library.make(name)
    found = detect_symmetries(model)
    assert len(found.discrete) == len(model.symmetries.discrete)
    assert bool(found.axes) == bool(model.symmetries.axes)
    assert found.is_spherical == model.symmetries.is_spherical
    assert same_group(found, model.symmetries, model.centroid)


def test_a_cube_has_24_and_a_mesh_elsewhere_has_its_own_about_its_own_place():
    cube = trimesh.creation.box((0.08, 0.08, 0.08))
    assert len(detect_symmetries(ObjectModel.from_mesh(cube.vertices, cube.faces)).discrete) == 24
    box = library.make("box")
    moved = poses.make_pose(poses.exp_rotation([0.3, -0.7, 1.1]), [0.2, -0.1, 0.3])
    model = ObjectModel.from_mesh(poses.apply(moved, box.vertices), box.faces)
    found = detect_symmetries(model)
    assert len(found.discrete) == 4
    for member in found.discrete:
        conjugate = poses.inverse(moved) @ member @ moved
        delta = min(
            np.linalg.norm(poses.difference(conjugate, other, box.centroid)[:3]) for other in box.symmetries.discrete
        )
        assert delta < np.deg2rad(1.0)


def test_what_breaks_a_symmetry_is_seen():
    can = library.make("cylinder")
    knob = trimesh.creation.icosphere(subdivisions=2, radius=0.008)
    knob.apply_translation([0.038, 0.0, 0.03])
    vertices = np.concatenate([can.vertices, knob.vertices])
    faces = np.concatenate([can.faces, knob.faces + len(can.vertices)])
    assert detect_symmetries(ObjectModel.from_mesh(vertices, faces)).is_trivial
