"""T1 table 5.1 again: the angle of principal axes against the tilt of four shapes pressed into a simulated pad."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fusion.benchmarks.arrays.grasps import LAYER, first_touch, pad, sensor_of
from fusion.benchmarks.printing.tables import Claim, Column, Report, Table
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from scenes.robot import tactile
from scenes.synthesis import shapes
from touch.arrays.descriptor import calibrate_alpha, describe
from touch.arrays.readings import Reading, alpha_of

Array = NDArray[np.float64]

TILTS, DEPTHS = (0.0, 2.0, 5.0, 7.0), (0.0006, 0.0011, 0.0016)
# Alpha is calibrated at other tilts (deg) and depths (m) than it is tried at.
CALIBRATION_TILTS, CALIBRATION_DEPTHS = (1.0, 3.0, 6.0), (0.0005, 0.0010, 0.0015)
# Pressure's power as the taxels' weight: T1's descriptor, and one that follows the middle of the contact.
POWERS = {"as published": 0.0, "weighted by pressure²": 2.0}
PADS = {"24 taxels, 3.2 mm": pad(8, 3, 0.0032, None), "169 taxels, 2 mm": pad(13, 13, 0.002, None)}
PUBLISHED = {
    "cylinder": (0.0, 0.9, 0.14, 0.42),
    "L-shape": (0.19, 0.50, 0.81, 0.68),
    "wide flat": (0.0, 0.4, 0.07, 0.5),
    "thin flat": (0.0, 0.07, 0.0, 0.62),
}


def shapes_pressed() -> dict[str, ObjectModel]:
    """The four shapes, metres: their undersides lie along x, lowest at the middle."""

    def bar(width: float) -> shapes.Mesh:
        corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * [0.03, 0.5 * width]
        return shapes.extrude(corners, 0.02)

    radius, length, arm, reach = 0.015, 0.06, 0.008, 0.03
    vertices, faces = shapes.revolve(
        [(0.0, -length / 2), (radius, -length / 2), (radius, length / 2), (0.0, length / 2)]
    )
    angle = np.array([[0, 0], [reach, 0], [reach, arm], [arm, arm], [arm, reach], [0, reach]]) - 0.5 * arm
    meshes = {
        "cylinder": (vertices @ se3.exp_rotation([0.0, np.pi / 2, 0.0]).T, faces),
        "L-shape": shapes.extrude(angle, 0.02),
        "wide flat": bar(0.03),
        "thin flat": bar(0.006),
    }
    return {name: ObjectModel.from_mesh(*mesh, name) for name, mesh in meshes.items()}


def pressed(model: ObjectModel, taxels: Array, tilt: float, depth: float) -> Reading:
    """The reading of a shape tilted about the pad's y axis by `tilt` (deg), `depth` (m) into the pad at its lowest."""
    sensor = sensor_of("pad", taxels)
    turn = se3.exp_rotation([0.0, np.deg2rad(tilt), 0.0])
    low = np.array([0.0, 0.0, model.vertices[:, 2].min()])
    object_from_pad = se3.inverse(se3.make_pose(turn, -turn @ low + [0.0, 0.0, 0.02]))
    up = object_from_pad[:3, 2]
    touching = first_touch(model, object_from_pad, sensor, up)
    touching[:3, 3] += depth * up
    pressure = tactile.pressures_at(model, touching, sensor)
    return Reading("pad", taxels, np.where(pressure < LAYER.threshold, 0.0, pressure), LAYER, np.eye(4))


def normal_of(tilt: float) -> Array:
    """(3,) out of the tilted shape's underside, the pad's frame."""
    return se3.exp_rotation([0.0, np.deg2rad(tilt), 0.0]) @ [0.0, 0.0, -1.0]


def tilt_error(reading: Reading, tilt: float, alpha: float, power: float) -> float:
    """Degrees between the third principal axis and the shape's normal in the plane of the tilt."""
    found = describe(reading, alpha, power)
    e3 = found.frame_from_tangent[:3, :3] @ found.basis[:, 2]
    return abs(float(np.degrees(np.arctan2(e3[0], e3[2]))) - tilt)


def add_angles(report: Report) -> None:
    """The table: for each pad and weighting the mean over depths and the worst, and the demands on the 24 taxels."""
    columns = [Column("pad"), Column("descriptor"), Column("alpha ÷ stiffness's"), Column("shape")]
    columns += [Column(f"{tilt:.0f}°") for tilt in TILTS] + [Column("worst"), Column("T1 worst")]
    table = Table("Principal angle error, degrees (T1 table 5.1)", columns)
    table.note = (
        "Mean over indentations of 0.6, 1.1 and 1.6 mm (worst: of all) into 2 mm of silicone. Alpha is chosen as T1 did"
        ", to lay principal axes along known shapes, but at tilts of 1, 3 and 6° and other depths than these."
    )
    models = shapes_pressed()
    for pad_name, taxels in PADS.items():
        known = [(m, t, d) for m in models.values() for t in CALIBRATION_TILTS for d in CALIBRATION_DEPTHS]
        calibration = [pressed(m, taxels, t, d) for m, t, d in known]
        normals = np.array([normal_of(t) for _, t, _ in known])
        readings = {(n, t): [pressed(m, taxels, t, d) for d in DEPTHS] for n, m in models.items() for t in TILTS}
        for label, power in POWERS.items():
            alpha = calibrate_alpha(calibration, normals, power)
            worst = 0.0
            for name in models:
                errors = np.array([[tilt_error(r, t, alpha, power) for r in readings[name, t]] for t in TILTS])
                ratio = alpha / alpha_of(LAYER)
                table.add(pad_name, label, ratio, name, *errors.mean(axis=1), errors.max(), max(PUBLISHED[name]))
                worst = max(worst, float(errors.mean(axis=1).max()))
            if power > 0:
                report.claims.append(Claim(f"principal angle, {pad_name}: worst mean error, °", worst, 1.0, False))
    report.tables.append(table)
