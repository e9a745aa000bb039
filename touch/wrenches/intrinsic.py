"""Contacts of a frame from the wrenches that its fingertips measure."""

from __future__ import annotations

from typing import Any

import numpy as np

from scenes.errors import CaptureError
from scenes.recordings.frames import DEFAULT_SIGMA_NORMAL, DEFAULT_SIGMA_POINT, Contacts, Frame
from scenes.robot.sensors import surface_hull
from touch.wrenches.fingertips import SoftSkin, tip_contacts


def wrench_contacts(frame: Frame) -> Contacts:
    """Contacts (world frame) from a frame's wrenches; sensors that feel nothing (or pull) give none.

    Raises CaptureError for wrenches without a hand, joints or a surface to solve on.
    """
    if not frame.wrenches:
        return Contacts.none()
    if frame.hand is None or frame.joints is None or frame.world_from_hand is None:
        raise CaptureError(f"{frame.where}: wrenches need a hand, its joints and its pose to become contacts")
    hand_from_sensor = frame.hand.hand_from_sensor(frame.joints)
    points, normals, names, forces = [], [], [], []
    for wrench in frame.wrenches:
        sensor = frame.hand.sensors.get(wrench.sensor)
        if sensor is None:
            known = ", ".join(frame.hand.sensors)
            raise CaptureError(f"{frame.where}: expected a sensor of the hand ({known}), got {wrench.sensor}")
        if sensor.surface is None:
            raise CaptureError(f"{frame.where}: sensor {wrench.sensor} needs a surface to solve its wrench on")
        surface = _with_mesh(sensor.surface, f"{frame.where}: sensor {wrench.sensor}")
        found = tip_contacts(wrench.force, wrench.torque, surface, SoftSkin.parse(sensor.soft_layer))
        if not found.valid[0]:
            continue
        world_from_sensor = frame.world_from_hand @ hand_from_sensor[wrench.sensor]
        points.append(world_from_sensor[:3, :3] @ found.points[0] + world_from_sensor[:3, 3])
        # the fingertip's outward normal looks into the object: the object's looks back
        normals.append(world_from_sensor[:3, :3] @ -found.normals[0])
        forces.append(world_from_sensor[:3, :3] @ wrench.force)
        names.append(wrench.sensor)
    if not points:
        return Contacts.none()
    return Contacts(points, normals, np.full(len(points), DEFAULT_SIGMA_POINT), DEFAULT_SIGMA_NORMAL, names, forces)


def _with_mesh(surface: dict[str, dict[str, Any]], where: str) -> dict[str, dict[str, Any]]:
    """The surface; a mesh with its convex hull's vertices and faces beside the name of its file."""
    if "mesh" not in surface or "vertices" in surface["mesh"]:
        return surface
    return {"mesh": dict(zip(("vertices", "faces"), surface_hull(surface, where)))}
