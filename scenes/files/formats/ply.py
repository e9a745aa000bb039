"""Point clouds and meshes as binary PLY with float64 coordinates, so that what is written reads back bit for bit.

Reading goes through trimesh, which knows every PLY there is. Numbers stay in the file's unit and frame.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scenes.errors import MeshError
from scenes.files.formats.meshes import loaded
from scenes.files.whole import named

Array = NDArray[np.float64]


def write_ply(
    path: str | Path,
    points: ArrayLike,
    faces: ArrayLike | None = None,
    colours: ArrayLike | None = None,
    extra: Mapping[str, ArrayLike] | None = None,
) -> None:
    """Write points (n, 3), optional triangles (m, 3) and colours (n, 3) 0..255 as little-endian binary PLY, where
    nobody reads yet: `replace_file` of `ply_content` writes it whole or not at all.

    extra: further numbers of each point, name -> (n,), kept as 32-bit floats.
    """
    content = ply_content(path, points, faces, colours, extra)
    with named(Path(path)):
        Path(path).write_bytes(content)


def ply_content(
    path: str | Path,
    points: ArrayLike,
    faces: ArrayLike | None = None,
    colours: ArrayLike | None = None,
    extra: Mapping[str, ArrayLike] | None = None,
) -> bytes:
    """What `write_ply` writes; path: for messages."""
    points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    fields: list[tuple[str, str]] = [("x", "<f8"), ("y", "<f8"), ("z", "<f8")]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}"]
    header += ["property double x", "property double y", "property double z"]
    if colours is not None:
        fields += [("red", "u1"), ("green", "u1"), ("blue", "u1")]
        header += ["property uchar red", "property uchar green", "property uchar blue"]
    for name in extra or {}:
        fields += [(name, "<f4")]
        header += [f"property float {name}"]
    vertices = np.zeros(len(points), dtype=fields)
    for i, name in enumerate("xyz"):
        vertices[name] = points[:, i]
    if colours is not None:
        shades = np.asarray(colours, dtype=np.uint8)
        if shades.shape != points.shape:
            raise MeshError(f"{path}: expected colours of shape {points.shape}, got {shades.shape}")
        for i, name in enumerate(("red", "green", "blue")):
            vertices[name] = shades[:, i]
    for name, values in (extra or {}).items():
        vertices[name] = np.broadcast_to(np.asarray(values, dtype=np.float32), len(points))
    body = vertices.tobytes()
    if faces is not None:
        triangles = np.asarray(faces, dtype=np.int64).reshape(-1, 3)
        header += [f"element face {len(triangles)}", "property list uchar int vertex_indices"]
        rows = np.zeros(len(triangles), dtype=[("size", "u1"), ("corners", "<i4", (3,))])
        rows["size"] = 3
        rows["corners"] = triangles
        body += rows.tobytes()
    return "\n".join([*header, "end_header", ""]).encode("ascii") + body


def read_cloud(path: str | Path) -> tuple[Array, NDArray[np.uint8] | None]:
    """Points (n, 3) and colours (n, 3) or None of a PLY (a mesh gives its vertices) or OFF file.

    Rows that are not finite are dropped: cameras write NaN where they saw nothing. Raises MeshError for a file that is
    not readable or has no finite point.
    """
    path = Path(path)
    if path.suffix.lower() == ".off":
        from scenes.files.formats.off import read_off

        data = read_off(path)
        points, colours = data.points, data.colours
    else:
        points, colours = _read_with_trimesh(path)
    finite = np.isfinite(points).all(axis=1)
    if not finite.any():
        raise MeshError(f"{path}: expected a point cloud, got {len(points)} points, none of them finite")
    return points[finite], None if colours is None else colours[finite]


def _read_with_trimesh(path: Path) -> tuple[Array, NDArray[np.uint8] | None]:
    if not path.is_file():
        raise MeshError(f"{path}: expected a point cloud, found no file")
    try:
        cloud = loaded(path)
    except ValueError as error:
        raise MeshError(f"{path}: expected a point cloud, got {error}") from error
    vertices = getattr(cloud, "vertices", None)
    if vertices is None or np.ndim(vertices) != 2:
        raise MeshError(f"{path}: expected a point cloud, got a file without points")
    points = np.array(vertices, dtype=np.float64)
    visual = getattr(cloud, "visual", None)
    kind = getattr(visual, "kind", None)
    shades = getattr(cloud, "colors", None) if not hasattr(cloud, "faces") else None
    if shades is None and kind == "vertex":
        shades = getattr(visual, "vertex_colors", None)
    if shades is None or np.ndim(shades) != 2 or len(shades) != len(points):
        return points, None
    return points, np.array(shades, dtype=np.uint8)[:, :3]
