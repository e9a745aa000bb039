"""The formats that `palpate convert` reads and writes, and which of its options each of them uses."""

from __future__ import annotations

import argparse

SOURCES = {
    "bop": "scene folder of a BOP data set",
    "ycbineoat": "sequence folder: cam_K.txt, rgb/, depth/, annotated_poses/",
    "ros": "ROS 1 .bag, ROS 2 folder, .mcap or .db3, with --topics",
    "tacman": ".ini of a contact set with its .off files",
    "handover": "cloud.off, contacts.off, model.off, or a folder of such folders",
    "digit": "grasps of DIGITs: Image_heatmap_K.png, poses_sensors.txt, background.png",
    "feelsight": "a log folder: data.pkl, realsense/, allegro/; --hand for its fingers",
    "contacts": "contacts as .off, .ply or .csv, with --object",
    "images": "rgb/ and depth/ with camera.json or --intrinsics",
}
TARGETS = {
    "bop": "BOP data set",
    "glb": "3-D scene as binary glTF",
    "tum": "trajectory, timestamp tx ty tz qx qy qz qw",
    "off": "point lists and mesh",
}
# What lists of points and meshes are, which become one another and no capture.
TABLE = "table"
# Options of recordings, and of what captures become, each with the formats that use it.
OF_SOURCES = {
    "object": tuple(name for name in SOURCES if name != "handover"),
    "object_id": ("bop", "tacman"),
    "instance": ("bop",),
    "models": ("bop",),
    "hand": ("feelsight",),
    "topics": ("ros",),
    "intrinsics": ("images", "ros"),
    "depth_scale": ("images", "ycbineoat"),
    "frame": ("contacts", TABLE),
}
OF_TARGETS = {"result": ("glb", "tum"), "frame": ("glb",), "fps": ("tum",)}


def refuse_unused(args: argparse.Namespace, source: str | None = None, target: str | None = None) -> None:
    """Raise InputError for an option that the format `source` of a recording, or `target` of a capture, does not use:
    who gives it believes that it does something.
    """
    from scenes.errors import InputError

    got = source or target
    found = f"{args.source}, converted {'from' if source else 'to'} {got}"
    for name in {**OF_SOURCES, **OF_TARGETS}:
        sides = {"from": OF_SOURCES.get(name, ()), "to": OF_TARGETS.get(name, ())}
        if getattr(args, name) is not None and got not in sides["from" if source else "to"]:
            wanted = " or ".join(f"{side} {' or '.join(users)}" for side, users in sides.items() if users)
            option = f"--{name.replace('_', '-')}"
            raise InputError(f"{option}: expected a conversion {wanted}, which use it, got {found}")
