"""A capture reads nothing outside its folder, however it is named, unless its paths are trusted."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from commands import refused, run
from made_frames import some_frame

from scenes.errors import CaptureError
from scenes.recordings.captures import read_capture, write_capture
from scenes.recordings.checking.validation import validate
from scenes.robot.hands import Hand
from scenes.synthesis.hands import HandShape, five_finger_hand
from scenes.synthesis.library import make


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    hand = five_finger_hand(HandShape(tip="mesh"))
    return write_capture(tmp_path_factory.mktemp("whole") / "c", [some_frame(0, hand)], make("box"), hand)


def _named(folder: Path, change) -> None:
    path = folder / "capture.json"
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


def _outside(folder: Path, name: str) -> Path:
    """The file, moved beside the capture."""
    target = folder.parent / Path(name).name
    shutil.move(folder / name, target)
    return target


def absolute_model(folder: Path) -> None:
    target = _outside(folder, "models/obj_000001.ply")
    _named(folder, lambda content: content["object"].update(model=str(target)))


def model_above(folder: Path) -> None:
    _outside(folder, "models/obj_000001.ply")
    _named(folder, lambda content: content["object"].update(model="../obj_000001.ply"))


def model_by_a_link(folder: Path) -> None:
    (folder / "models/obj_000001.ply").symlink_to(_outside(folder, "models/obj_000001.ply"))


def images_by_a_link(folder: Path) -> None:
    (folder / "depth").symlink_to(_outside(folder, "depth"))


def hand_above(folder: Path) -> None:
    _outside(folder, "hand")
    _named(
        folder, lambda content: content.update(hand={"urdf": "../hand/hand.urdf", "sensors": "../hand/sensors.json"})
    )


def mesh_of_the_hand(prefix: str):
    def change(folder: Path) -> None:
        target = _outside(folder, "hand/meshes/palm_0.stl")
        urdf = folder / "hand/hand.urdf"
        urdf.write_text(urdf.read_text().replace("meshes/palm_0.stl", prefix + str(target)))

    return change


def mesh_of_the_hand_above(folder: Path) -> None:
    _outside(folder, "hand/meshes/palm_0.stl")
    urdf = folder / "hand/hand.urdf"
    urdf.write_text(urdf.read_text().replace("meshes/palm_0.stl", "../../palm_0.stl"))


def mesh_of_a_tip(folder: Path) -> None:
    target = _outside(folder, "hand/tips/00.ply")
    sensors = folder / "hand/sensors.json"
    sensors.write_text(sensors.read_text().replace("tips/00.ply", str(target)))


LEAKS = {
    "absolute model": absolute_model,
    "model above": model_above,
    "model by a link": model_by_a_link,
    "images by a link": images_by_a_link,
    "hand above": hand_above,
    "mesh of the hand": mesh_of_the_hand(""),
    "mesh of the hand, file://": mesh_of_the_hand("file://"),
    "mesh of the hand above": mesh_of_the_hand_above,
    "mesh of a tip": mesh_of_a_tip,
}


def _everything(folder: Path, trust: bool = False) -> None:
    capture = read_capture(folder, trust_paths=trust)
    assert capture.model.diameter > 0
    assert isinstance(capture.hand, Hand)
    assert capture[0].depth is not None


@pytest.mark.parametrize("leak", LEAKS.values(), ids=LEAKS)
def test_what_leads_out_is_refused_unless_trusted(whole, tmp_path, capsys, leak):
    folder = tmp_path / "inner" / "c"
    shutil.copytree(whole, folder)
    _everything(folder)
    leak(folder)
    with pytest.raises(CaptureError, match=r"expected files inside .*which is .*--trust-paths") as error:
        _everything(folder)
    assert "\n" not in str(error.value)
    assert any("--trust-paths" in problem.message for problem in validate(folder))
    _everything(folder, trust=True)
    assert "--trust-paths" not in str(validate(folder, trust_paths=True))
    # what is written again holds all that it needs
    trusted = read_capture(folder, trust_paths=True)
    write_capture(tmp_path / "copy", list(trusted), trusted.model, trusted.hand)
    shutil.rmtree(tmp_path / "inner")
    _everything(tmp_path / "copy")


def test_links_inside_and_a_linked_capture_are_fine(whole, tmp_path):
    shutil.copytree(whole, tmp_path / "real")
    (tmp_path / "real/rgb2").symlink_to("rgb")
    (tmp_path / "link").symlink_to(tmp_path / "real")
    _everything(tmp_path / "link")


def test_commands_take_the_option(whole, tmp_path, capsys):
    folder = tmp_path / "inner" / "c"
    shutil.copytree(whole, folder)
    model_above(folder)
    assert "--trust-paths" in refused(capsys, "estimate", folder, "--out", tmp_path / "out")
    assert run("validate", folder) == 1
    assert "--trust-paths" in capsys.readouterr().out
    run("validate", folder, "--trust-paths")
    assert "--trust-paths" not in capsys.readouterr().out


def test_links_that_lead_back_to_themselves_are_told_as_such(whole, tmp_path, capsys):
    back = "a link that leads back to itself"
    folder, loop = tmp_path / "c", tmp_path / "loop"
    shutil.copytree(whole, folder)
    image = folder / "depth/000000.png"
    image.unlink()
    image.symlink_to(image.name)
    loop.symlink_to(loop.name)
    with pytest.raises(CaptureError, match=f"got 000000.png, {back}"):
        _everything(folder)
    assert run("validate", folder) == 1
    assert back in capsys.readouterr().out
    assert back in refused(capsys, "estimate", folder)
    for asked in (("--out", loop), ("--out", loop / "inner"), ("--json", loop)):
        assert back in refused(capsys, "estimate", whole, *asked)
    assert loop.is_symlink()
