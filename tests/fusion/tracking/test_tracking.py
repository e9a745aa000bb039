"""A track with both senses: through gaps, with one sense, past slips, out of sight, and lost and found again."""

from dataclasses import replace

import numpy as np
import pytest
from made_frames import CARRIED, VIEW, off_by, recording

from fusion import Tracker, track
from fusion.tracking.answer import TrackSettings
from fusion.tracking.memory.state import GlanceSettings, RenewalSettings
from scenes.errors import InputError
from scenes.geometry import poses
from scenes.recordings.frames import Contacts
from scenes.synthesis import library


@pytest.fixture(scope="module")
def mug():
    return library.make("mug")


@pytest.fixture(scope="module")
def carried(mug):
    return recording(mug)


def test_a_carried_object_is_followed_and_nothing_slips(mug, carried):
    answers = list(track(carried, mug))
    assert [a.how for a in answers] == ["started"] + ["tracked"] * (CARRIED - 1)
    assert [a.frame for a in answers] == list(range(CARRIED))
    assert not any(a.slip or a.moved_in_hand for a in answers)
    for answer, frame in zip(answers, carried):
        turn, move = off_by(answer, frame, mug)
        assert turn < 2.5
        assert move < 2.0
        assert np.linalg.eigvalsh(answer.covariance).min() > 0
        assert answer.hand_from_object is not None
    said = next(a for a in answers[1:] if not any(stage.name == "glance" for stage in a.trace)).to_json()
    assert said["tracking"]["how"] == "tracked"
    assert {"predict", "look", "align", "judge"} <= {line["stage"] for line in said["trace"]}


# No search in between: what it finds is looked at in full for some frames.
ALONE = TrackSettings(renewal=RenewalSettings(soonest=100))


def test_where_all_goes_as_expected_a_glance_is_enough(mug, carried):
    answers = list(track(carried, mug, settings=ALONE))
    stages = [{stage.name for stage in a.trace if stage.ran} for a in answers[1:]]
    glances = [i for i, names in enumerate(stages, 1) if "glance" in names and "look" not in names]
    assert len(glances) >= 3
    assert 1 not in glances  # what is not settled is looked at in full
    full = list(track(carried, mug, settings=replace(ALONE, glance=GlanceSettings(every=1))))
    assert not any("glance" in {stage.name for stage in a.trace} for a in full)
    for i in glances:
        turn, move = off_by(answers[i], carried[i], mug)
        assert turn < 2.5
        assert move < 2.0
        assert answers[i].verdict == full[i].verdict


def test_what_is_otherwise_than_expected_is_looked_at_in_full(mug, carried):
    index = 10  # a glance, as long as nothing happens
    away = poses.perturb(np.eye(4), [0.0, 0.0, 0.0, 0.02, 0.0, 0.0], np.zeros(3))
    false = replace(carried[index], contacts=carried[index].contacts.moved(away))
    for frame, word in ((carried[index], ""), (false, "contacts are")):
        answers = list(track([*carried[:index], frame], mug, settings=ALONE))
        stages = {stage.name: stage.why for stage in answers[-1].trace}
        assert ("look" in stages) == bool(word)
        assert word in stages["glance"]


def test_the_same_track_twice_is_the_same_to_the_bit(mug, carried):
    first, second = (list(track(carried[:4], mug, seed=3)) for _ in range(2))
    for a, b in zip(first, second):
        np.testing.assert_array_equal(a.pose, b.pose)
        np.testing.assert_array_equal(a.covariance, b.covariance)


def test_frames_without_anything_are_bridged_by_the_hand(mug, carried):
    gone = [replace(f, depth=None, contacts=Contacts(np.zeros((0, 3)))) if 4 <= f.index < 9 else f for f in carried]
    answers = list(track(gone, mug))
    assert [a.how for a in answers[4:9]] == ["carried"] * 5
    assert {a.verdict for a in answers[4:9]} == {"ambiguous"}
    before, after = (np.trace(answers[i].covariance[:3, :3]) for i in (4, 8))
    assert after > before  # less sure with every blind frame
    for answer, frame in zip(answers[4:], carried[4:]):
        turn, move = off_by(answer, frame, mug)
        assert turn < 2.5
        assert move < 2.0
    assert answers[9].how == "tracked"


def test_a_hand_that_is_blind_and_numb_for_long_has_lost_it(mug, carried):
    tracker = Tracker(mug)
    tracker.step(carried[0])
    nothing = replace(carried[1], index=200, depth=None, contacts=Contacts(np.zeros((0, 3))))
    assert tracker.step(nothing).verdict == "lost"


@pytest.mark.parametrize("sense", ["vision", "touch"])
def test_one_sense_may_be_missing_for_a_while(mug, carried, sense):
    def without(frame):
        if not 3 <= frame.index < 9:
            return frame
        return replace(frame, depth=None) if sense == "vision" else replace(frame, contacts=Contacts(np.zeros((0, 3))))

    frames = [without(f) for f in carried]
    for answer, frame in zip(track(frames, mug), carried):
        turn, move = off_by(answer, frame, mug)
        assert turn < 3.0
        assert move < 2.5
        assert answer.how in ("started", "tracked")


def test_senses_that_take_turns_and_a_late_frame(mug, carried):
    tracker = Tracker(mug)
    tracker.step(carried[0])
    order = [1, 2, 4, 3, 5, 6, 8, 7, 9]
    for index in order:
        frame = carried[index]
        part = replace(frame, depth=None) if index % 2 else replace(frame, contacts=Contacts(np.zeros((0, 3))))
        answer = tracker.step(part)
        turn, move = off_by(answer, frame, mug)
        assert answer.frame == index
        assert turn < 3.0
        assert move < 2.5
    assert tracker._state.index == 9  # a late frame does not turn time back


def test_touch_between_images_is_quick_and_takes_nothing_from_them(mug, carried):
    told, untold = (followed_between_images(mug, carried, camera) for camera in (True, False))
    # what fingers say is off by what the camera's place is off, whether a frame tells of it or not
    for one, other in zip(told, untold):
        np.testing.assert_array_equal(one.pose, other.pose)
        np.testing.assert_array_equal(one.covariance, other.covariance)


def followed_between_images(mug, carried, camera):
    """Answers where every fourth frame has an image, and the others its camera or none."""
    tracker, every = Tracker(mug), 4
    answers, searched = [], []
    for frame in carried:
        image = frame.index % every == 0
        part = frame if image else replace(frame, depth=None, rgb=None, mask=None)
        part = part if image or camera else replace(part, camera=None)
        tracker._state.renewal.due = frame.index  # a search is due in every frame
        answer = tracker.step(part)
        turn, move = off_by(answer, frame, mug)
        assert turn < 3.0
        assert move < 2.5
        if frame.index:
            stages = {stage.name for stage in answer.trace if stage.ran}
            searched.append((image, "search anew" in stages))
        answers.append(answer)
        if frame.index > every:
            assert tracker._state.known is not None  # of what looks have in common touch says nothing
    assert not any(done for image, done in searched if not image)
    assert all(done for image, done in searched if image)
    return answers


def test_a_late_image_is_searched_at_its_own_time(mug, carried):
    tracker, asked = Tracker(mug), []
    for frame in carried[:6]:
        tracker.step(frame)
    tracker.step(carried[8])
    search = tracker._search

    def looked_at(frame, answer, heard):
        asked.append(off_by(replace(answer, pose=tracker._state.belief.pose), carried[frame.index], mug))
        return search(frame, answer, heard)

    tracker._search = looked_at
    late = tracker.step(carried[6])
    assert asked[0][0] < 3.0  # the track is where the object was then
    assert asked[0][1] < 2.5
    assert tracker._state.index == 8
    turn, move = off_by(replace(late, pose=tracker._state.belief.pose), carried[8], mug)  # and in the present again
    assert turn < 3.0
    assert move < 2.5


def test_a_slip_is_said_and_followed(mug):
    slip = {i: np.array([0.03, 0.0, 0.0, 0.0, 0.0012, 0.0]) for i in (7, 8, 9)}
    frames = recording(mug, slip=slip)
    answers = list(track(frames, mug))
    slipping = [a.frame for a in answers if a.slip]
    assert slipping
    assert 7 <= slipping[0] <= 10
    assert any("slips in the hand" in note for a in answers for note in a.notes)
    turn, move = off_by(answers[-1], frames[-1], mug)
    assert turn < 2.5
    assert move < 2.0


def test_what_goes_on_slipping_is_glanced_at_a_second_time(mug):
    slip = {i: np.array([0.03, 0.0, 0.0, 0.0, 0.0012, 0.0]) for i in range(7, 13)}
    frames = recording(mug, count=13, slip=slip)
    answers = list(track(frames, mug, settings=ALONE))
    looked = {a.frame for a in answers if any(stage.name == "look" for stage in a.trace)}
    slipping = [a.frame for a in answers if a.slip]
    assert slipping[0] in looked  # what nobody expects is looked at in full
    assert any(frame not in looked for frame in slipping)
    for answer, frame in zip(answers[slipping[0] :], frames[slipping[0] :]):
        turn, move = off_by(answer, frame, mug)
        assert turn < 2.5
        assert move < 2.0


def test_after_a_slip_what_looks_have_in_common_is_found_anew(mug):
    slip = {i: np.array([0.03, 0.0, 0.0, 0.0, 0.0012, 0.0]) for i in (7, 8, 9)}
    frames = recording(mug, count=16, slip=slip)
    tracker, slipping, weight, looked = Tracker(mug, settings=ALONE), [], {}, set()
    for frame in frames:
        answer = tracker.step(frame)
        known = tracker._state.known
        weight[frame.index] = 0.0 if known is None else known.weight
        if any(stage.name == "look" for stage in answer.trace):
            looked.add(frame.index)
        if answer.slip:
            slipping.append(frame.index)
    last = slipping[-1]
    assert {last + 1, last + 2} <= looked
    # of the hold before nothing is left in the first of them
    before = weight[slipping[0] - 1]
    assert 0.0 < weight[last + 1] < before


def test_a_lost_object_is_found_again(mug):
    leap = np.array([0.5, 0.3, 0.0, 0.03, -0.02, 0.0])
    frames = recording(mug, slip={5: leap})
    answers = list(track(frames, mug))
    assert "re-initialised" in [a.how for a in answers[5:8]]
    for answer, frame in zip(answers[8:], frames[8:]):
        turn, move = off_by(answer, frame, mug)
        assert answer.how == "tracked"
        assert turn < 3.0
        assert move < 2.5


def test_a_cylinder_does_not_spin():
    model = library.make("cylinder")
    frames = recording(model, count=10, seed=2)
    answers = list(track(frames, model))
    truth = [f.camera_from_object_truth for f in frames]
    # with the motion taken out, every answer has the first one's turn about the axis
    first = poses.inverse(truth[0]) @ answers[0].pose
    for answer, true in zip(answers, truth):
        here = poses.inverse(true) @ answer.pose
        assert np.rad2deg(poses.rotation_angle(here[:3, :3] @ first[:3, :3].T)) < 3.0
    assert not any(a.slip for a in answers)


def test_clouds_are_followed_like_images(mug, carried):
    frames = [replace(f, depth=None, cloud=VIEW.back_project(f.depth)) for f in carried[:5]]
    for answer, frame in zip(track(frames, mug), frames):
        turn, move = off_by(answer, frame, mug)
        assert turn < 4.0
        assert move < 3.0
        assert answer.how in ("started", "tracked")


def test_without_a_hand_the_last_velocity_leads(mug, carried):
    frames = [replace(f, world_from_hand=None, contacts=Contacts(np.zeros((0, 3)))) for f in carried]
    for answer, frame in zip(track(frames, mug, use="vision"), frames):
        turn, move = off_by(answer, frame, mug)
        assert turn < 3.0
        assert move < 2.5
        assert not answer.slip


def test_what_the_robot_is_off_by_is_learned_where_no_hand_is_seen(mug, carried):
    """Fingers that are all reported 5 mm beside where they are contradict no pose for long."""
    off = poses.make_pose(poses.exp_rotation(np.array([0.004, 0.0, 0.0])), [0.004, -0.003, 0.0])
    tracker = Tracker(mug)
    answers = [tracker.step(replace(frame, contacts=frame.contacts.moved(off))) for frame in carried]
    assert [a.how for a in answers[1:]] == ["tracked"] * (len(carried) - 1)
    assert all(off_by(a, f, mug)[1] < 2.5 for a, f in zip(answers, carried))
    correction = tracker._state.correction
    assert correction is not None
    reported = carried[-1].contacts.moved(off).moved(poses.inverse(carried[-1].camera_from_object_truth))
    before = np.abs(mug.field.distance(reported.points)).mean()
    moved = carried[-1].contacts.moved(correction @ off).moved(poses.inverse(carried[-1].camera_from_object_truth))
    assert np.abs(mug.field.distance(moved.points)).mean() < 0.6 * before


def test_bad_senses_are_refused(mug):
    with pytest.raises(InputError, match="vision, touch or both"):
        Tracker(mug, use="smell")
