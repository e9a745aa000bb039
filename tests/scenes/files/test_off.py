"""OFF files: what the wild holds reads, what is broken is refused with its line, what is written reads back."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from scenes.errors import MeshError
from scenes.files.formats.off import read_off, write_off

DATA = Path(os.environ.get("PALPATE_DATA", Path(__file__).resolve().parents[3].parent / "shared" / "data"))

CUBE = "0 0 0\n1 0 0\n1 1 0\n0 1 0\n0 0 1\n1 0 1\n1 1 1\n0 1 1\n"
QUADS = "4 0 3 2 1\n4 4 5 6 7\n4 0 1 5 4\n4 1 2 6 5\n4 2 3 7 6\n4 3 0 4 7\n"


def read(tmp_path: Path, text: str | bytes):
    path = tmp_path / "thing.off"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_off(path)


@pytest.mark.parametrize(
    "text",
    [
        "OFF\n8 6 12\n" + CUBE + QUADS,
        "OFF 8 6 0\n" + CUBE + QUADS,
        "OFF8 6 0\n" + CUBE + QUADS,
        "off\n8 6\n" + CUBE + QUADS,
        "8 6 0\n" + CUBE + QUADS,
        "OFF  \n8.0000\t 6.000   0.0\n\n# corners\n" + CUBE + "\n\n# faces\n" + QUADS + "\n\n",
        ("OFF\n8 6 0 \n" + CUBE + QUADS).replace("\n", " \r\n"),
        "\ufeff# made by hand\nOFF # the header\n8 6 0\n" + CUBE + QUADS,
        "OFF\n8 6 0\n" + CUBE.replace("\n", " ") + QUADS.replace("\n", " "),
        "OFF\n8 6 0\n" + CUBE + QUADS.replace("\n", " 255 0 0\n"),
    ],
    ids=[
        "plain",
        "counts beside",
        "joined",
        "no edges",
        "no header",
        "blanks",
        "CR LF",
        "BOM",
        "one line",
        "face colours",
    ],
)
def test_every_shape_of_header_reads_the_same_cube(tmp_path, text):
    data = read(tmp_path, text)
    assert data.points.shape == (8, 3)
    assert data.faces.shape == (12, 3)
    assert data.colours is None
    # the fan of each square covers it: a closed cube of volume 1, wound outwards
    corners = data.points[data.faces]
    volume = np.einsum("ni,ni->n", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6
    assert volume == pytest.approx(1.0)


def test_colours_and_normals(tmp_path):
    data = read(tmp_path, "COFF\n2 0 0\n0 0 0 255 128 0 255\n1 0 0 1 2 3 255\n")
    assert data.colours.tolist() == [[255, 128, 0], [1, 2, 3]]
    data = read(tmp_path, "COFF\n2 0 0\n0 0 0 1.0 0.5 0.0 1\n1 0 0 0.0 0.0 1.0 1\n")
    assert data.colours.tolist() == [[255, 128, 0], [0, 0, 255]]
    data = read(tmp_path, "NOFF\n1 0 0\n1 2 3 0 0 1\n")
    assert data.normals.tolist() == [[0, 0, 1]]
    assert data.colours is None
    data = read(tmp_path, "CNOFF\n1 0 0\n1 2 3 0 0 1 9 8 7 255\n")
    assert data.normals.tolist() == [[0, 0, 1]]
    assert data.colours.tolist() == [[9, 8, 7]]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "empty"),
        ("# nothing\n\n", "empty"),
        ("ply\nformat ascii 1.0\n", "line 1: expected an OFF header, got 'ply'"),
        (b"\x89PNG\r\n\x1a\n\x00\x00", "OFF header"),
        ("OFF BINARY\n", "binary"),
        ("4OFF\n1 0 0\n0 0 0 1\n", "3 coordinates"),
        ("OFF\n", "counts"),
        ("OFF\nmany 6 0\n" + CUBE, "line 2: expected the counts"),
        ("OFF\n8.5 6 0\n" + CUBE, "line 2: expected the counts"),
        ("OFF\n-8 6 0\n" + CUBE, "line 2: expected the counts"),
        ("OFF\n9 0 0\n" + CUBE, "expected 9 points and 0 faces"),
        ("OFF\n8 7 0\n" + CUBE + QUADS, "expected 8 points and 7 faces"),
        ("OFF\n2 0 0\n0 0 0\n1 0\n", "line 4: expected 3 numbers of a point, got 2"),
        ("OFF\n2 0 0\n0 0 0\n1 nan 0\n", "line 4: expected finite numbers"),
        ("OFF\n2 0 0\n0 0 0\n1 x 0\n", "line 4: expected finite numbers"),
        ("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 3\n", "line 6: expected corners from 0 to 2"),
        ("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1\n", "line 6: expected a face"),
        ("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 -1\n", "line 6: expected corners"),
    ],
)
def test_broken_files_are_refused_with_their_line(tmp_path, text, message):
    with pytest.raises(MeshError) as caught:
        read(tmp_path, text)
    assert message in str(caught.value)
    assert "thing.off" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(MeshError, match="none\\.off"):
        read_off(tmp_path / "none.off")


@given(
    points=arrays(
        np.float64, st.tuples(st.integers(3, 9), st.just(3)), elements=st.floats(-1e6, 1e6, allow_subnormal=False)
    ),
    colours=st.booleans(),
    normals=st.booleans(),
    faces=st.booleans(),
)
def test_round_trip_is_exact(tmp_path_factory, points, colours, normals, faces):
    path = tmp_path_factory.getbasetemp() / "round.off"
    rng = np.random.default_rng(0)
    shade = rng.integers(0, 256, (len(points), 3), dtype=np.uint8) if colours else None
    normal = rng.normal(size=points.shape) if normals else None
    triangles = np.array([[0, 1, 2], [2, 1, 0]]) if faces else None
    write_off(path, points, triangles, shade, normal)
    data = read_off(path)
    assert np.array_equal(data.points, points)
    assert np.array_equal(data.faces, np.zeros((0, 3)) if triangles is None else triangles)
    assert data.colours is None if shade is None else np.array_equal(data.colours, shade)
    assert data.normals is None if normal is None else np.array_equal(data.normals, normal)


@pytest.mark.skipif(not DATA.is_dir(), reason="no folder of recorded data beside the project")
def test_every_recorded_file_reads():
    files = sorted(DATA.glob("icub-*/**/*.off"))
    assert len(files) >= 30
    for path in files:
        data = read_off(path)
        is_model = "model" in path.parent.name or path.name == "model.off"
        assert (len(data.faces) > 0) == is_model, path
        assert np.abs(data.points).max() < 1.0, path
        assert (data.colours is not None) == (path.parent.parent.name == "icub-handover" and not is_model), path
