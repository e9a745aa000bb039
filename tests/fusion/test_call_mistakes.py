"""What is given to the library in another form than it takes: one line says what was expected."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from made_frames import plain_view

from fusion import Tracker, estimate, sample_poses, track
from fusion.tracking.checkpoint import restore_tracker
from fusion.tracking.rehearsal import rehearse
from scenes.errors import CaptureError, InputError, MeshError
from scenes.evidence.align import Prior
from scenes.formats.bop.scene import Choice, convert
from scenes.geometry import poses
from scenes.geometry.cameras import Camera
from scenes.geometry.objects import ObjectModel
from scenes.geometry.symmetries import Symmetries
from scenes.recordings.captures import read_capture, write_capture
from scenes.recordings.frames import Contacts, Frame
from scenes.synthesis.hands import five_finger_hand
from scenes.synthesis.library import make
from touch import localize

K = np.array([[285.0, 0.0, 159.5], [0.0, 286.0, 119.5], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize(
    ("matrix", "told"),
    [
        (K + np.diag([3.0, 0.0], 1), "expected a K without skew, got 3 and 0"),
        (K.T, "expected a K whose last row is 0 0 1, .*: is it transposed"),
        (2 * K, r"expected a K whose last row is 0 0 1, got \[0. 0. 2.\]$"),
        (np.full((3, 3), np.nan), "expected a K whose last row is 0 0 1"),
        ("fx", "expected a 3x3 intrinsic matrix of numbers"),
    ],
)
def test_intrinsics_that_are_none(matrix, told):
    with pytest.raises(InputError, match=told):
        Camera.from_matrix(matrix, 320, 240)


def test_intrinsics_as_they_come():
    for matrix in (K, K.astype(np.float32), K.ravel().tolist()):
        assert Camera.from_matrix(matrix, 320, 240) == Camera(285.0, 286.0, 159.5, 119.5, 320, 240)


def test_arguments_of_another_kind():
    frame, model = plain_view("drill"), make("drill")
    for call, told in (
        (lambda: Camera("a", 1, 1, 1, 1, 1), "camera: expected numbers as fx, fy"),
        (lambda: Camera(500, 500, 320, 240, 640.5, 480), "camera: expected a whole number of pixels as width, got 640"),
        (lambda: Camera.from_matrix(K, 320, 240.5), "camera: expected a whole number of pixels as height, got 240.5"),
        (lambda: ObjectModel.from_mesh(model.vertices + 1j, model.faces), "vertices as real numbers, got complex"),
        (lambda: ObjectModel.from_mesh(np.ma.masked_less(model.vertices, 0), model.faces), "got a masked array"),
        (lambda: Contacts(3.0), r"expected points of shape \(n, 3\), got \(\)"),
        (lambda: Frame("a"), "frame: expected its number first, a whole one, got str"),
        (lambda: ObjectModel("x", model.vertices, model.faces + 1), r"x: expected vertex numbers 0\.\.\d+, got 1\.\."),
        (lambda: estimate(frame, "mesh.ply"), r"model: expected ObjectModel \(ObjectModel.load\(path\)\), got str"),
        (lambda: estimate("capture", model), "frame: expected Frame .*, got str"),
        (lambda: localize(model, np.zeros((3, 3))), "contacts: expected Contacts .*, got ndarray"),
        (lambda: localize("drill", frame.contacts), "model: expected ObjectModel .*, got str"),
        (lambda: localize(model, frame.contacts, seed=-1), "seed: expected a whole number from 0, got -1"),
        (lambda: restore_tracker(Tracker(model), b"junk"), "expected what save_tracker wrote, got 4 other bytes"),
    ):
        with pytest.raises((InputError, MeshError), match=told):
            call()


def test_arguments_that_are_nearly_right():
    frame, model = plain_view("drill"), make("drill")
    three = np.eye(3)
    for call, told in (
        (lambda: list(track(frame, model)), r"frames: expected several \(\[frame\], .*\), got Frame"),
        (lambda: list(track(None, model)), "frames: expected several .*, got NoneType"),
        (lambda: Tracker(model, live="no"), "live: expected True or False, got 'no'"),
        (lambda: rehearse(Tracker(model), frame), r"new_tracker: .*\(lambda: Tracker\(model\)\), got Tracker"),
        (lambda: replace(frame, camera_from_world=None), "camera_from_world: expected a 4x4 transform, got None"),
        (lambda: Contacts(three, sensors=[None] * 3), "expected words as sensor names, got None"),
        (lambda: Contacts(three, sensors="abc"), "expected a list of sensor names, got 'abc'"),
        (lambda: Contacts(three, sigma_told=[1, 0]), "expected one sigma_told or 3 of them, got shape"),
        (lambda: Contacts(three, sigma_told="yes"), "expected sigma_told true or false, .*, got 'yes'"),
        (lambda: Contacts(three, forces=np.full((3, 3), np.inf)), "expected finite forces"),
    ):
        with pytest.raises(InputError, match=told):
            call()
    assert Contacts(three, sigma_told=[1, 0, 1]).sigma_told.tolist() == [True, False, True]
    assert Contacts(three, sensors=np.array(["a", "b", "a"])).sensors == ["a", "b", "a"]


def test_what_is_masked_is_no_value():
    frame, model = plain_view("drill"), make("drill")
    hidden = np.ma.masked_array(np.where(frame.depth > 0, 9.0, 0.0), mask=frame.depth > 0)
    assert not replace(frame, depth=hidden).depth.any()
    for call in (
        lambda: replace(frame, mask=np.ma.masked_array(frame.depth > 0, mask=frame.depth > 0)),
        lambda: replace(frame, rgb=np.ma.masked_less(np.zeros((*frame.depth.shape, 3), np.uint8), 1)),
        lambda: replace(frame, prior=np.ma.masked_array(np.eye(4), mask=np.eye(4))),
        lambda: replace(frame, contacts=np.ma.masked_array(np.eye(3), mask=np.eye(3))),
        lambda: Contacts(np.eye(3), forces=np.ma.masked_array(np.eye(3), mask=np.eye(3))),
        lambda: estimate(frame, model, np.ma.masked_array(np.eye(4), mask=np.eye(4))),
    ):
        with pytest.raises(InputError, match="expected values, got a masked array with"):
            call()
    whole = np.ma.masked_array(np.eye(3), mask=False)
    assert len(Contacts(whole)) == 3


def test_what_holds_arrays_equals_itself_alone():
    """Comparing arrays has no one truth value; before, these raised."""
    frame, other = plain_view("box"), plain_view("box")
    model = make("box")
    answer, again = estimate(frame, model), estimate(other, model)
    assert frame == frame
    assert frame != other
    assert answer == answer
    assert answer != again
    assert answer.modes == answer.modes
    assert len({answer, again, frame, other}) == 4


def test_an_instance_that_is_not_there_is_said_as_such(tmp_path):
    capture = write_capture(tmp_path / "c", [plain_view("box")], make("box"))
    from scenes.formats.bop.scene import export

    export(read_capture(capture), tmp_path / "bop")
    scene = next((tmp_path / "bop").glob("*/*/scene_camera.json")).parent
    with pytest.raises(CaptureError, match=r"object 1 is there 1 time, without --instance 1 \(from 0\)"):
        convert(scene, tmp_path / "again", Choice(1, 1))


def test_a_folder_of_captures_says_so(tmp_path):
    write_capture(tmp_path / "all/one", [replace(plain_view("box"), prior=None)], make("box"))
    with pytest.raises(CaptureError, match=r"found no capture.json: a capture in it is .*all/one$"):
        read_capture(tmp_path / "all")


@pytest.mark.parametrize(
    ("information", "told"),
    [
        (np.full((6, 6), np.nan), "expected a finite pose"),
        (np.diag([np.inf] * 6), "expected a finite pose"),
        (np.eye(3), r"expected a finite pose \(4, 4\) and information \(6, 6\)"),
        (np.triu(np.ones((6, 6))), "expected a symmetric information"),
        (np.diag([1.0, 1.0, 1.0, 1e4, 1e4, -1e2]), "negative nowhere"),
    ],
    ids=["nan", "infinite", "small", "not symmetric", "negative"],
)
def test_a_prior_is_a_gaussian(information, told):
    frame, model = plain_view("drill"), make("drill")
    prior = Prior(frame.prior, information)
    asking = (
        lambda: estimate(frame, model, prior),
        lambda: Tracker(model, prior),
        lambda: localize(model, frame.contacts, prior=prior),
    )
    for call in asking:
        with pytest.raises(InputError, match=f"prior: .*{told}"):
            call()


def test_priors_of_another_kind():
    frame, model = plain_view("drill"), make("drill")
    with pytest.raises(InputError, match=r"prior: expected Prior .*, got ndarray"):
        localize(model, frame.contacts, prior=frame.prior)
    with pytest.raises(InputError, match="prior: expected one 4x4 transform, got 2"):
        estimate(frame, model, np.stack([frame.prior, frame.prior]))
    # one that leaves directions open, and one that is rounded, are Gaussians
    open_about_z = np.diag([1e3, 1e3, 0.0, 1e6, 1e6, 1e6])
    assert estimate(frame, model, Prior(frame.prior, open_about_z)).verdict == "ok"
    wide = poses.adjoint(frame.prior) @ np.diag([0.04, 0.04, 0.04, 1e-5, 1e-5, 1e-5]) @ poses.adjoint(frame.prior).T
    assert estimate(frame, model, Prior(frame.prior, np.linalg.inv(wide))).verdict == "ok"


@pytest.mark.parametrize("cloud", [np.full((500, 3), np.nan), np.tile([0.0, 0.0, 0.5], (500, 1)), np.zeros((500, 3))])
@pytest.mark.filterwarnings("error")
def test_a_cloud_of_no_extent_is_an_answer_that_knows_nothing(drill, cloud):
    """No number at all, or one place again and again: no unit was mistaken, and nothing divides by nothing."""
    answer = estimate(Frame(0, cloud=cloud), drill)
    assert answer.verdict != "ok"
    assert np.isfinite(answer.pose).all()
    assert np.isfinite(answer.covariance).all()


def test_sizes_that_are_millimetres():
    """Where a pose or a size would be taken for metres, and answered."""
    frame, model = plain_view("drill"), make("drill")
    points = 1000 * model.sample_surface(12, seed=0)[0]
    far = poses.make_pose(translation=[30.0, 10.0, 600.0])
    for call, told in (
        (
            lambda: estimate(frame, model, far),
            "prior: expected an object that the camera can see, .* 600.8 m away",
        ),
        (lambda: localize(model, Contacts(points)), "contacts: expected sizes that agree, .*: mm read as m"),
    ):
        with pytest.raises((InputError, CaptureError), match=told):
            call()


def test_beliefs_by_a_camera_s_name():
    with pytest.raises(InputError, match=r'like Beliefs\(depth=depth_camera\("d435"\)\), got str'):
        estimate(plain_view("drill"), make("drill"), beliefs="d435")


def test_an_image_that_could_not_be_read():
    """OpenCV answers None for a file that is not there."""
    answer = estimate(Frame(0, camera=plain_view("drill").camera, depth=None), make("drill"))
    assert answer.verdict == "lost"
    assert answer.notes[0] == "no evidence: the frame has no depth image, no cloud and no touch"


def test_frames_beyond_a_capture_s_end(tmp_path):
    capture = read_capture(write_capture(tmp_path / "one", [plain_view("drill")], make("drill")))
    assert capture[-1].index == capture[0].index
    for place in (1, -2, slice(0, 1)):
        with pytest.raises(IndexError, match=r"one: expected a place from 0 to 0, got .*: frame"):
            capture[place]


def test_frames_and_answers_print_in_a_line():
    frame, model = plain_view("drill"), make("drill")
    assert repr(Frame(3)) == "Frame(3: nothing)"
    assert repr(replace(frame, contacts=[[0, 0, 1]])).endswith("1 contacts)")
    said = repr(Tracker(model).step(frame))
    assert said.startswith(f"TrackedEstimate(frame {frame.index}: ")
    assert "\n" not in said


def test_arguments_of_helpers(tmp_path):
    frame, model, hand = plain_view("drill"), make("drill"), five_finger_hand()
    for call, told in (
        (lambda: write_capture(tmp_path / "a", [frame], "drill.ply"), "model: expected ObjectModel .*, got str"),
        (lambda: write_capture(tmp_path / "a", frame, model), r"frames: expected several \(\[frame\]\), got Frame"),
        (lambda: hand.mesh([0.1]), r"joints: expected positions by joint name, got list: dict\(zip\("),
        (lambda: Symmetries.about_axis("z"), "direction: expected three numbers, not all 0, .*, got 'z'"),
        (lambda: Symmetries.about_axis([0, 0, 0]), "direction: expected three numbers, not all 0"),
        (lambda: poses.from_quaternion([0, 0, 1]), r"quaternion: expected four numbers w, x, y, z, got shape \(3,\)"),
        (lambda: sample_poses("drill", None, 3), "model: expected ObjectModel .*, got str"),
        (lambda: sample_poses(model, None, -1), "count: expected a whole number from 0, got -1"),
    ):
        with pytest.raises(InputError, match=told):
            call()
    assert not (tmp_path / "a").exists()
