"""Lists of points, meshes and contacts that become one another: what a format has no place for is counted."""

from __future__ import annotations

import json

import numpy as np
import pytest
from commands import refused, run

from fusion.cli.commands.answers.localize import read_contacts
from scenes.files.formats.off import read_off, write_off
from scenes.files.formats.ply import read_cloud, write_ply

HEAD = "frame,sensor,x,y,z,nx,ny,nz,fx,fy,fz,sigma_point,sigma_normal"
# one with everything, one that says its point and a sigma
ROWS = ("4,thumb,0.1,0.2,0.3,0.0,0.0,1.0,0.5,0.0,-1.5,0.002,0.1", "4,index,0.4,0.5,0.6,,,,,,,0.003,")


@pytest.fixture
def contacts(tmp_path):
    path = tmp_path / "felt.csv"
    path.write_text("\n".join([HEAD, *ROWS, ""]))
    return path


def dropped(tmp_path, *argv):
    assert run("convert", *argv, "--json", tmp_path / "j.json") == 0
    return {(entry["what"], entry["count"]) for entry in json.loads((tmp_path / "j.json").read_text())["dropped"]}


def test_contacts_stay_what_they_are(contacts, tmp_path):
    """Sigmas, forces, sensors, frames and the normals of some had been left out, and nobody said so."""
    assert dropped(tmp_path, contacts, tmp_path / "again.csv") == set()
    assert (tmp_path / "again.csv").read_text() == contacts.read_text()


def test_contacts_of_several_frames_stay_what_they_are(contacts, tmp_path, capsys):
    contacts.write_text("\n".join([HEAD, *ROWS, ROWS[0].replace("4,", "5,", 1), ""]))
    assert dropped(tmp_path, contacts, tmp_path / "again.csv") == set()
    assert (tmp_path / "again.csv").read_text() == contacts.read_text()
    capsys.readouterr()
    assert "expected contacts of one frame, got 2" in refused(capsys, "convert", contacts, tmp_path / "points.off")


def test_one_frame_of_the_contacts_is_chosen(contacts, tmp_path, capsys):
    contacts.write_text("\n".join([HEAD, *ROWS, ROWS[0].replace("4,", "5,", 1), ""]))
    dropped(tmp_path, contacts, tmp_path / "points.off", "--frame", "5")
    assert read_off(tmp_path / "points.off").points.tolist() == [[0.1, 0.2, 0.3]]
    assert dropped(tmp_path, contacts, tmp_path / "again.csv", "--frame", "4") == set()
    assert (tmp_path / "again.csv").read_text() == "\n".join([HEAD, *ROWS, ""])
    capsys.readouterr()
    assert "got 6" in refused(capsys, "convert", contacts, tmp_path / "no.csv", "--frame", "6")
    assert "got 6" in refused(capsys, "convert", contacts, tmp_path / "no.off", "--frame", "6")
    wanted = "expected contacts as .csv, which have frames"
    assert wanted in refused(capsys, "convert", tmp_path / "points.off", tmp_path / "no.ply", "--frame", "5")
    assert wanted in refused(capsys, "localize", tmp_path / "points.off", "--object", "drill", "--frame", "5")


def test_contacts_that_say_little_get_names(tmp_path):
    (tmp_path / "few.csv").write_text("x,y,z\n0.1,0.2,0.3\n")
    assert dropped(tmp_path, tmp_path / "few.csv", tmp_path / "again.csv") == set()
    assert (tmp_path / "again.csv").read_text() == f"{HEAD}\n0,contact0,0.1,0.2,0.3,,,,,,,,\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x,y,z\n", "expected contacts, got none"),
        ("x,y,z,nx,ny,nz\n0,0,0,1,,\n", "line 2: expected all of nx, ny, nz or none of them"),
        ("x,y,z,sigma_point\n0,0,0,-1\n", "line 2, column sigma_point: expected a number above 0"),
    ],
)
def test_broken_contacts(tmp_path, capsys, text, message):
    (tmp_path / "bad.csv").write_text(text)
    assert message in refused(capsys, "convert", tmp_path / "bad.csv", tmp_path / "again.csv")
    assert not (tmp_path / "again.csv").exists()


def test_points_of_contacts_lose_what_is_said_of_them(contacts, tmp_path, capsys):
    lost = {("normals", 1), ("sigmas", 2), ("forces", 1), ("names of sensors", 2)}
    assert dropped(tmp_path, contacts, tmp_path / "points.off") == lost
    assert read_off(tmp_path / "points.off").normals is None
    said = capsys.readouterr().out
    assert "dropped 1 of normals: 1 of 2 contacts have none, and points all or none" in said
    contacts.write_text("\n".join([HEAD, ROWS[0], ""]))
    assert dropped(tmp_path, contacts, tmp_path / "points.off") == {(what, 1) for what, _ in lost} - {("normals", 1)}
    assert read_off(tmp_path / "points.off").normals.tolist() == [[0.0, 0.0, 1.0]]
    assert dropped(tmp_path, contacts, tmp_path / "points.ply") == {(what, 1) for what, _ in lost}


def test_contacts_of_points_lose_faces_and_colours(tmp_path):
    points, faces = np.eye(3), [[0, 1, 2]]
    write_off(tmp_path / "mesh.off", points, faces, colours=np.zeros((3, 3)), normals=points)
    assert dropped(tmp_path, tmp_path / "mesh.off", tmp_path / "felt.csv") == {("faces", 1), ("colours", 3)}
    assert np.array_equal(read_contacts(tmp_path / "felt.csv").normals, points)
    assert dropped(tmp_path, tmp_path / "mesh.off", tmp_path / "mesh.ply") == {("normals", 3)}
    write_ply(tmp_path / "mesh.ply", points, faces)
    assert dropped(tmp_path, tmp_path / "mesh.ply", tmp_path / "again.off") == set()
    assert read_off(tmp_path / "again.off").faces.tolist() == faces
    assert np.array_equal(read_cloud(tmp_path / "again.off")[0], points)
