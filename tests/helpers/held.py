"""Whether a grasp holds together: nothing inside anything, contacts on the surface; by an independent library."""

from __future__ import annotations

import igl
import numpy as np
import trimesh

from scenes.geometry import poses
from scenes.geometry.objects import ObjectModel
from scenes.robot.hands import Hand
from scenes.synthesis.grasping.grasps import Grasp


def exact_distance(model: ObjectModel, points: np.ndarray) -> np.ndarray:
    """Signed distance by fast winding numbers: no part of the package takes part."""
    kind = igl.SIGNED_DISTANCE_TYPE_FAST_WINDING_NUMBER
    return igl.signed_distance(points, model.vertices, model.faces, sign_type=kind)[0]


def check_grasp(hand: Hand, model: ObjectModel, grasp: Grasp, least: int) -> None:
    object_from_hand = poses.inverse(grasp.hand_from_object)
    samples = hand.points_on_surface(grasp.joints, 0.004)
    assert exact_distance(model, poses.apply(object_from_hand, samples)).min() > -1e-4

    tips = hand.hand_from_sensor(grasp.joints)
    for name, pose in tips.items():
        centre = poses.apply(object_from_hand, pose[None, :3, 3])
        assert exact_distance(model, centre)[0] > hand.sensors[name].radius - 1e-4

    # the object's corners against the links' volumes
    corners = poses.apply(grasp.hand_from_object, model.vertices)
    vertices, faces, link = hand.mesh(grasp.joints)
    for i in range(len(hand.link_names)):
        if not (link == i).any():
            continue
        piece = trimesh.Trimesh(vertices, faces[link == i])
        near = np.linalg.norm(corners - piece.bounds.mean(axis=0), axis=1) < np.linalg.norm(piece.extents)
        if near.any():
            normals, offsets = piece.face_normals, np.sum(piece.face_normals * piece.triangles_center, axis=1)
            assert (corners[near] @ normals.T - offsets).max(axis=1).min() > -1e-4, hand.link_names[i]

    contacts = grasp.contacts
    assert len(contacts) >= least
    assert len(set(contacts.sensors)) == len(contacts)
    points = poses.apply(object_from_hand, contacts.points)
    assert np.abs(exact_distance(model, points)).max() < 1e-4
    for point, normal, sensor in zip(contacts.points, contacts.normals, contacts.sensors):
        # the ball touches at the point and the normal leads from it to the ball's centre
        to_centre = tips[sensor][:3, 3] - point
        radius = hand.sensors[sensor].radius
        assert abs(np.linalg.norm(to_centre) - radius) < 1e-4
        np.testing.assert_allclose(normal, to_centre / np.linalg.norm(to_centre), atol=1e-6)
    outside = poses.apply(object_from_hand, contacts.points + 1e-3 * contacts.normals)
    assert exact_distance(model, outside).min() > 0.8e-3
    assert hand.limit_excess(grasp.joints, tolerance=1e-9) == {}
