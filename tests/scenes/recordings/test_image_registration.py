"""A colour camera beside the depth camera: its image is read as the depth camera would have it."""

import json

import numpy as np
import pytest

from scenes.errors import CaptureError, InputError
from scenes.files.formats import images
from scenes.geometry import poses
from scenes.geometry.appearance.rendering import Renderer, shade
from scenes.geometry.cameras import Camera
from scenes.recordings.beliefs import ImageModel
from scenes.recordings.captures import read_capture, write_capture
from scenes.recordings.frames import Frame
from scenes.recordings.registration import registered
from scenes.synthesis import library

DEPTH, COLOUR = Camera(300.0, 300.0, 159.5, 119.5, 320, 240), Camera(410.0, 405.0, 205.0, 150.0, 420, 300)
COLOURS = {"object": (200, 60, 40), "wall": (60, 160, 200)}
MOVED = poses.make_pose(poses.exp_rotation([0.01, -0.02, 0.015]), [-0.03, 0.004, 0.002])


@pytest.fixture(scope="module")
def views():
    """Depth and both cameras' pictures of a box before a wall."""
    model = library.make("box")
    wall = np.array([[-2.0, -2.0, 0.9], [2.0, -2.0, 0.9], [2.0, 2.0, 0.9], [-2.0, 2.0, 0.9]])
    renderer = Renderer({"object": (model.vertices, model.faces), "wall": (wall, [[0, 1, 2], [0, 2, 3]])})
    pose = poses.make_pose(poses.exp_rotation([0.5, 0.4, 0.2]), [0.0, 0.0, 0.55])
    scene = {"object": pose, "wall": np.eye(4)}
    here = renderer.render(DEPTH, scene)
    there = renderer.render(COLOUR, {name: MOVED @ one for name, one in scene.items()})
    return model, pose, here, shade(here, COLOURS), shade(there, COLOURS)


def test_colours_lie_where_depth_has_them(views):
    _, _, here, own, other = views
    found = registered(other, COLOUR, here.depth, DEPTH, MOVED)
    mask = here.mask("object")
    seen = found.any(axis=2)
    assert 0.75 < seen.mean() < 1.0  # the rest only one of them sees
    is_object = found[..., 0] > found[..., 2]
    assert np.mean(is_object[seen] == mask[seen]) > 0.99
    # as it came, it is of another size and place
    crop = other[30:270, 50:370]
    assert np.mean((crop[..., 0] > crop[..., 2]) == mask) < 0.97
    assert own.shape == found.shape


def test_what_only_the_depth_camera_sees_is_black(views):
    _, _, here, _, other = views
    found = registered(other, COLOUR, here.depth, DEPTH, MOVED)
    # the wall beside the object, hidden from the colour camera by it, has not the object's colour
    wall = ~here.mask("object") & found.any(axis=2)
    assert np.mean(found[wall][:, 0] > found[wall][:, 2]) < 0.01


def test_nothing_read_and_wrong_sizes(views):
    _, _, here, _, other = views
    assert not registered(other, COLOUR, np.zeros_like(here.depth), DEPTH, MOVED).any()
    with pytest.raises(InputError, match="rgb: expected 420x300 pixels"):
        registered(other[:100], COLOUR, here.depth, DEPTH, MOVED)
    with pytest.raises(InputError, match="rgb_from_depth"):
        registered(other, COLOUR, here.depth, DEPTH, 2.0 * MOVED)


def test_a_capture_says_where_its_colour_camera_is(views, tmp_path):
    model, pose, here, own, other = views
    frame = Frame(0, camera=DEPTH, depth=here.depth.astype(np.float32), rgb=own, camera_from_object_truth=pose)
    write_capture(tmp_path / "c", [frame], model)
    images.write_rgb(tmp_path / "c" / "rgb" / "000000.png", other)
    with pytest.raises(CaptureError, match="320x240"):
        read_capture(tmp_path / "c")[0]
    entry = {
        "cam_K": COLOUR.matrix.ravel().tolist(),
        "cam_R_d2c": MOVED[:3, :3].ravel().tolist(),
        "cam_t_d2c": (1e3 * MOVED[:3, 3]).tolist(),
    }
    assert read_capture(tmp_path / "c").beliefs is None
    (tmp_path / "c" / "rgb_camera.json").write_text(json.dumps({"0": entry}))
    frame = read_capture(tmp_path / "c")[0]
    read = frame.rgb
    # has it colours or not, it is not the image that depth was computed from
    assert frame.beliefs.image == ImageModel().of_another_camera()
    write_capture(tmp_path / "copy", [frame], model)
    assert read_capture(tmp_path / "copy").beliefs == frame.beliefs
    mask = here.mask("object")
    seen = read.any(axis=2)
    assert np.mean((read[..., 0] > read[..., 2])[seen] == mask[seen]) > 0.99
    (tmp_path / "c" / "rgb_camera.json").write_text(json.dumps({"0": {"cam_K": entry["cam_K"]}}))
    with pytest.raises(CaptureError, match="cam_R_d2c"):
        read_capture(tmp_path / "c")[0]
