"""Grippers and hands of each common kind, made from boxes: what their URDFs look like, without anybody's meshes.

Palm at the origin, fingers along z; metres.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from scenes.geometry import poses
from scenes.robot.hands import Hand
from scenes.robot.sensors import Sensor

BOX = '<link name="{}"><visual><origin xyz="{} {} {}"/><geometry><box size="{} {} {}"/></geometry></visual></link>'
JOINT = (
    '<joint name="{}" type="{}"><parent link="{}"/><child link="{}"/><origin xyz="{}" rpy="{}"/>'
    '<axis xyz="{}"/><limit lower="{}" upper="{}" effort="1" velocity="1"/>{}</joint>'
)


def box(name, at, size) -> str:
    return BOX.format(name, *at, *size)


def joint(name, kind, parent, child, at, axis, low, high, rpy="0 0 0", follow="") -> str:
    return JOINT.format(name, kind, parent, child, " ".join(map(str, at)), rpy, axis, low, high, follow)


def mimic(of, factor=1.0) -> str:
    return f'<mimic joint="{of}" multiplier="{factor}"/>'


def load(folder: Path, name: str, parts: list[str], tips: dict[str, tuple[str, tuple, float]]) -> Hand:
    """Written, and read as anybody's: tips by sensor name: link, place in it, radius of the ball."""
    path = folder / f"{name}.urdf"
    path.write_text(f'<robot name="{name}">{"".join(parts)}</robot>')
    sensors = {
        sensor: Sensor(sensor, link, "point", poses.make_pose(None, at), {"sphere": {"radius": radius}})
        for sensor, (link, at, radius) in tips.items()
    }
    return Hand(Hand.load(path).robot, sensors)


PADS = {"left_pad": ("left", (0, 0, 0.05), 0.009), "right_pad": ("right", (0, 0, 0.05), 0.009)}


def sliding(folder: Path, one_drive: bool = True, rising_opens: bool = True) -> Hand:
    """Two fingers that slide apart along y, 80 mm at most, zero closed (or, the other way, zero open)."""
    out = 1 if rising_opens else -1
    start = 0.009 if rising_opens else 0.049
    follow = mimic("slide_left") if one_drive else ""
    parts = [
        box("palm", (0, 0, -0.03), (0.06, 0.2, 0.06)),
        box("left", (0, 0, 0.025), (0.016, 0.016, 0.05)),
        box("right", (0, 0, 0.025), (0.016, 0.016, 0.05)),
        joint("slide_left", "prismatic", "palm", "left", (0, start, 0.01), f"0 {out} 0", 0, 0.04),
        joint("slide_right", "prismatic", "palm", "right", (0, -start, 0.01), f"0 {-out} 0", 0, 0.04, follow=follow),
    ]
    return load(folder, "sliding", parts, PADS)


def turning(folder: Path, sign: int = 1) -> Hand:
    """Two parallelogram fingers by one drive, as adaptive grippers have them: knuckle turns, fingertip stays upright.

    Zero is open, 125 mm between the pads; the drive closes with `sign`.
    """
    low, high = sorted((0.0, sign * 0.85))
    parts = [box("palm", (0, 0, -0.04), (0.07, 0.14, 0.06))]
    for side, y, way in (("left", 0.045, 1), ("right", -0.045, -1)):
        axis = f"{sign * way} 0 0"
        parts += [
            box(f"{side}_knuckle", (0, 0, 0.03), (0.012, 0.01, 0.05)),
            box(side, (0, 0, 0.025), (0.018, 0.012, 0.05)),
            box(f"{side}_rod", (0, 0, 0.02), (0.006, 0.006, 0.03)),
        ]
        follow = "" if side == "left" else mimic("drive")
        name = "drive" if side == "left" else "right_knuckle_joint"
        lean = f"{-way * 0.45} 0 0"
        parts += [
            joint(name, "revolute", "palm", f"{side}_knuckle", (0, y, 0.0), axis, low, high, lean, follow),
            joint(f"{side}_tip", "revolute", f"{side}_knuckle", side, (0, 0, 0.06), axis, -high, -low,
                  f"{way * 0.45} 0 0", mimic("drive", -1.0)),
            joint(f"{side}_rod_joint", "revolute", "palm", f"{side}_rod", (0, 0.4 * y, 0.0), axis, low, high, lean,
                  mimic("drive")),
        ]  # fmt: skip
    return load(folder, "turning", parts, PADS)


def three_fingers(folder: Path, spread: bool = True, sign: int = 1) -> Hand:
    """Two fingers against one, each with a driven joint and a second that follows it; the two spread together."""
    low, high = sorted((0.0, sign * 1.9))
    parts = [box("palm", (0, 0, -0.03), (0.09, 0.09, 0.05))]
    tips = {}
    for number, (x, y, facing) in enumerate(((0.028, -0.03, 0.0), (-0.028, -0.03, 0.0), (0.0, 0.03, np.pi))):
        name = f"f{number + 1}"
        base, at = "palm", (x, y, 0.0)
        if spread and number < 2:
            parts += [
                box(f"{name}_base", (0, 0, 0.0), (0.016, 0.016, 0.012)),
                joint(f"{name}_turn", "revolute", "palm", f"{name}_base", at, f"0 0 {1 - 2 * number}", 0, 1.5,
                      follow="" if number == 0 else mimic("f1_turn")),
            ]  # fmt: skip
            base, at = f"{name}_base", (0, 0, 0)
        parts += [
            box(f"{name}_near", (0, 0, 0.035), (0.014, 0.014, 0.06)),
            box(f"{name}_far", (0, 0, 0.02), (0.012, 0.012, 0.036)),
            joint(f"{name}_near_joint", "revolute", base, f"{name}_near", at, f"{-sign} 0 0", low, high,
                  f"0.6 0 {facing}" if facing else "0.6 0 0"),
            joint(f"{name}_far_joint", "revolute", f"{name}_near", f"{name}_far", (0, 0, 0.07), f"{-sign} 0 0",
                  *sorted((0.0, sign * 0.7)), follow=mimic(f"{name}_near_joint", 0.33)),
        ]  # fmt: skip
        tips[f"{name}_tip"] = (f"{name}_far", (0, 0, 0.042), 0.008)
    return load(folder, "three", parts, tips)
