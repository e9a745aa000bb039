"""Vision alone on images that tell little, nothing, or something wrong: a verdict, never an exception."""

from dataclasses import replace

import numpy as np
import pytest
from made_frames import plain_view

from fusion import estimate
from fusion.truth.errors import Judge
from scenes.geometry import poses
from scenes.geometry.appearance.rendering import Renderer
from scenes.geometry.cameras import Camera
from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Contacts, Frame
from scenes.synthesis import library
from scenes.synthesis.hands import five_finger_hand
from scenes.synthesis.recording import synthesize_frames
from vision.look.look import look
from vision.look.regions import find_region
from vision.plausibility import doubts

NOTHING = Contacts(np.zeros((0, 3)))
CAMERA = Camera(285.0, 285.0, 159.5, 119.5, 320, 240)


def alone(model, pose, wall=0.9):
    """An object before a wall, exact depth, with its mask."""
    depth = Renderer({"object": (model.vertices, model.faces)}).render(CAMERA, {"object": pose}).depth
    mask = depth > 0
    return Frame(0, camera=CAMERA, depth=np.where(mask, depth, wall).astype(np.float32), mask=mask)


@pytest.mark.parametrize("value", [0.0, np.nan, np.inf])
@pytest.mark.parametrize("with_prior", [True, False])
def test_an_image_without_a_reading_is_lost(lab_frame, drill, value, with_prior):
    depth = np.full_like(lab_frame.depth, value)
    frame = replace(lab_frame, depth=depth, contacts=NOTHING, prior=lab_frame.prior if with_prior else None)
    answer = estimate(frame, drill, use=("vision",))
    assert answer.verdict == "lost"
    assert np.isfinite(answer.pose).all()
    assert np.isfinite(answer.covariance).all()


def test_five_pixels_are_no_answer(lab_frame, drill):
    few = np.zeros_like(lab_frame.mask)
    v, u = np.nonzero(lab_frame.mask)
    few[v[:: len(v) // 5][:5], u[:: len(u) // 5][:5]] = True
    for prior in (lab_frame.prior, None):
        answer = estimate(replace(lab_frame, mask=few, contacts=NOTHING, prior=prior), drill, use=("vision",))
        # a mask that shows nothing of it may be left, which is said: the rest of the image then has to be sure
        left = any(note.startswith("the mask is not believed") for note in answer.notes)
        off = Judge.of(drill).errors(answer.pose, lab_frame.camera_from_object_truth).add_s
        assert answer.verdict != "ok" or (left and off < 0.005)
        assert np.isfinite(answer.covariance).all()


def test_a_plane_leaves_its_directions_open():
    """A large plate that fills the image: it may slide and turn in its plane."""
    model = library.make("box")
    pose = poses.make_pose(translation=[0.0, 0.0, 0.35])
    frame = alone(model, pose)
    inner = np.zeros_like(frame.mask)
    v, u = np.nonzero(frame.mask)
    middle = (np.abs(v - v.mean()) < 12) & (np.abs(u - u.mean()) < 12)
    inner[v[middle], u[middle]] = True
    # nothing is known of what surrounds the patch
    depth = np.where(inner, frame.depth, 0).astype(np.float32)
    answer = estimate(replace(frame, mask=inner, depth=depth), model, prior=pose, use=("vision",))
    turned = poses.inverse(pose)[:3, :3]
    spread = np.sqrt(np.linalg.eigvalsh(turned @ answer.modes[0].covariance[3:, 3:] @ turned.T))
    # how far off it is is open, too, by what is believed of a camera: 5 mm, however little noise the patch has
    assert spread[1] > 3 * spread[0]
    assert spread[1] > 0.005


def test_a_cylinder_tells_of_its_axis(drill):
    can = library.make("cylinder")
    pose = poses.make_pose(poses.exp_rotation([1.2, 0.2, 0.0]), [0.0, 0.01, 0.5])
    answer = estimate(alone(can, pose), can, prior=pose, use=("vision",))
    assert any("rotation about z" in direction for direction in answer.unobservable)


def test_an_object_outside_the_image_is_lost(lab_frame, drill):
    frame = replace(lab_frame, contacts=NOTHING, mask=None)
    for away in ([3.0, 0.0, 0.6], [0.0, 0.0, -0.6]):
        answer = estimate(frame, drill, prior=poses.make_pose(translation=away), use=("vision",))
        assert answer.verdict == "lost"


def test_without_a_hint_the_object_is_sought_in_the_hand(lab_frame, drill):
    frame = replace(lab_frame, contacts=NOTHING, mask=None, prior=None)
    region = find_region(frame, drill, None, 0.035)
    middle = poses.apply(frame.camera_from_object_truth, drill.centroid[None])[0]
    assert np.linalg.norm(region.centre - middle) < region.radius


def test_the_hand_gives_wrong_intrinsics_away(lab_frame, drill):
    seen = look(lab_frame, drill, start=lab_frame.prior)
    assert doubts(lab_frame, seen.hand) == ()
    c = lab_frame.camera
    wrong = replace(lab_frame, camera=Camera(1.25 * c.fx, 1.25 * c.fy, c.cx, c.cy, c.width, c.height))
    assert doubts(wrong, look(wrong, drill, start=wrong.prior).hand)
    in_other_unit = replace(lab_frame, depth=1.1 * lab_frame.depth)
    assert doubts(in_other_unit, look(in_other_unit, drill, start=wrong.prior).hand)
    assert doubts(replace(lab_frame, hand=None), None) == ()


def test_a_mask_that_shows_nothing_is_said(lab_frame, drill):
    """Touch answers alone, and the note says that the camera was not listened to."""
    empty = replace(lab_frame, mask=np.zeros_like(lab_frame.mask))
    answer = estimate(empty, drill)
    assert any("mask holds no reading" in note for note in answer.notes)
    assert not any("mask" in note for note in estimate(lab_frame, drill).notes)
    assert "mask holds no reading" in doubts(replace(empty, hand=None), None)[0]


@pytest.mark.parametrize(
    ("value", "told"),
    [(np.nan, "not finite"), (-1.0, "below 0"), (0.0, "without a reading"), (1e30, "beyond 1000 m")],
)
def test_depth_without_a_reading_is_said(value, told):
    """Touch answers alone, or nothing does; either way the note says what became of the image."""
    frame = replace(plain_view("drill"), camera_from_object_truth=None, prior=None)
    frame = replace(frame, depth=np.full_like(frame.depth, value))
    for one in (frame, frame.without_touch()):
        notes = [note for note in estimate(one, library.make("drill")).notes if "no usable depth" in note]
        assert notes == [f"no usable depth: of 76800 pixels 76800 are {told}: vision is not used"]


def test_a_mask_where_the_object_cannot_be_is_said():
    frame = plain_view("drill")
    depth, mask = frame.depth.copy(), np.zeros(frame.depth.shape, bool)
    depth[:5, :5], mask[:5, :5] = 1.5, True
    beside = replace(frame, depth=depth, mask=mask)
    said = "none of the mask's 25 readings may be the object's: vision is not used"
    drill = library.make("drill")
    assert said in doubts(beside, None, pixels=0)
    # what is held says that it is meant, and the rest of the image is sure
    answer = estimate(beside, drill)
    assert "the mask is not believed: 100% of its inside is not the object" in answer.notes
    assert Judge.of(drill).errors(answer.pose, frame.camera_from_object_truth).add_s < 0.005


def test_a_principal_point_far_from_the_image_is_said():
    frame = plain_view("drill")
    wrong = replace(frame, camera=replace(frame.camera, cx=5000.0))
    assert "got cx 5000 for 320 pixels" in str(doubts(wrong, None))


def test_surface_that_a_mesh_did_not_have_is_said():
    whole = library.make("drill")
    open_one = ObjectModel.from_mesh(whole.vertices, whole.faces[1:], "drill")
    (told,) = open_one.filled
    assert told.startswith("the mesh is not closed as it is: 1 hole filled (")
    frame = plain_view("drill")
    assert told in estimate(frame, open_one).notes
    assert told in estimate(replace(frame.without_vision().without_touch(), prior=None), open_one).notes
    assert whole.filled == ()


@pytest.mark.parametrize("known", [True, False])
def test_vision_alone_is_not_told_where_to_look_by_touch(known):
    """Contacts say where the object is, and what is felt where touch is not asked for would be a hint of the truth."""
    model = library.make("mug")
    frame = synthesize_frames(model, five_finger_hand(), 1, 0.3, noise="lab", seed=5)[0]
    bare = replace(frame, prior=None, mask=None)
    bare = bare if known else replace(bare, hand=None, joints=None, world_from_hand=None)
    assert len(bare.contacts)
    felt, unfelt = (estimate(one, model, use=("vision",)) for one in (bare, bare.without_touch()))
    assert np.array_equal(felt.pose, unfelt.pose)
    assert np.array_equal(felt.covariance, unfelt.covariance)
    assert felt.notes == unfelt.notes
