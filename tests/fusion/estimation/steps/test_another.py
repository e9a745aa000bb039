"""Two things of one kind in view: which is meant, nobody knows."""

from dataclasses import replace

import numpy as np
import pytest
from made_frames import VIEW

from fusion.estimation.answer import Mode
from fusion.estimation.asked import Asked
from fusion.estimation.estimate import estimate
from fusion.estimation.settings import usual_settings
from fusion.estimation.steps.another import with_others
from fusion.estimation.steps.sense import look_once, without_copy
from fusion.estimation.trace import Trace
from scenes.geometry import poses
from scenes.geometry.appearance.rendering import Renderer
from scenes.recordings.frames import Contacts, Frame
from scenes.synthesis.staging.prints import with_print

HERE, THERE = (poses.make_pose(poses.exp_rotation([1.9, 0.4, 0.3]), [x, 0.01, 0.55]) for x in (-0.11, 0.11))


def seen(model, *places, start=None, wall=0.9):
    """Some of a thing before a wall so far away (m), with pixel noise of a millimetre."""
    corners = np.array([[-1.0, -1.0, wall], [1.0, -1.0, wall], [1.0, 1.0, wall], [-1.0, 1.0, wall]])
    parts = {f"one {k}": (model.vertices, model.faces) for k in range(len(places))}
    world = Renderer({**parts, "wall": (corners, np.array([[0, 1, 2], [0, 2, 3]]))})
    depth = world.render(VIEW, {**dict(zip(parts, places)), "wall": np.eye(4)}).depth
    depth = np.where(depth > 0, depth + np.random.default_rng(0).normal(0, 0.001, depth.shape), 0).astype(np.float32)
    return Frame(index=0, camera=VIEW, depth=depth, prior=start, camera_from_object_truth=places[0])


def stage(answer):
    return next(stage for stage in answer.trace if stage.name == "another in view")


def test_one_of_two_is_no_answer_without_a_start(drill):
    alone = estimate(seen(drill, HERE), drill)
    assert alone.verdict == "ok"
    assert stage(alone).ran
    both = estimate(seen(drill, HERE, THERE), drill)
    assert both.verdict == "ambiguous"
    # the search itself found the other, or it was looked for when the answer seemed sure
    assert "another like it is in view" in both.notes[0] or "modes holds" in both.notes[0]
    assert both.confidence < 0.7
    # each of them is a mode, and the modes are what there is
    off = [[np.linalg.norm(mode.pose[:3, 3] - one[:3, 3]) for mode in both.modes[:2]] for one in (HERE, THERE)]
    assert sorted(int(np.argmin(row)) for row in off) == [0, 1]
    assert max(min(row) for row in off) < 0.005
    # and neither is listed twice
    middles = np.array([mode.pose[:3, 3] for mode in both.modes])
    assert (np.linalg.norm(middles[2:, None] - middles[None, :2], axis=2) > 0.02).all()
    assert sum(mode.weight for mode in both.modes) == pytest.approx(1.0)
    away = np.linalg.norm(HERE[:3, 3] - THERE[:3, 3])
    assert np.sqrt(np.linalg.eigvalsh(both.covariance[3:, 3:])[-1]) > 0.4 * away


def test_who_says_which_is_meant_gets_it(drill):
    frame = seen(drill, HERE, THERE, start=poses.displaced(HERE, 0.1, 0.01, drill.centroid, np.random.default_rng(1)))
    answer = estimate(frame, drill)
    assert answer.verdict == "ok"
    assert not stage(answer).ran
    points, normals = drill.sample_surface(6, seed=3)
    felt = Contacts(poses.apply(THERE, points), normals @ THERE[:3, :3].T, 1e-3, 0.05)
    touched = estimate(replace(frame, prior=None, contacts=felt), drill)
    assert np.linalg.norm(touched.pose[:3, 3] - THERE[:3, 3]) < 0.005
    assert not stage(touched).ran


@pytest.mark.parametrize(("right", "chance", "expected"), [(0.99, 0.99, 99 / 199), (0.99, 0.0, 0.99), (1.0, 1.0, 0.5)])
def test_chances_of_things_of_which_one_is_meant(drill, right, chance, expected):
    modes = tuple(Mode(np.eye(4), weight, 0.0, np.eye(6)) for weight in (0.75, 0.25))
    other = Mode(THERE, 1.0, 3.0, np.eye(6))
    told, sure = with_others(drill, modes, right, ((other, chance),))
    assert sure == pytest.approx(expected, abs=1e-5)
    assert sum(mode.weight for mode in told) == pytest.approx(1.0)
    assert told[0].pose is modes[0].pose
    assert told[1].pose is THERE


def test_what_is_printed_tells_which_of_two_is_meant(drill):
    """Copies with another print are in view: each of the two is as clear by its shape."""
    modes, other = (Mode(np.eye(4), 1.0, 0.0, np.eye(6)),), Mode(THERE, 1.0, 3.0, np.eye(6))
    assert with_others(drill, modes, 0.99, ((other, 0.99),), [0.001])[1] == pytest.approx(0.99, abs=1e-3)
    assert with_others(drill, modes, 0.99, ((other, 0.99),), [1000.0])[1] < 0.01
    model = with_print(drill)
    colours = np.full((VIEW.height, VIEW.width, 3), 120, dtype=np.uint8)
    frame = seen(drill, HERE, THERE)
    rays = VIEW.rays().reshape(-1, 3)
    inverse = poses.inverse(HERE)
    depth = drill.surface.cast(np.broadcast_to(inverse[:3, 3], rays.shape), rays @ inverse[:3, :3].T)
    shown = np.abs(depth - frame.depth.ravel()) < 0.005
    ink_of = model.texture.at(poses.apply(inverse, rays[shown] * depth[shown, None]))
    colours.reshape(-1, 3)[shown] = np.rint(255.0 * np.nan_to_num(ink_of, nan=0.5))
    answer = estimate(replace(frame, rgb=colours), model)
    assert np.linalg.norm(answer.pose[:3, 3] - HERE[:3, 3]) < 0.005
    assert answer.verdict == "ok"
    assert "not as printed" in stage(answer).why
    assert estimate(frame, model).verdict == "ambiguous"


def test_one_of_two_of_which_half_is_hidden_may_be_meant(drill):
    """What shows less earns less: it is as clear by itself as an answer is."""
    frame = seen(drill, HERE, THERE)
    right = int(VIEW.fx * (THERE[0, 3] + 0.02) / THERE[2, 3] + VIEW.cx)
    depth = frame.depth.copy()
    depth[:, right:] = np.minimum(depth[:, right:], 0.45)
    answer = estimate(replace(frame, depth=depth), drill)
    assert answer.verdict == "ambiguous"
    off = [min(np.linalg.norm(mode.pose[:3, 3] - one[:3, 3]) for mode in answer.modes) for one in (HERE, THERE)]
    assert max(off) < 0.01


def test_each_of_three_is_a_mode(drill):
    middle = poses.make_pose(poses.exp_rotation([1.9, 0.4, 0.3]), [0.0, -0.01, 0.85])
    places = (
        poses.make_pose(HERE[:3, :3], [-0.24, 0.01, 0.65]),
        middle,
        poses.make_pose(HERE[:3, :3], [0.22, 0.01, 0.6]),
    )
    answer = estimate(seen(drill, *places, wall=1.0), drill)  # none goes through it
    assert answer.verdict == "ambiguous"
    off = [min(np.linalg.norm(mode.pose[:3, 3] - one[:3, 3]) for mode in answer.modes) for one in places]
    assert max(off) < 0.006
    assert sum(mode.weight for mode in answer.modes) == pytest.approx(1.0)


def test_chances_of_three_of_which_one_is_meant(drill):
    first, far = (Mode(np.eye(4), 1.0, 0.0, np.eye(6)),), poses.make_pose(np.eye(3), [0.0, 1.0, 0.0])
    there = tuple((Mode(pose, 1.0, 3.0, np.eye(6)), 0.9) for pose in (THERE, far))
    modes, sure = with_others(drill, first, 0.9, there)
    assert sure == pytest.approx(9.0 / 28.0)
    assert [mode.weight for mode in modes] == pytest.approx([1.0 / 3.0] * 3)
    # what is likelier by its print, or because a hand holds it, comes first
    modes, _ = with_others(drill, first, 0.9, there, [0.01, 100.0])
    assert modes[1].pose is far


def test_what_a_hand_holds_is_meant_and_not_what_stands_beside_it(lab_frame, drill):
    """Of the copy beside it more is seen than of what the fingers hide, and nothing is felt."""
    there = lab_frame.camera_from_object_truth @ poses.make_pose(poses.exp_rotation([0.3, 0.2, 1.0]), np.zeros(3))
    there[:3, 3] += [0.13, 0.0, -0.05]
    z = Renderer({"copy": (drill.vertices, drill.faces)}).render(lab_frame.camera, {"copy": there}).depth
    z = z + np.random.default_rng(1).normal(0, 0.001, z.shape) * (z > 0)
    nearer = (z > 0) & ((lab_frame.depth == 0) | (z < lab_frame.depth))
    depth = np.where(nearer, z, lab_frame.depth).astype(np.float32)
    answer = estimate(replace(lab_frame, depth=depth, prior=None, mask=None).without_touch(), drill)
    assert np.linalg.norm(answer.pose[:3, 3] - lab_frame.camera_from_object_truth[:3, 3]) < 0.005
    alone = estimate(replace(lab_frame, prior=None, mask=None).without_touch(), drill)
    assert not any(one.ran for one in alone.trace if one.name == "another in view")


def test_without_a_hand_no_copy_is_looked_for_in_place_of_an_answer(lab_frame, drill):
    """That another is likelier by its picture alone does not say that it is meant."""
    settings, trace = usual_settings(), Trace()
    there = lab_frame.camera_from_object_truth
    aside = poses.make_pose(None, [0.25, 0.0, 0.0]) @ there
    answer = estimate(lab_frame, drill, use=("vision",))
    modes = Mode(aside, 0.02, 0.0, np.eye(6)), Mode(there, 0.98, 1.0, np.eye(6))
    answer = replace(answer, pose=aside, as_seen=None, modes=modes)
    for frame, asked_anew in ((lab_frame, True), (replace(lab_frame, hand=None, joints=None), False)):
        asked = Asked.of(frame, None, ("vision",), None, 0, settings, None)
        left = without_copy(drill, asked, look_once(drill, asked, trace), answer, trace)
        assert (left is not None) is asked_anew
