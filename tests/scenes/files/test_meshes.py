"""Meshes as they are found: what the readers grumble about is not on a user's standard error."""

from __future__ import annotations

import logging
import os
import subprocess
import sys

import pytest

from scenes.errors import MeshError
from scenes.files.formats.meshes import loaded
from scenes.geometry.objects import ObjectModel
from scenes.synthesis.library import make


def ply(picture: str, scale: float = 1.0) -> str:
    """A box whose faces are said to be printed with a picture."""
    box = make("box")
    head = ["ply", "format ascii 1.0", f"comment TextureFile {picture}", f"element vertex {len(box.vertices)}"]
    head += [f"property float {axis}" for axis in "xyz"]
    head += [f"element face {len(box.faces)}", "property list uchar int vertex_indices"]
    head += ["property list uchar float texcoord", "end_header"]
    points = [" ".join(map(repr, row)) for row in (scale * box.vertices).tolist()]
    faces = [f"3 {a} {b} {c} 6 0 0 0 1 1 1" for a, b, c in box.faces.tolist()]
    return "\n".join([*head, *points, *faces, ""])


def obj(scale: float = 1.0) -> str:
    """A box with a material in a file that is not there."""
    box = make("box")
    points = ["v " + " ".join(map(repr, row)) for row in (scale * box.vertices).tolist()]
    faces = [f"f {a}/1 {b}/1 {c}/1" for a, b, c in (box.faces + 1).tolist()]
    return "\n".join(["mtllib gone.mtl", *points, "vt 0 0", "usemtl red", *faces, ""])


@pytest.mark.parametrize("name", ["gone.ply", "broken.ply", "gone.obj"])
def test_a_picture_or_material_that_is_not_there_is_no_traceback(tmp_path, name):
    """In a process of its own: pytest would listen to the loggers itself."""
    path = tmp_path / name
    (tmp_path / "broken.png").write_bytes(b"none")
    path.write_text(obj() if name.endswith(".obj") else ply(name.replace(".ply", ".png")))
    environment = os.environ | {"PALPATE_CACHE": str(tmp_path / "cache")}
    code = f"from scenes.geometry.objects import ObjectModel; ObjectModel.load({str(path)!r})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_what_a_reader_warns_of_is_information(tmp_path, caplog):
    path = tmp_path / "box.ply"
    path.write_text(ply("gone.png"))
    with caplog.at_level(logging.INFO):
        assert len(loaded(path).faces) == len(make("box").faces)
    assert [(r.name, r.levelname, r.exc_info) for r in caplog.records] == [
        ("scenes.files.formats.meshes", "INFO", None)
    ]
    assert caplog.messages == [f"{path}: unable to load image!"]
    assert logging.getLogger("trimesh").propagate


@pytest.mark.parametrize("scale", [1e40, 1e200, 1e307])
def test_numbers_beyond_all_bounds_are_one_line(tmp_path, recwarn, scale):
    path = tmp_path / "huge.obj"
    path.write_text(obj(scale))
    with pytest.raises(MeshError):
        ObjectModel.load(path)
    assert not [warning for warning in recwarn if issubclass(warning.category, RuntimeWarning)]
