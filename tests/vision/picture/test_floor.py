"""Nothing is under a table, also where something else hides that, or a mask says which pixels are the object's."""

from dataclasses import replace

import numpy as np
import pytest

from scenes.geometry import poses
from scenes.geometry.appearance.rendering import Renderer
from scenes.geometry.cameras import Camera
from scenes.recordings.beliefs import DepthModel
from scenes.recordings.frames import Frame
from scenes.synthesis.library import make
from vision.look.look import look
from vision.look.mask.planes import floors_of, floors_under
from vision.look.mask.settings import MaskSettings
from vision.picture.floor import beneath
from vision.picture.predictor import Predictor

CAMERA = Camera(300.0, 300.0, 159.5, 119.5, 320, 240)
# The table's normal towards the camera, which looks down at it, and a place on it.
UP, PLACE = np.array([0.0, -0.6, -0.8]), np.array([0.0, 0.0, 0.8])
ALONG = np.array([[1.0, 0.0, 0.0], [0.0, 0.8, -0.6]])
TABLE = PLACE + np.array([a * ALONG[0] + b * ALONG[1] for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
QUAD = [[0, 1, 2], [0, 2, 3]]


def standing(model, height=0.0):
    """(4, 4) of the model on the table, or so far (m) above it."""
    rotation = np.stack([*ALONG, np.cross(*ALONG)], axis=1)
    rotation = rotation if rotation[:, 2] @ UP > 0 else np.stack([ALONG[1], ALONG[0], UP], axis=1)
    lowest = (model.vertices @ rotation.T @ UP).min()
    return poses.make_pose(rotation, PLACE + (height - lowest) * UP)


def scene(screened=True):
    """A box on a table of which a screen hides the lower part, with its visible mask; and the box."""
    model = make("box")
    pose = standing(model)
    corners = poses.apply(pose, model.vertices) @ UP
    middle = 0.5 * (corners.min() + corners.max())
    # between the camera and the box's lower half: from below the table's edge in the image up to the box's middle
    top = pose[:3, 3] - 0.15 * np.array([0.0, 0.0, 1.0])
    top = top + (middle - top @ UP) * UP
    screen = np.array([top + a * ALONG[0] - b * UP for a, b in ((-0.2, 0.0), (0.2, 0.0), (0.2, 0.4), (-0.2, 0.4))])
    things = {"box": (model.vertices, model.faces), "table": (TABLE, QUAD)}
    if screened:
        things["screen"] = (screen, QUAD)
    image = Renderer(things).render(CAMERA, {"box": pose} | {name: np.eye(4) for name in things if name != "box"})
    frame = Frame(0, camera=CAMERA, depth=image.depth.astype(np.float32), mask=image.mask("box"))
    return replace(frame, camera_from_object_truth=pose), model


def test_what_is_beneath_is_what_each_point_says(rng):
    depth, margin, sigmas = DepthModel(), 0.004, 2.0
    points = rng.normal(size=(40, 3)) * 0.03
    floors = np.array([[*UP, -UP @ PLACE, 1.5, np.inf], [0.0, 0.0, -1.0, 0.83, 1.0, np.inf]])
    turned = poses.random_rotations(9, rng)
    some = np.array([poses.make_pose(one, PLACE + 0.03 * rng.normal(size=3)) for one in turned])
    expected = np.zeros(len(some))
    for n, pose in enumerate(some):
        own = depth.independent_sigma(poses.apply(pose, points.mean(axis=0)[None])[:, 2])[0]
        for floor in floors:
            room = max(margin + sigmas * own, sigmas * floor[4] * np.hypot(own, margin / sigmas))
            under = sum(floor[:3] @ poses.apply(pose, point[None])[0] + floor[3] < -room for point in points)
            expected[n] = max(expected[n], under / len(points))
    assert 0.0 < expected.mean() < 1.0
    assert beneath(points, floors, some, depth, margin, sigmas) == pytest.approx(expected)
    assert not beneath(points, np.zeros((0, 6)), some, depth, margin, sigmas).any()


def test_only_a_plane_behind_which_nothing_is_is_a_floor():
    planes = np.array([[*UP, -UP @ PLACE, 1.0, np.inf], [0.0, 0.0, -1.0, 1.5, 1.0, 0.0]])
    assert (floors_of(planes) == planes[:1]).all()
    assert not len(floors_of(np.zeros((0, 6))))
    # an object of which most is seen under it hangs beside the table's edge
    points = PLACE + np.linspace(-0.1, 0.1, 50)[:, None] * UP
    assert not len(floors_under(points, planes, MaskSettings(), DepthModel()))
    assert len(floors_under(points + 0.12 * UP, planes, MaskSettings(), DepthModel())) == 1
    assert len(floors_under(np.zeros((0, 3)), planes, MaskSettings(), DepthModel())) == 1


@pytest.mark.parametrize("masked", [True, False])
def test_a_table_is_known_beneath_an_object_with_a_mask_and_without(masked):
    frame, model = scene()
    looked = look(frame if masked else replace(frame, mask=None), model)
    assert len(looked.floors) == 1
    assert looked.floors[0, :3] @ UP > np.cos(np.deg2rad(1.0))
    # a mask says which readings are the object's: none are taken away as a table's
    assert len(looked.planes) == (not masked)


@pytest.mark.parametrize("masked", [True, False])
def test_a_pose_that_goes_under_the_table_behind_a_screen_costs_as_if_it_were_seen_past(masked):
    frame, model = scene()
    frame = frame if masked else replace(frame, mask=None)
    looked, truth = look(frame, model), frame.camera_from_object_truth
    known = DepthModel(), None, None, looked.planes, np.zeros((80, 107), np.int64) - 1, 0
    blind = Predictor(frame, model, *known)
    seeing = Predictor(frame, model, *known, looked.floors)
    sunk = poses.make_pose(translation=-0.04 * UP) @ truth
    both = np.array([truth, sunk])
    for costs in (lambda one: one.costs(both), lambda one: one.rough_costs(both)):
        without, told = costs(blind), costs(seeing)
        assert told[0] == without[0]
        assert told[1] > without[1] + 5.0
    # what is told of a picture, and makes an answer sure, stays what the rays met
    assert (seeing.predict(both).shares == blind.predict(both).shares).all()
