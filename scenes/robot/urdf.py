"""URDF in and out: links with geometry and the joints between them, as plain data. Metres and radians, as in URDF.

What a camera sees is kept: a link's `visual` geometry, or its `collision` geometry when it has no visual one.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenes.cache import Arrays, are_triangles, remembered, remembered_of_file
from scenes.errors import InputError
from scenes.files.formats.meshes import loaded
from scenes.files.inside import stays_inside
from scenes.files.problems import UNREADABLE
from scenes.geometry import poses

Array = NDArray[np.float64]
Faces = NDArray[np.int64]

MOVING = ("revolute", "continuous", "prismatic")
# Corners around a cylinder or sphere read from a URDF: 24 keeps the chord within 1 % of the radius.
ROUND_SECTIONS = 24
# Radians beyond which an angle is none: of a million a double knows the turn to ten digits.
MOST_TURNED = 1e6
# Metres beyond which a shape's extent, or an origin, is in another unit: a finger's size in millimetres is above the
# one, its place above the other; an arm's links and where it stands are below both.
LARGEST, FARTHEST = 5.0, 20.0
# Raised whenever reading or making a shape's triangles changes, so that old cache entries are not read.
MESH_VERSION = 1


@dataclass(frozen=True)
class Shape:
    """One piece of a link. kind: "mesh", "box", "cylinder" or "sphere"; size: box extents (x, y, z), cylinder
    (radius, length), sphere (radius,), empty for a mesh; vertices (n, 3) and faces (m, 3) in the link's frame.
    """

    kind: str
    size: tuple[float, ...]
    link_from_shape: Array
    vertices: Array
    faces: Faces


@dataclass(frozen=True)
class Mimic:
    """value = multiplier * value of `joint` + offset."""

    joint: str
    multiplier: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class Joint:
    """kind: "fixed", "revolute", "continuous" or "prismatic"; parent_from_joint (4, 4) at value 0; axis (3,) unit in
    the joint's frame, which is the child link's frame; limits in radians or metres, infinite for continuous.
    """

    name: str
    kind: str
    parent: str
    child: str
    parent_from_joint: Array
    axis: Array
    lower: float = 0.0
    upper: float = 0.0
    mimic: Mimic | None = None


@dataclass(frozen=True)
class Robot:
    """A kinematic tree: links (name -> shapes, the root first, parents before children) and joints (same order)."""

    name: str
    root: str
    links: dict[str, tuple[Shape, ...]]
    joints: tuple[Joint, ...]


def read_urdf(path: str | Path, within: Path | None = None) -> Robot:
    """Read a URDF file and the meshes that it names.

    `package://` and relative mesh paths are looked for in the file's folder. within: a folder out of which no mesh may
    lie (CaptureError); by default anywhere. Raises InputError with one line for
    anything that is not a tree of links with geometry: malformed XML, no geometry at all, unknown joint kinds,
    missing meshes, several roots, cycles, unknown names.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: expected a URDF file, found none")
    try:
        root = ET.parse(path).getroot()
    except (ET.ParseError, UnicodeDecodeError, ValueError, LookupError) as error:
        raise InputError(f"{path}: expected XML, got malformed text: {error}") from error
    where = str(path)
    if root.tag != "robot":
        raise InputError(f"{where}: expected a <robot> element, got <{root.tag}>")
    if any("xacro" in str(element.tag) for element in root.iter()):
        raise InputError(f"{where}: expected plain URDF, got xacro macros: expand them with the xacro tool first")
    links: dict[str, tuple[Shape, ...]] = {}
    for element in root.findall("link"):
        name = _attribute(element, "name", where)
        if name in links:
            raise InputError(f"{where}: link {name!r}: expected one definition, got two")
        visual = element.findall("visual") or element.findall("collision")
        links[name] = tuple(_read_shape(piece, path, f"{where}: link {name!r}", within) for piece in visual)
    if not links:
        raise InputError(f"{where}: expected at least one link, got none")
    if not any(links.values()):
        raise InputError(f"{where}: expected links with geometry, got {len(links)} links without any")
    joints = [_read_joint(element, where) for element in root.findall("joint")]
    top, ordered = _order(links, joints, where)
    _check_mimics(ordered, where)
    names = [top, *(joint.child for joint in ordered)]
    return Robot(root.get("name") or path.stem, top, {name: links[name] for name in names}, tuple(ordered))


def write_urdf(path: str | Path, robot: Robot) -> None:
    """Write the robot; mesh shapes go to `meshes/LINK_0.stl` (binary) in the same folder."""
    path = Path(path)
    root = ET.Element("robot", name=robot.name)
    for name, shapes in robot.links.items():
        link = ET.SubElement(root, "link", name=name)
        for number, shape in enumerate(shapes):
            for tag in ("visual", "collision"):
                piece = ET.SubElement(link, tag)
                _write_origin(piece, shape.link_from_shape)
                geometry = ET.SubElement(piece, "geometry")
                if shape.kind == "mesh":
                    file = Path("meshes") / f"{name}_{number}.stl"
                    ET.SubElement(geometry, "mesh", filename=file.as_posix())
                    if tag == "visual":
                        _write_mesh(path.parent / file, shape)
                elif shape.kind == "box":
                    ET.SubElement(geometry, "box", size=_numbers(shape.size))
                elif shape.kind == "cylinder":
                    ET.SubElement(geometry, "cylinder", radius=repr(shape.size[0]), length=repr(shape.size[1]))
                else:
                    ET.SubElement(geometry, "sphere", radius=repr(shape.size[0]))
    for joint in robot.joints:
        element = ET.SubElement(root, "joint", name=joint.name, type=joint.kind)
        _write_origin(element, joint.parent_from_joint)
        ET.SubElement(element, "parent", link=joint.parent)
        ET.SubElement(element, "child", link=joint.child)
        if joint.kind in MOVING:
            ET.SubElement(element, "axis", xyz=_numbers(joint.axis))
        if joint.kind in ("revolute", "prismatic"):
            lower, upper = repr(float(joint.lower)), repr(float(joint.upper))
            ET.SubElement(element, "limit", lower=lower, upper=upper, effort="1.0", velocity="1.0")
        if joint.mimic is not None:
            factor, offset = repr(float(joint.mimic.multiplier)), repr(float(joint.mimic.offset))
            ET.SubElement(element, "mimic", joint=joint.mimic.joint, multiplier=factor, offset=offset)
    ET.indent(root)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text('<?xml version="1.0"?>\n' + ET.tostring(root, encoding="unicode") + "\n", encoding="utf-8")


def make_shape(kind: str, size: tuple[float, ...], link_from_shape: Array | None = None) -> Shape:
    """A box (x, y, z), cylinder (radius, length along z) or sphere (radius,), centred on its frame, as triangles."""

    def make() -> Arrays:
        import trimesh

        if kind == "box":
            mesh = trimesh.creation.box(extents=size)
        elif kind == "cylinder":
            mesh = trimesh.creation.cylinder(radius=size[0], height=size[1], sections=ROUND_SECTIONS)
        else:
            mesh = trimesh.creation.uv_sphere(radius=size[0], count=[ROUND_SECTIONS // 2, ROUND_SECTIONS])
        return {"vertices": np.array(mesh.vertices), "faces": np.array(mesh.faces, dtype=np.int64)}

    pose = np.eye(4) if link_from_shape is None else link_from_shape
    made = remembered(
        "shape", (MESH_VERSION, kind, ROUND_SECTIONS), [np.array(size, dtype=np.float64)], make, are_triangles
    )
    return Shape(kind, size, pose, poses.apply(pose, made["vertices"]), made["faces"])


def mesh_shape(vertices: Array, faces: Faces, link_from_shape: Array | None = None) -> Shape:
    """A mesh piece: vertices (n, 3) metres in the shape's frame, faces (m, 3)."""
    pose = np.eye(4) if link_from_shape is None else link_from_shape
    return Shape("mesh", (), pose, poses.apply(pose, vertices), np.asarray(faces, dtype=np.int64))


def _attribute(element: ET.Element, key: str, where: str) -> str:
    value = element.get(key)
    if not value:
        raise InputError(f"{where}: <{element.tag}>: expected an attribute {key!r}, got none")
    return value


def _vector(text: str | None, count: int, default: tuple[float, ...], where: str) -> Array:
    if text is None:
        return np.array(default)
    try:
        values = np.array([float(word) for word in text.split()])
    except ValueError:
        values = np.full(count, np.nan)
    if values.shape != (count,) or not np.isfinite(values).all():
        raise InputError(f"{where}: expected {count} numbers, got {text!r}")
    return values


def _origin(element: ET.Element, where: str) -> Array:
    origin = element.find("origin")
    if origin is None:
        return np.eye(4)
    xyz = _vector(origin.get("xyz"), 3, (0.0, 0.0, 0.0), f"{where}: origin xyz")
    roll, pitch, yaw = angles = _vector(origin.get("rpy"), 3, (0.0, 0.0, 0.0), f"{where}: origin rpy")
    if np.abs(angles).max() > MOST_TURNED:
        raise InputError(f"{where}: origin rpy: expected radians, got {float(np.abs(angles).max()):.3g}")
    if np.abs(xyz).max() > FARTHEST:
        raise InputError(f"{where}: origin xyz: expected metres, got {float(np.abs(xyz).max()):.3g}: mm read as m?")
    x, y, z = np.eye(3)
    turn = poses.exp_rotation(z * yaw) @ poses.exp_rotation(y * pitch) @ poses.exp_rotation(x * roll)
    return poses.make_pose(turn, xyz)


def _read_shape(piece: ET.Element, path: Path, where: str, within: Path | None) -> Shape:
    pose = _origin(piece, where)
    geometry = piece.find("geometry")
    element = geometry[0] if geometry is not None and len(geometry) else None
    if element is None:
        raise InputError(f"{where}: <{piece.tag}>: expected a <geometry> with a shape, got none")
    if element.tag == "mesh":
        vertices, faces = _read_mesh(_attribute(element, "filename", where), path, where, within)
        scale = _vector(element.get("scale"), 3, (1.0, 1.0, 1.0), f"{where}: mesh scale")
        if not scale.all():
            raise InputError(f"{where}: mesh scale: expected numbers other than 0, got {element.get('scale')!r}")
        if np.prod(scale) < 0:
            faces = faces[:, ::-1]  # a mirrored mesh keeps its outside
        vertices = vertices * scale
        _check_extent(float(np.ptp(vertices, axis=0).max()), where)
        return mesh_shape(vertices, faces, pose)
    keys = {"box": ("size",), "cylinder": ("radius", "length"), "sphere": ("radius",)}.get(str(element.tag))
    if keys is None:
        raise InputError(f"{where}: expected geometry mesh, box, cylinder or sphere, got {element.tag!r}")
    count = 3 if element.tag == "box" else 1
    size = tuple(
        float(x) for key in keys for x in _vector(_attribute(element, key, where), count, (), f"{where}: {key}")
    )
    if min(size) <= 0:
        raise InputError(f"{where}: {element.tag}: expected sizes above 0, got {size}")
    _check_extent(max(size), where)
    return make_shape(element.tag, size, pose)


def _check_extent(extent: float, where: str) -> None:
    if not extent <= LARGEST:
        raise InputError(f"{where}: expected a shape of {LARGEST:g} m at most, got {extent:.3g} m: mm read as m?")


def _read_mesh(filename: str, path: Path, where: str, within: Path | None) -> tuple[Array, Faces]:
    file = _find_mesh(filename, path)
    if file is None:
        raise InputError(f"{where}: expected the mesh file {filename!r} beside {path.name}, found none")
    stays_inside(file, within, where)

    def make() -> Arrays:
        mesh = loaded(file, force="mesh")
        # STL repeats the corners of each triangle
        mesh.merge_vertices(merge_tex=True, merge_norm=True)
        return {
            "vertices": np.array(mesh.vertices, dtype=np.float64),
            "faces": np.array(mesh.faces, dtype=np.int64).reshape(-1, 3),
        }

    try:
        made = remembered_of_file("link", MESH_VERSION, file, make, are_triangles)
        vertices, faces = made["vertices"], made["faces"]
    except UNREADABLE as error:
        hint = ": convert it to STL" if isinstance(error.__cause__, ImportError) else ""
        raise InputError(f"{file}: expected a mesh, got {error}{hint}") from error
    if len(faces) == 0 or not np.isfinite(vertices).all():
        raise InputError(f"{file}: expected a mesh of triangles with finite vertices, got {len(faces)} triangles")
    return vertices, faces


def _find_mesh(filename: str, path: Path) -> Path | None:
    """The file of a mesh reference; a package's name may or may not be a folder beside the URDF."""
    folder = path.parent
    if filename.startswith(("package://", "model://")):
        inside = filename.split("://", 1)[1]
        without_package = inside.split("/", 1)[-1]
        candidates = [folder / inside, folder / without_package]
        candidates += [folder.parent / inside, folder.parent / without_package]
    else:
        candidates = [folder / filename.removeprefix("file://")]
    return next((file for file in candidates if file.is_file()), None)


def _read_joint(element: ET.Element, where: str) -> Joint:
    name = _attribute(element, "name", where)
    where = f"{where}: joint {name!r}"
    kind = _attribute(element, "type", where)
    if kind not in (*MOVING, "fixed"):
        raise InputError(f"{where}: expected type fixed, {', '.join(MOVING)}, got {kind!r}")
    ends = {}
    for tag in ("parent", "child"):
        end = element.find(tag)
        if end is None:
            raise InputError(f"{where}: expected a <{tag}> link, got none")
        ends[tag] = _attribute(end, "link", where)
    axis_element = element.find("axis")
    text = None if axis_element is None else axis_element.get("xyz")
    axis = _vector(text, 3, (1.0, 0.0, 0.0), f"{where}: axis")
    length = float(np.linalg.norm(axis))
    if length < 1e-9:
        raise InputError(f"{where}: expected an axis with a direction, got {axis}")
    lower, upper = (-np.inf, np.inf) if kind == "continuous" else (0.0, 0.0)
    if kind in ("revolute", "prismatic"):
        limit = element.find("limit")
        if limit is None:
            raise InputError(f"{where}: expected a <limit> with lower and upper, got none")
        lower = float(_vector(limit.get("lower"), 1, (0.0,), f"{where}: lower limit")[0])
        upper = float(_vector(limit.get("upper"), 1, (0.0,), f"{where}: upper limit")[0])
        if upper < lower:
            raise InputError(f"{where}: expected lower limit below upper, got {lower} and {upper}")
    mimic = None
    coupled = element.find("mimic")
    if coupled is not None and kind != "fixed":
        factor = float(_vector(coupled.get("multiplier"), 1, (1.0,), f"{where}: mimic multiplier")[0])
        offset = float(_vector(coupled.get("offset"), 1, (0.0,), f"{where}: mimic offset")[0])
        mimic = Mimic(_attribute(coupled, "joint", where), factor, offset)
    return Joint(name, kind, ends["parent"], ends["child"], _origin(element, where), axis / length, lower, upper, mimic)


def _order(links: dict[str, tuple[Shape, ...]], joints: list[Joint], where: str) -> tuple[str, list[Joint]]:
    """The root link, and the joints with parents before children; refuses what is not one tree."""
    parents: dict[str, Joint] = {}
    seen: set[str] = set()
    for joint in joints:
        for link in (joint.parent, joint.child):
            if link not in links:
                raise InputError(f"{where}: joint {joint.name!r}: expected a link of this file, got {link!r}")
        if joint.name in seen:
            raise InputError(f"{where}: joint {joint.name!r}: expected one definition, got two")
        if joint.child in parents:
            other = parents[joint.child].name
            raise InputError(f"{where}: link {joint.child!r}: expected one parent joint, got {other!r}, {joint.name!r}")
        seen.add(joint.name)
        parents[joint.child] = joint
    roots = [name for name in links if name not in parents]
    if len(roots) != 1:
        got = "a cycle" if not roots else f"{len(roots)}: {', '.join(roots[:4])}"
        raise InputError(f"{where}: expected one root link, got {got}")
    ordered: list[Joint] = []
    frontier = [roots[0]]
    while frontier:
        link = frontier.pop(0)
        children = [joint for joint in joints if joint.parent == link]
        ordered += children
        frontier += [joint.child for joint in children]
    if len(ordered) < len(joints):
        lost = sorted({j.child for j in joints} - {j.child for j in ordered})
        raise InputError(f"{where}: expected a tree of links, got a cycle through {', '.join(lost[:4])}")
    return roots[0], ordered


def _check_mimics(joints: list[Joint], where: str) -> None:
    by_name = {joint.name: joint for joint in joints}
    for joint in joints:
        visited = [joint.name]
        current = joint
        while current.mimic is not None:
            master = by_name.get(current.mimic.joint)
            if master is None or master.kind == "fixed":
                got = current.mimic.joint
                raise InputError(f"{where}: joint {current.name!r}: expected to mimic a moving joint, got {got!r}")
            if master.name in visited:
                raise InputError(f"{where}: joint {joint.name!r}: expected a joint to follow, got a circle of mimics")
            visited.append(master.name)
            current = master


def _numbers(values: tuple[float, ...] | Array) -> str:
    return " ".join(repr(float(value)) for value in values)


def _write_origin(element: ET.Element, pose: Array) -> None:
    r = pose[:3, :3]
    level = float(np.hypot(r[0, 0], r[1, 0]))
    if level > 1e-9:
        angles = np.arctan2(r[2, 1], r[2, 2]), np.arctan2(-r[2, 0], level), np.arctan2(r[1, 0], r[0, 0])
    else:  # pitch of a quarter turn: roll and yaw turn about the same axis, so yaw is chosen 0
        angles = np.arctan2(-r[1, 2], r[1, 1]), np.arctan2(-r[2, 0], level), 0.0
    ET.SubElement(element, "origin", xyz=_numbers(pose[:3, 3]), rpy=_numbers(tuple(float(a) for a in angles)))


def _write_mesh(path: Path, shape: Shape) -> None:
    import trimesh

    path.parent.mkdir(parents=True, exist_ok=True)
    vertices = poses.apply(poses.inverse(shape.link_from_shape), shape.vertices)
    trimesh.Trimesh(vertices, shape.faces, process=False).export(path, file_type="stl")
